"""Bags onto topics and topics into bags, with real processes."""

import os
import re
import resource
import signal

from live_chain import observer, process, started, wait_until
import numpy as np
from numpy.testing import assert_array_equal
import pytest
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import qos_profile_sensor_data
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from multiimu_ros.bags import BagWriter, list_topics, read_imus
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.samples import ImuSamples

pytestmark = pytest.mark.ros
TOPICS = ['/imu0/data_raw', '/imu1/data_raw']
DOMAIN = int(os.environ['ROS_DOMAIN_ID'])
PERIOD_NS = 5_000_000
START_NS = 1_600_000_000_000_000_000


def write_bag(path, n, *, period_ns=PERIOD_NS):
    """Write `n` scans of two IMUs that count up."""
    stamp_ns = START_NS + period_ns * np.arange(n)
    vectors = np.arange(6.0 * n).reshape(2, n, 3)
    data = encode_imus('imu_link', ImuSamples(stamp_ns, vectors[0], vectors[1]))
    with BagWriter(path) as bag:
        for topic in TOPICS:
            bag.add_topic(topic, 'sensor_msgs/msg/Imu')
        for k in range(n):
            for topic in TOPICS:
                bag.write(topic, int(stamp_ns[k]), data[k])
    return path


def run_to_its_end(verb, *arguments):
    """Return the exit code of a process that ends by itself, and what it said."""
    with started(verb, *arguments, domain=DOMAIN) as running:
        _, said = running.communicate(timeout=60)
    return running.returncode, said


def test_what_is_played_is_recorded_in_full_and_in_time(tmp_path):
    bag = write_bag(tmp_path / 'bag', 400)
    with process('record', '-o', tmp_path / 'copy', domain=DOMAIN):
        code, said = run_to_its_end('play', bag, '--wait', '20')  # topics that come later
    assert code == 0
    assert 'Played 800 messages on 2 topics in 2.0' in said
    first, second = (read_imus(path, TOPICS) for path in (bag, tmp_path / 'copy'))
    for track, copy in zip(first.tracks, second.tracks, strict=True):
        assert copy.frame_id == 'imu_link'
        assert_array_equal(copy.samples.stamp_ns, track.samples.stamp_ns)
        assert_array_equal(copy.samples.angular_rate, track.samples.angular_rate)
        late = (copy.received_ns - copy.received_ns[0]) - (
            track.received_ns - track.received_ns[0]
        )
        # Half of the messages are within a period even on a machine that does other things.
        assert np.median(np.abs(late - np.median(late))) < PERIOD_NS


def test_rate_shortens_the_spacing_and_clock_tells_the_time_of_the_bag(tmp_path):
    bag = write_bag(tmp_path / 'bag', 200)  # 1 s
    end_ns = START_NS + 199 * PERIOD_NS
    clocks, stamps = [], []
    with observer(DOMAIN) as node:
        node.create_subscription(Clock, '/clock', lambda msg: clocks.append(ns(msg.clock)), 1000)
        node.create_subscription(Imu, TOPICS[0], lambda msg: stamps.append(msg.header.stamp), 1000)
        node.create_subscription(Imu, TOPICS[1], lambda msg: None, 1000)
        with started('play', bag, '--rate', '2', '--clock', domain=DOMAIN) as play:
            wait_until(lambda: end_ns in clocks or spin(node), 30, 'the last instant')
            _, said = play.communicate(timeout=30)
    assert 'in 0.5' in said  # 1 s at twice the speed
    assert (np.diff(clocks) >= 0).all()
    assert len(stamps) == 200
    assert len(clocks) >= 200  # the clock comes before each message, and where there is none


def ns(stamp):
    """Return a stamp in nanoseconds."""
    return stamp.sec * 10**9 + stamp.nanosec


def spin(node):
    """Serve the node for a moment; return False."""
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    for _ in range(50):
        executor.spin_once(timeout_sec=0.001)
    executor.remove_node(node)
    return False


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_play_with_exit_code_0(tmp_path, number):
    bag = write_bag(tmp_path / 'bag', 100_000)
    with process('play', bag, '--wait', '0', domain=DOMAIN) as play:
        line = play.stderr.readline()
        assert 'Nobody listens' in line
        play.send_signal(number)
        assert play.wait(10) == 0


@pytest.mark.parametrize(
    ('arguments', 'complaint'),
    [
        (['play', '/nowhere'], 'must be a rosbag2 folder'),
        (['play', '{bag}', '--topics', '/x'], 'must hold a topic to play'),
        (['record', '-o', '{bag}'], 'exists already'),
    ],
)
def test_a_mistake_is_one_sentence_and_exit_code_1(tmp_path, arguments, complaint):
    bag = write_bag(tmp_path / 'bag', 1)
    code, said = run_to_its_end(*(text.format(bag=bag) for text in arguments))
    assert code == 1
    assert re.fullmatch(rf'[^\n]*{complaint}[^\n]*\.\n', said), said


def test_a_bag_that_breaks_off_ends_play_with_exit_code_1(tmp_path):
    bag = write_bag(tmp_path / 'bag', 4000)
    file = bag / 'bag.mcap'
    content = bytearray(file.read_bytes())
    middle = len(content) // 2
    content[middle : middle + 1000] = b'\xff' * 1000  # more than a message: breaks a record
    file.write_bytes(content)
    code, said = run_to_its_end('play', bag, '--wait', '0', '--rate', '100')
    assert code == 1
    assert 'damaged or cut short' in said


def test_a_full_disk_ends_record_with_one_sentence_and_a_readable_bag(tmp_path):
    bag = write_bag(tmp_path / 'bag', 9000, period_ns=300_000)  # 6 MB in 2.7 s
    limit = (3 << 20, resource.getrlimit(resource.RLIMIT_FSIZE)[1])
    with started('record', '-o', tmp_path / 'copy', domain=DOMAIN) as record:
        reserve = tmp_path / 'copy' / '.reserve'
        wait_until(lambda: reserve.exists() and reserve.stat().st_size, 20, 'the new bag')
        resource.prlimit(record.pid, resource.RLIMIT_FSIZE, limit)
        run_to_its_end('play', bag, '--wait', '20')
        _, said = record.communicate(timeout=40)
    assert record.returncode == 1
    assert re.search(r'ends early, without the last \d+ messages, as the disk says', said)
    assert sum(topic.count for topic in list_topics(tmp_path / 'copy')) > 4000


def test_best_effort_topics_are_recorded_as_such(tmp_path):
    with observer(DOMAIN) as node, process('record', '-o', tmp_path / 'bag', domain=DOMAIN):
        publisher = node.create_publisher(Imu, '/imu0/data_raw', qos_profile_sensor_data)
        wait_until(publisher.get_subscription_count, 20, 'the recorder')
    (topic,) = list_topics(tmp_path / 'bag')
    assert (topic.name, topic.reliable) == ('/imu0/data_raw', False)


def test_without_arguments_both_say_how_to_call_them():
    for verb in ('record', 'play'):
        code, said = run_to_its_end(verb)
        assert code == 2
        assert said.startswith(f'usage: {verb}')
