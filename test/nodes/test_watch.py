"""After three seconds without data a node says why, once, and what to do."""

import pytest
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_helpers import imu_message, node_process, ros_peer
from sensor_msgs.msg import Imu
from std_msgs.msg import String

pytestmark = pytest.mark.ros

RELIABLE = 'qos_overrides./imu0/data_raw.subscription.reliability'


@pytest.fixture
def rig_file(tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text('version: 1\nrig: {name: one}\nimus: [{name: imu0, frame_id: imu0_link}]\n')
    return path


def reason(rig_file, prepare, until='`/imu0/data_raw`: ', **parameters):
    """Return what the calibration node has said when it says `until`; discovery may be late."""
    with ros_peer() as peer:
        prepare(peer)
        with node_process('calibration', rig_file=rig_file, **parameters) as process:
            peer.wait_until(lambda: until in process.text, 20.0)
            return process.text


def test_no_publisher(rig_file):
    assert 'nobody publishes it; start the driver' in reason(rig_file, lambda peer: None)


def test_another_namespace(rig_file):
    text = reason(
        rig_file,
        lambda peer: peer.publisher('/board/imu0/data_raw'),
        until='`/board/imu0/data_raw` exists',
    )
    assert '`/board/imu0/data_raw` exists' in text
    assert '-r __ns:=/board' in text


def test_another_type(rig_file):
    text = reason(
        rig_file, lambda peer: peer.publisher('/imu0/data_raw', String), until='its type must be'
    )
    assert 'its type must be sensor_msgs/msg/Imu, got std_msgs/msg/String' in text


@pytest.mark.parametrize('parameter', [{RELIABLE: 'reliable'}, {'reliable': 'true'}])
def test_reliable_asked_of_a_best_effort_publisher(rig_file, parameter):
    qos = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
    text = reason(
        rig_file,
        lambda peer: peer.publisher('/imu0/data_raw', Imu, qos),
        until='the QoS of /peer',
        **parameter,
    )
    assert 'the QoS of /peer does not fit' in text


def test_a_silent_publisher(rig_file):
    said = '/peer publishes it but sends nothing'  # a moment later, where its name comes late
    assert said in reason(rig_file, lambda peer: peer.publisher('/imu0/data_raw'), until=said)


def test_stamps_of_zero(rig_file):
    def prepare(peer):
        msg = imu_message('a', 0, [0.0] * 6)
        peer.node.create_timer(0.05, lambda: peer.send('/imu0/data_raw', msg))

    assert 'messages came without a usable stamp' in reason(
        rig_file, prepare, until='without a usable stamp'
    )


def test_several_silent_topics_are_one_warning(tmp_path):
    path = tmp_path / 'rig.yaml'
    imus = ', '.join(f'{{name: imu{k}, frame_id: a}}' for k in range(3))
    path.write_text(f'version: 1\nrig: {{name: three}}\nimus: [{imus}]\n')
    text = reason(path, lambda peer: None)
    assert text.count('nobody publishes it') == 1
    assert '(And 2 more topics.)' in text
