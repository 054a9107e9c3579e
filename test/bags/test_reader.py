"""Reading bags: order, topics, and every way in which a file can be wrong."""

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from multiimu_ros.bags import (
    BagWriter,
    find_imu_topics,
    list_topics,
    read_imus,
    read_messages,
    reader,
    Topic,
)
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.errors import ConfigError
from multiimu_ros.samples import ImuSamples

IMU = 'sensor_msgs/msg/Imu'


def write(path, topics, samples, *, frames=None, storage='mcap'):
    """Write the same samples to each topic, scan by scan; return the path."""
    with BagWriter(path, storage) as bag:
        columns = []
        for number, topic in enumerate(topics):
            bag.add_topic(topic, IMU)
            columns.append(encode_imus((frames or topics)[number], samples))
        for stamp_ns, scan in zip(
            samples.stamp_ns.tolist(), zip(*columns, strict=True), strict=True
        ):
            for topic, data in zip(topics, scan, strict=True):
                bag.write(topic, stamp_ns, data)
    return path


def ramp(n):
    """Return n samples that count up, 5 ms apart."""
    stamp_ns = 10**18 + 5_000_000 * np.arange(n)
    vectors = np.arange(6.0 * n).reshape(2, n, 3)
    return ImuSamples(stamp_ns, vectors[0], vectors[1])


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_what_was_written_is_read_in_recorded_order(tmp_path, monkeypatch, storage):
    monkeypatch.setattr(reader, 'BLOCK', 7)  # several blocks, the last one partly filled
    samples = ramp(3000)  # more than one chunk of 1 MB
    path = write(tmp_path / 'bag', ['/imu0/data_raw', '/imu1/data_raw'], samples, storage=storage)
    recording = read_imus(path, ['/imu1/data_raw', '/imu0/data_raw'])
    assert_array_equal(recording.order, np.tile([1, 0], 3000))
    for track in recording.tracks:
        assert track.frame_id == track.topic
        assert_array_equal(track.samples.stamp_ns, samples.stamp_ns)
        assert_array_equal(track.received_ns, samples.stamp_ns)
        assert_array_equal(track.samples.angular_rate, samples.angular_rate)
        assert_array_equal(track.samples.specific_force, samples.specific_force)


def test_topics_come_with_counts_and_quality_of_service(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/tf_static', 'tf2_msgs/msg/TFMessage', latched=True)
        bag.add_topic('/imu', IMU, reliable=False)
        bag.write('/imu', 5, encode_imus('imu', ramp(1))[0])
    assert list_topics(tmp_path / 'bag') == (
        Topic('/imu', IMU, 1, reliable=False),
        Topic('/tf_static', 'tf2_msgs/msg/TFMessage', 0, latched=True),
    )
    assert [message.received_ns for message in read_messages(tmp_path / 'bag')] == [5]
    assert read_imus(tmp_path / 'bag', ['/elsewhere']).tracks[0].frame_id == ''


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_bag_without_its_metadata_is_read_all_the_same(tmp_path, storage):
    path = write(tmp_path / 'bag', ['/imu'], ramp(5), storage=storage)
    (path / 'metadata.yaml').unlink()
    assert list_topics(path)[0].count == 5
    file = next(path.iterdir())
    assert len(read_imus(file, ['/imu']).order) == 5


def attempt(path, content):
    """Read the bag file with that content; return the messages' count, or the complaint."""
    next(f for f in path.iterdir() if f.suffix != '.yaml').write_bytes(content)
    try:
        return len(read_imus(path, ['/imu']).order)
    except ConfigError as error:
        return str(error)


@pytest.mark.parametrize('storage', ['mcap', 'sqlite3'])
def test_a_damaged_bag_gives_one_sentence_wherever_it_was_cut(tmp_path, storage):
    path = write(tmp_path / 'bag', ['/imu'], ramp(20), storage=storage)
    whole = next(f for f in path.iterdir() if f.suffix != '.yaml').read_bytes()
    cuts = range(0, len(whole), 97)  # a prime: all phases of the records
    answers = [attempt(path, whole[:size]) for size in cuts]
    # sqlite fills its last page with zeros, so that a file cut there may be whole enough.
    assert all(a == 20 or 'damaged or cut short' in a for a in answers)
    assert len([a for a in answers if a == 20]) < 0.1 * len(answers)


def test_flipped_bytes_give_one_sentence_or_no_more_messages_than_there_were(tmp_path, rng):
    path = write(tmp_path / 'bag', ['/imu'], ramp(20))
    whole = (path / 'bag.mcap').read_bytes()
    for position in rng.integers(0, len(whole), 200):
        flipped = bytearray(whole)
        flipped[position] ^= 0xFF
        answer = attempt(path, flipped)
        assert answer in range(21) or '. ' not in answer


def test_missing_bags_and_foreign_folders_are_refused(tmp_path):
    (tmp_path / 'folder').mkdir()
    (tmp_path / 'bag.txt').write_text('hello')
    for name in ('nothing', 'folder'):
        with pytest.raises(ConfigError, match='must be a rosbag2 folder'):
            list_topics(tmp_path / name)
    with pytest.raises(ConfigError, match='damaged'):
        list_topics(tmp_path / 'bag.txt')


def test_a_topic_of_another_type_is_refused(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/odom', 'nav_msgs/msg/Odometry')
        bag.write('/odom', 0, b'\x00\x01\x00\x00' + bytes(700))
    with pytest.raises(ConfigError, match=r'`/odom` of .* must hold sensor_msgs/msg/Imu'):
        read_imus(tmp_path / 'bag', ['/odom'])


def test_two_imus_on_one_topic_are_refused(tmp_path):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/imu', IMU)
        for frame_id in ('left', 'right'):
            bag.write('/imu', 0, encode_imus(frame_id, ramp(1))[0])
    with pytest.raises(ConfigError, match='must come from one IMU, got `left` and `right`'):
        read_imus(tmp_path / 'bag', ['/imu'])


def topics(*names):
    return [Topic(name, IMU, 1) for name in names]


def test_raw_topics_are_found_by_the_names_of_the_rig():
    present = topics('/rig/imu2/data_raw', '/rig/imu0/data_raw', '/rig/imu0/data')
    assert find_imu_topics(present, ['imu0', 'imu1', 'imu2']) == {
        0: '/rig/imu0/data_raw',
        2: '/rig/imu2/data_raw',
    }


def test_a_single_raw_topic_is_one_imu():
    assert find_imu_topics(topics('/imu/data_raw'), ['imu0']) == {0: '/imu/data_raw'}


def test_wanted_topics_come_in_the_order_given():
    present = topics('/a', '/b', '/ns/c')
    assert find_imu_topics(present, ['imu0', 'imu1'], ['ns/c', '/a']) == {0: '/ns/c', 1: '/a'}


@pytest.mark.parametrize(
    ('present', 'wanted', 'complaint'),
    [
        (topics('/x/imu'), [], 'as the bag has no `imu0/data_raw`: it has `/x/imu`'),
        ([Topic('/imu0/data_raw', IMU, 0)], [], 'it has no Imu topic at all'),
        (topics('/a/imu0/data_raw', '/b/imu0/data_raw'), [], 'must fit one Imu topic'),
        (topics('/a'), ['/b'], '`/b` must fit one Imu topic of the bag, which holds `/a`'),
        (topics('/a'), ['/a', '/b'], 'at most the 1 IMUs of the rig, got 2'),
    ],
)
def test_topics_that_do_not_fit_are_named(present, wanted, complaint):
    with pytest.raises(ConfigError, match=complaint):
        find_imu_topics(present, ['imu0'], wanted)
