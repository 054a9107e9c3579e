"""Writing bags: what stock tools need, and what a full disk leaves."""

import collections
import itertools
import resource

import pytest
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosReliability

from multiimu_ros.bags import BagWriter, list_topics, read_messages
from multiimu_ros.errors import ConfigError

IMU = 'sensor_msgs/msg/Imu'
MESSAGE = b'\x00\x01\x00\x00' + bytes(320)


@pytest.fixture
def small_disk(monkeypatch):
    """Let no file grow beyond 3 MB; SIGXFSZ is ignored by Python, so that write raises."""
    monkeypatch.setattr('multiimu_ros.bags.writer.RESERVE', 1 << 10)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3 << 20, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_the_metadata_is_what_jazzy_writes(tmp_path, storage):
    with BagWriter(tmp_path / 'bag', storage) as bag:
        bag.add_topic('/imu', IMU)
        bag.write('/imu', 17, MESSAGE)
    with AnyReader([tmp_path / 'bag']) as reader:
        (connection,) = reader.connections
        assert connection.digest.startswith('RIHS01_')
        assert 'geometry_msgs/Vector3 linear_acceleration' in connection.msgdef.data
        (qos,) = connection.ext.offered_qos_profiles
        assert (qos.reliability, qos.depth) == (QosReliability.RELIABLE, 10)
        assert (reader.start_time, reader.message_count) == (17, 1)
    assert not (tmp_path / 'bag' / '.reserve').exists()


@pytest.mark.usefixtures('small_disk')
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_full_disk_leaves_a_readable_bag(tmp_path, storage):
    bag = BagWriter(tmp_path / 'bag', storage)
    bag.add_topic('/imu', IMU)
    stamps = itertools.count()  # 3 MB are full after some 8000
    with pytest.raises(ConfigError, match=r'ends early.*make room'):
        collections.deque((bag.write('/imu', t, MESSAGE) for t in stamps), maxlen=0)
    bag.close()
    kept = [message.received_ns for message in read_messages(tmp_path / 'bag')]
    assert kept == list(range(next(stamps) - bag.lost))
    assert len(kept) > 2 * (1 << 20) / 400  # two chunks of 1 MB fit below 3 MB
    assert list_topics(tmp_path / 'bag')[0].count == len(kept)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_an_error_inside_still_closes_the_bag(tmp_path, storage):
    def interrupted():
        with BagWriter(tmp_path / 'bag', storage) as bag:
            bag.add_topic('/imu', IMU)
            bag.write('/imu', 3, MESSAGE)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        interrupted()
    assert list_topics(tmp_path / 'bag')[0].count == 1


@pytest.mark.usefixtures('small_disk')
@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bag_that_cannot_be_finished_says_so(tmp_path, storage):
    bag = BagWriter(tmp_path / 'bag', storage)
    bag.add_topic('/imu', IMU)
    bag.write('/imu', 3, MESSAGE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, resource.getrlimit(resource.RLIMIT_FSIZE)[1]))
    with pytest.raises(ConfigError, match='Cannot finish the bag'):
        bag.close()
    bag.close()  # and that is all


def test_what_cannot_be_made_is_refused(tmp_path):
    (tmp_path / 'bag').mkdir()
    (tmp_path / 'file').touch()
    with pytest.raises(ConfigError, match='exists already'):
        BagWriter(tmp_path / 'bag')
    with pytest.raises(ConfigError, match='choose a writable place'):
        BagWriter(tmp_path / 'file' / 'bag')
    with pytest.raises(ConfigError, match='`storage` must be mcap or sqlite3'):
        BagWriter(tmp_path / 'other', 'csv')
    with (
        BagWriter(tmp_path / 'new') as bag,
        pytest.raises(ConfigError, match='ROS 2 Jazzy brings'),
    ):
        bag.add_topic('/x', 'my_msgs/msg/Mine')
