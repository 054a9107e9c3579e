"""The doctor as a process, on graphs of real publishers: what it finds, says and returns."""

import json
import os
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import imu_message, ros_peer
from sensor_msgs.msg import Imu
from std_msgs.msg import String

pytestmark = pytest.mark.ros

BEST_EFFORT = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
Z_UP = [0.0, 0.0, 0.0, 0.0, 0.0, 9.81]
X_DOWN = [0.0, 0.0, 0.0, -9.81, 0.0, 0.0]
PERIOD_S = 0.01


def start_doctor(*arguments, **environment):
    return subprocess.Popen(
        [sys.executable, '-m', 'multiimu_ros.cli', 'doctor', *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | environment,
    )


def examine(peer, *arguments, **environment):
    """Return the exit code and stdout of a doctor that the peer keeps busy."""
    with start_doctor('--seconds', '1', *arguments, **environment) as doctor:
        peer.wait_until(lambda: doctor.poll() is not None, 20.0)
        stdout, stderr = doctor.communicate()
    assert stderr == ''
    return doctor.returncode, stdout


def keep_sending(peer, topic, values, *, unit=1.0, stamped=True, qos=100, frame_id=None):
    """Let the peer publish noisy readings until it is closed."""
    rng, publisher = np.random.default_rng(7), peer.publisher(topic, Imu, qos)
    frame_id = frame_id or f'{topic.split("/")[-2]}_link'

    def send():
        stamp_ns = time.time_ns() if stamped else 0
        readings = unit * (values + 0.01 * rng.standard_normal(6))
        msg = imu_message(frame_id, stamp_ns, readings)
        msg.orientation_covariance[0] = -1.0 if 'raw' in topic else 1e-4
        for field in (msg.angular_velocity_covariance, msg.linear_acceleration_covariance):
            field[::4] = 1e-4
        msg.orientation_covariance[4::4] = 1e-4
        publisher.publish(msg)

    peer.node.create_timer(PERIOD_S, send)


def complain(peer, message):
    status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name='driver: imu6', message=message)
    publisher = peer.publisher('/diagnostics', DiagnosticArray)
    msg = DiagnosticArray(status=[status])
    peer.node.create_timer(0.3, lambda: publisher.publish(msg))


@pytest.fixture(scope='module')
def verdict():
    """Return the exit code and the findings in a graph with one fault per IMU."""
    with ros_peer() as peer:
        keep_sending(peer, '/imu0/data_raw', Z_UP)
        keep_sending(peer, '/imu1/data_raw', Z_UP, qos=BEST_EFFORT)
        keep_sending(peer, '/imu2/data_raw', Z_UP, unit=1 / 9.81, stamped=False)
        keep_sending(peer, '/imu3/data_raw', X_DOWN)
        keep_sending(peer, '/board/imu5/data_raw', Z_UP)
        peer.publisher('/imu4/data_raw', String)
        peer.publisher('/odom', Odometry)
        complain(peer, 'checksum errors')
        for topic in ('/imu1/data_raw', '/imu5/data_raw'):
            peer.node.create_subscription(Imu, topic, lambda msg: None, RELIABLE)
        code, text = examine(peer, '--json')
    return code, json.loads(text)


@pytest.mark.parametrize(
    ('level', 'subject', 'text'),
    [
        ('error', '/peer on /imu1/data_raw', 'the QoS of /peer does not fit'),
        ('error', '/imu2/data_raw', 'messages carry no stamp'),
        ('error', '/imu2/data_raw', 'that is g, and must be m/s^2'),
        ('hint', 'imu3', 'x points down at rest'),
        ('error', '/peer on /imu4/data_raw', 'its type is std_msgs/msg/String'),
        ('error', '/peer on /imu5/data_raw', '-r __ns:=/board'),
        ('error', 'driver: imu6', 'checksum errors'),
        ('error', '/odom', 'published but silent'),
        ('hint', 'imu/data', 'start `fusion` or `pipeline`'),
    ],
)
def test_every_fault_of_a_graph_is_found(verdict, level, subject, text):
    _, answer = verdict
    assert any(
        finding['level'] == level and finding['subject'] == subject and text in finding['text']
        for finding in answer['findings']
    ), answer['findings']


def test_what_is_sound_is_not_complained_about(verdict):
    code, answer = verdict
    assert (code, answer['healthy'], answer['nodes']) == (1, False, ['/peer'])
    errors = [finding for finding in answer['findings'] if finding['level'] == 'error']
    assert '/imu0/data_raw' not in str(errors)  # a busy machine may well make it unsteady
    [imu0] = [imu for imu in answer['imus'] if imu['topic'] == '/imu0/data_raw']
    assert imu0['rate_hz'] == pytest.approx(1 / PERIOD_S, rel=0.3)  # a timer of a busy machine


def test_a_healthy_graph_gives_a_table_and_exit_code_0():
    with ros_peer() as peer:
        for topic in ('/imu0/data_raw', '/imu/data'):
            keep_sending(peer, topic, Z_UP)
        odometry = peer.publisher('/odom', Odometry)
        peer.node.create_timer(PERIOD_S, lambda: odometry.publish(Odometry()))
        code, text = examine(peer)
    assert code == 0, text
    assert 'error' not in text
    assert f'Nodes in domain {os.environ["ROS_DOMAIN_ID"]}: /peer\n' in text
    assert 'z up' in text
    assert f'ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]}' in text


def test_a_wrong_domain_is_named_beside_the_one_that_is_in_use():
    own = os.environ['ROS_DOMAIN_ID']
    with ros_peer() as peer:
        code, text = examine(peer, '--seconds', '0.5', ROS_DOMAIN_ID=str(int(own) + 20))
    assert code == 1
    assert f'error: domain {int(own) + 20}: no node is in it; this machine also' in text
    assert own in text.split('also has nodes in')[1]


def test_an_interrupted_doctor_says_so_in_one_sentence():
    with ros_peer() as peer, start_doctor('--seconds', '30') as doctor:
        name = f'doctor_{doctor.pid}'
        peer.wait_until(lambda: name in peer.node.get_node_names(), 15.0)
        doctor.send_signal(signal.SIGINT)
        _, stderr = doctor.communicate(timeout=10.0)
    assert doctor.returncode == 1
    assert stderr == '`doctor` must listen for 30 s, but was interrupted; let it finish.\n'
