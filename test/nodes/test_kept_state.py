"""The state file of the fusion node: written on request and at the end, read at the start."""

import json
import time

from nav_msgs.msg import Odometry
import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from ros_helpers import imu_message, node_process, ros_peer
from std_srvs.srv import Trigger
import yaml

from multiimu_ros.nodes import kept_state
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.rig import load_rig

pytestmark = pytest.mark.ros

RATE_HZ = 100
AT_REST = [0.0, 0.0, 0.0, 0.0, 0.0, 9.80665]


@pytest.fixture
def rig_file(tmp_path):
    imu = {'name': 'imu0', 'frame_id': 'imu0_link'}
    path = tmp_path / 'rig.yaml'
    path.write_text(yaml.safe_dump({'version': 1, 'rig': {'name': 'one'}, 'imus': [imu]}))
    return path


def rest(peer, rng, seconds):
    """Send readings of a resting IMU at their own pace."""
    for _ in range(round(seconds * RATE_HZ)):
        values = AT_REST + rng.standard_normal(6) * ([1e-3] * 3 + [1e-2] * 3)
        peer.send('imu0/data_registered', imu_message('imu0_link', time.time_ns(), values))
        peer.spin(1 / RATE_HZ)


def test_the_state_outlives_the_node(rig_file, tmp_path, rng):
    file = tmp_path / 'state.json'
    node = {'rig_file': rig_file, 'state_file': file}
    with node_process('fusion', **node) as process, ros_peer() as peer:
        peer.collect(Odometry, 'odom')
        peer.wait_for_matches(['imu0/data_registered'], ['odom'])
        assert not peer.call(Trigger, '/fusion/save_state', Trigger.Request()).success
        rest(peer, rng, 1.0)
        assert peer.call(Trigger, '/fusion/save_state', Trigger.Request()).success
        saved = json.loads(file.read_text())
        rest(peer, rng, 0.5)
        assert process.end()[0] == 0
    at_the_end = json.loads(file.read_text())
    assert at_the_end['stamp_ns'] > saved['stamp_ns']
    moved = dict(at_the_end, position_n=[3.0, -2.0, 1.0])
    file.write_text(json.dumps(moved))
    with node_process('fusion', **node) as process, ros_peer() as peer:
        poses = peer.collect(Odometry, 'odom')
        peer.wait_for_matches(['imu0/data_registered'], ['odom'])
        rest(peer, rng, 0.5)
        peer.wait_until(lambda: len(poses) > 5)
        code, said = process.end()[0], process.text
    assert code == 0
    p = poses[0].pose.pose.position
    np.testing.assert_allclose([p.x, p.y, p.z], [3.0, -2.0, 1.0], atol=0.1)
    assert 'Going on from the state' in said


def test_a_damaged_state_is_told_and_the_node_starts_anew(rig_file, tmp_path, rng):
    file = tmp_path / 'state.json'
    file.write_text('{"version": 1')
    with (
        node_process('fusion', rig_file=rig_file, state_file=file) as process,
        ros_peer() as peer,
    ):
        poses = peer.collect(Odometry, 'odom')
        peer.wait_for_matches(['imu0/data_registered'], ['odom'])
        rest(peer, rng, 0.5)
        peer.wait_until(lambda: len(poses) > 5)
        code, said = process.end()[0], process.text
    assert code == 0
    assert 'Starting anew' in said
    assert 'damaged' in said


@pytest.fixture
def keeper(rig_file, tmp_path, monkeypatch):
    """Spin a node that keeps the state of a pipeline every 0.1 s; yields how, and the file."""
    monkeypatch.setattr(kept_state, 'SAVE_EVERY', 0.1)
    file = tmp_path / 'states' / 'state.json'
    pipeline = Pipeline(load_rig(rig_file), PipelineConfig())
    for k in range(100):
        pipeline.push(0, time.time_ns() + k * 10**7, [1e-3 * (k % 2), *AT_REST[1:]])
    rclpy.init()
    chosen = [Parameter('state_file', value=str(file))]
    node = rclpy.create_node('keeper', parameter_overrides=chosen)
    kept_state.KeptState(node, pipeline)
    executor = SingleThreadedExecutor()
    executor.add_node(node)

    def spin(seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            executor.spin_once(timeout_sec=left)

    yield spin, file
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown()


def test_the_state_is_written_now_and_then_and_a_full_disk_is_told_once(keeper, capfd):
    spin, file = keeper
    spin(0.55)
    assert capfd.readouterr().err.count('Cannot write the state file') == 1
    file.parent.mkdir()
    spin(0.35)
    written = json.loads(file.read_text())
    np.testing.assert_allclose(written['position_n'], [0.0, 0.0, 0.0], atol=1e-3)
    file.parent.rename(file.parent.with_name('gone'))
    spin(0.35)
    assert capfd.readouterr().err.count('Cannot write the state file') == 1
