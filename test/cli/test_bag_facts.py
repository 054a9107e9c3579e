"""What is noted about a recording: hash, date, temperature."""

import hashlib

import numpy as np
import pytest
from temperatures import temperature

from multiimu_ros.bags import BagWriter, list_topics, read_imus
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.cli.bag_facts import bag_facts, bag_sha256, temperature_span
from multiimu_ros.errors import ConfigError
from multiimu_ros.samples import ImuSamples

START_NS = 1_700_000_000 * 10**9  # 2023-11-14 22:13:20 UTC


@pytest.fixture
def write(tmp_path):
    def make(temperatures, kind='sensor_msgs/msg/Temperature'):
        path = tmp_path / 'rest'
        with BagWriter(path) as bag:
            bag.add_topic('/ring/imu0/data_raw', 'sensor_msgs/msg/Imu')
            bag.add_topic('/ring/imu0/temperature', kind)
            samples = ImuSamples(np.array([START_NS]), np.zeros((1, 3)), np.zeros((1, 3)))
            bag.write('/ring/imu0/data_raw', START_NS, encode_imus('a', samples)[0])
            for data in temperatures:
                bag.write('/ring/imu0/temperature', START_NS, data)
        return path

    return make


def span(path):
    return temperature_span(path, '/ring/imu0/data_raw', list_topics(path))


@pytest.mark.parametrize('frame_id', ['', 'a', 'abc', 'imu0_link'])  # each is padded otherwise
@pytest.mark.parametrize('little', [True, False])
def test_temperatures_of_another_library_are_read(write, frame_id, little):
    values = (23.5, 31.25, np.nan, 22.0)
    assert span(write([temperature(v, frame_id, little) for v in values])) == (22.0, 31.25)


def test_no_temperature_is_none(write, tmp_path):
    assert span(write([temperature(np.nan)])) is None
    assert temperature_span(tmp_path / 'rest', '/other/data_raw', ()) is None


def test_another_type_of_that_name_is_left_alone(write):
    assert span(write([b'\x00\x01\x00\x00' + bytes(8)], 'std_msgs/msg/Float64')) is None


@pytest.mark.parametrize('data', [b'', b'\x00\x01', temperature(1.0)[:-12]])
def test_a_damaged_message_is_named(write, data):
    with pytest.raises(ConfigError, match='`/ring/imu0/temperature` must hold sensor_msgs'):
        span(write([data]))


def test_the_hash_is_that_of_the_file_with_the_messages(write):
    path = write([])
    expected = hashlib.sha256((path / 'rest.mcap').read_bytes()).hexdigest()
    assert bag_sha256(path) == bag_sha256(path / 'rest.mcap') == expected


def test_the_date_is_that_of_the_first_message(write):
    path = write([])
    track = read_imus(path, ['/ring/imu0/data_raw']).tracks[0]
    facts = bag_facts(path, track, 'abc')
    assert facts['bag'] == 'rest'
    assert facts['date'] == '2023-11-14T22:13:20+00:00'
    assert facts['sha256'] == 'abc'
    assert facts['version'].startswith('multiimu_ros ')
