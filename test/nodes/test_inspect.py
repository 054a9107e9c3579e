"""`multiimu inspect --live` as a process, beside a publisher that plays a calibration."""

from itertools import chain
import json
import signal
import subprocess
import sys
import time

import pytest
from ros_helpers import imu_message, ros_peer
from std_msgs.msg import String

from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

pytestmark = pytest.mark.ros

TOPICS = ('/imu0/data_raw', '/imu1/data_raw')
SPEED = 30.0  # times real time: the stamps tell the tracker how long everything took


def start_inspect(*arguments):
    return subprocess.Popen(
        [sys.executable, '-m', 'multiimu_ros.cli', 'inspect', '--live', *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(peer, inspect, timeout_s=30.0):
    """Return exit code and stdout of a process that the peer keeps busy."""
    peer.wait_until(lambda: inspect.poll() is not None, timeout_s)
    stdout, stderr = inspect.communicate()
    assert stderr == ''
    return inspect.returncode, stdout


def wait_until_heard(peer):
    publishers = [peer.publisher(topic) for topic in TOPICS]
    peer.wait_until(lambda: all(p.get_subscription_count() for p in publishers), 20.0)
    peer.spin(0.7)  # the far side learns of the match a little later


def play(peer, inspect, duration):
    """Publish a calibration of two IMUs, much faster than it was, until somebody has enough."""
    raw = simulate(ring(2), trajectory('calibration', duration), 50.0).raw
    sides = [
        [(stamp_ns, k, data) for stamp_ns, data in zip(part.stamp_ns, messages, strict=True)]
        for k, part in enumerate(raw)
        for messages in [encode_imus(f'imu{k}_link', part)]
    ]
    publishers = [peer.publisher(topic) for topic in TOPICS]
    begin, first_ns = time.monotonic(), raw[0].stamp_ns[0]
    for stamp_ns, k, data in sorted(chain(*sides), key=lambda message: message[0]):
        early = (stamp_ns - first_ns) / 1e9 / SPEED - (time.monotonic() - begin)
        if early > 0.01:
            peer.spin(early)
        if inspect.poll() is not None:
            return
        publishers[k].publish(data)


@pytest.fixture(scope='module')
def whole():
    """Return exit code and report of a recording that suffices."""
    with ros_peer() as peer, start_inspect('--json', '--seconds', '60') as inspect:
        wait_until_heard(peer)
        play(peer, inspect, 140.0)
        code, text = finish(peer, inspect)
    return code, json.loads(text)


def test_it_ends_by_itself_with_exit_code_0_when_nothing_is_missing(whole):
    code, report = whole
    assert report['missing'] == []
    assert (code, report['complete']) == (0, True)
    assert {verdict['answer'] for verdict in report['suffices']} == {'yes'}


def test_what_was_heard_is_what_was_sent(whole):
    imus = whole[1]['imus']
    assert [imu['topic'] for imu in imus] == list(TOPICS)
    for imu in imus:
        assert imu['Hz'] == pytest.approx(50.0, rel=0.05)  # best effort may lose some
        assert imu['poses']['distinct'] >= 12  # else it would not have ended
        assert (imu['units']['rate'], imu['units']['force']) == ('rad/s', 'm/s^2')


def test_ctrl_c_tells_what_is_still_missing_with_exit_code_1():
    with ros_peer() as peer, start_inspect() as inspect:
        wait_until_heard(peer)
        play(peer, inspect, 25.0)
        inspect.send_signal(signal.SIGINT)
        code, text = finish(peer, inspect)
    assert code == 1
    assert '\n2 IMUs, ' in text
    missing = [line for line in text.splitlines() if line.startswith('still missing: ')]
    assert any(line.endswith(' up)') for line in missing)  # two poses are few
    assert text.splitlines()[-1] in missing


@pytest.fixture(scope='module')
def silent():
    """Return exit code and report where each named topic is silent for a reason of its own."""
    with ros_peer() as peer:
        peer.publisher('/imu1/data_raw', String)
        peer.publisher('/imu2/data_raw')
        unstamped = peer.publisher('/imu3/data_raw')
        message = imu_message('a', 0, [0.0, 0.0, 0.0, 0.0, 0.0, 9.81])
        peer.node.create_timer(0.02, lambda: unstamped.publish(message))
        names = [part for k in range(4) for part in ('--topics', f'imu{k}/data_raw')]
        # Up to 4 s until everybody is discovered, and 3 s of patience.
        with start_inspect('--json', '--seconds', '8', *names) as inspect:
            code, text = finish(peer, inspect)
    return code, json.loads(text)


@pytest.mark.parametrize(
    ('topic', 'reason'),
    [
        ('/imu0/data_raw', 'nobody publishes it'),
        ('/imu1/data_raw', 'its type must be sensor_msgs/msg/Imu, got std_msgs/msg/String'),
        ('/imu2/data_raw', '/peer publishes it but sends nothing; look at its diagnostics'),
        ('/imu3/data_raw', 'messages came without a usable stamp'),
    ],
)
def test_silence_of_a_named_topic_is_explained(silent, topic, reason):
    code, report = silent
    assert (code, report['complete']) == (1, False)
    [told] = [text for text in report['missing'] if text.startswith(f'`{topic}`')]
    assert reason in told


def test_a_graph_without_any_imu_is_explained():
    with ros_peer() as peer, start_inspect('--seconds', '5') as inspect:
        code, text = finish(peer, inspect)
    assert code == 1
    assert 'still missing: nobody publishes a topic `*/data_raw`' in text
