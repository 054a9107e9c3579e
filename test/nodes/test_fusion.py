"""Fusion and pipeline as processes: the same numbers as the core, faults named, services."""

from datetime import datetime, UTC
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
from numpy.testing import assert_allclose
import pytest
from ros_helpers import imu_message, imu_values, node_process, ros_peer
from sensor_msgs.msg import Imu as ImuMessage
from std_srvs.srv import SetBool, Trigger
import yaml

from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.rig import load_rig

pytestmark = pytest.mark.ros

RATE_HZ = 100
RAW = 'imu1/data_raw'
NAMES = ('imu0', 'imu1', 'imu2')
NODES = {'fusion': 'registered', 'pipeline': 'raw'}


@pytest.fixture
def rig_file(tmp_path):
    imus = [{'name': name, 'frame_id': f'{name}_link'} for name in NAMES]
    imus[1]['extrinsics'] = {'rotation': [0.0, 0.0, 1.0, 0.0], 'lever_arm': [0.05, 0.0, 0.0]}
    path = tmp_path / 'rig.yaml'
    path.write_text(yaml.safe_dump({'version': 1, 'rig': {'name': 'three'}, 'imus': imus}))
    return path


def resting_scans(rng, n, start_ns):
    """Return n lists of (imu, stamp [ns], values) of IMUs that lie still."""
    period = 10**9 // RATE_HZ
    noise = rng.standard_normal((n, len(NAMES), 6)) * ([1e-3] * 3 + [1e-2] * 3)
    values = noise + np.array([0, 0, 0, 0, 0, 9.80665])
    return [
        [(k, start_ns + i * period, values[i, k].tolist()) for k in range(len(NAMES))]
        for i in range(n)
    ]


def send(peer, kind, scan):
    for k, stamp_ns, values in scan:
        peer.send(f'{NAMES[k]}/data_{kind}', imu_message(f'{NAMES[k]}_link', stamp_ns, values))


def stream(peer, kind, scans, keep=lambda k: True, pace=1 / RATE_HZ):
    """Send scans at their own pace or another [s], those IMUs only that `keep` says."""
    for scan in scans:
        send(peer, kind, [reading for reading in scan if keep(reading[0])])
        peer.spin(pace)


def statuses(arrays):
    """Return the last status of each name."""
    return {status.name: status for array in arrays for status in array.status}


@pytest.mark.parametrize('name', NODES)
def test_the_node_gives_the_cores_answer(name, rig_file, rng):
    scans = resting_scans(rng, 60, time.time_ns())
    core = Pipeline(load_rig(rig_file), PipelineConfig(input=NODES[name]))
    frames = [frame for scan in scans for reading in scan for frame in core.push(*reading)]
    with node_process(name, rig_file=rig_file) as process, ros_peer() as peer:
        imus, poses = peer.collect(ImuMessage, 'imu/data'), peer.collect(Odometry, 'odom')
        peer.wait_for_matches([f'{n}/data_{NODES[name]}' for n in NAMES], ['imu/data', 'odom'])
        stream(peer, NODES[name], scans)
        peer.wait_until(lambda: len(imus) == len(poses) == len(frames))
        assert process.end()[0] == 0
    for frame, imu, pose in zip(frames, imus, poses, strict=True):
        assert imu.header.stamp == pose.header.stamp
        assert imu.header.stamp.sec * 10**9 + imu.header.stamp.nanosec == frame.stamp_ns
        assert (imu.header.frame_id, pose.header.frame_id) == ('base_link', 'odom')
        assert pose.child_frame_id == 'base_link'
        fused = [*frame.angular_rate, *frame.specific_force]
        assert_allclose(imu_values(imu), fused, rtol=1e-12, atol=1e-15)
        p = pose.pose.pose.position
        assert_allclose([p.x, p.y, p.z], frame.position_n, rtol=1e-12, atol=1e-15)
        assert_allclose(pose.pose.covariance, frame.pose_covariance.ravel(), rtol=1e-12)


def test_a_dead_imu_is_named_within_a_second_and_fusion_goes_on(rig_file, rng):
    scans = resting_scans(rng, 300, time.time_ns())
    with node_process('fusion', rig_file=rig_file), ros_peer() as peer:
        diagnostics = peer.collect(DiagnosticArray, '/diagnostics', depth=10)
        imus = peer.collect(ImuMessage, 'imu/data')
        peer.wait_for_matches([f'{n}/data_registered' for n in NAMES], ['imu/data'])
        stream(peer, 'registered', scans[:150])
        assert statuses(diagnostics)['fusion: imu2'].message == 'ok'
        fused_before = len(imus)
        stream(peer, 'registered', scans[150:250], keep=lambda k: k != 2)  # one second
        assert statuses(diagnostics)['fusion: imu2'].message == 'absent'
        assert statuses(diagnostics)['fusion: imu2'].level == b'\x02'
        assert statuses(diagnostics)['fusion: fusion'].message == 'without imu2'
        assert statuses(diagnostics)['fusion: imu0'].message == 'ok'
        # 0.05 s of patience at 100 Hz, and as much for the machine
        assert len(imus) - fused_before > 90


def test_diagnostics_carry_load_latency_and_the_rigs_name(rig_file, rng):
    with node_process('fusion', rig_file=rig_file), ros_peer() as peer:
        diagnostics = peer.collect(DiagnosticArray, '/diagnostics', depth=10)
        peer.wait_for_matches([f'{n}/data_registered' for n in NAMES], ['/diagnostics'])
        stream(peer, 'registered', resting_scans(rng, 150, time.time_ns()))
        own = statuses(diagnostics)['fusion: node']
    figures = {pair.key: float(pair.value) for pair in own.values}
    assert own.hardware_id == 'three'
    assert 0 < figures['cpu [%]'] < 100
    assert 0 < figures['latency p50 [ms]'] <= figures['latency p99 [ms]'] < 1000


def test_standing_still_is_said_as_a_twist_of_zero(rig_file, rng):
    with node_process('fusion', rig_file=rig_file), ros_peer() as peer:
        twists = peer.collect(TwistWithCovarianceStamped, 'zero_velocity')
        peer.wait_for_matches([f'{n}/data_registered' for n in NAMES], ['zero_velocity'])
        stream(peer, 'registered', resting_scans(rng, 150, time.time_ns()))
    assert len(twists) > 50  # the detector needs a window first
    assert twists[-1].header.frame_id == 'base_link'
    assert twists[-1].twist.covariance[0] > 0


def test_services_reset_and_disable(rig_file, rng):
    with node_process('fusion', rig_file=rig_file), ros_peer() as peer:
        diagnostics = peer.collect(DiagnosticArray, '/diagnostics', depth=10)
        peer.wait_for_matches([f'{n}/data_registered' for n in NAMES], ['/diagnostics'])
        stream(peer, 'registered', resting_scans(rng, 100, time.time_ns()))
        answer = peer.call(SetBool, 'fusion/enable_imu1', SetBool.Request(data=False))
        assert answer.message == 'imu1 is disabled.'
        peer.spin(0.5)
        assert statuses(diagnostics)['fusion: imu1'].message == 'disabled'
        assert peer.call(Trigger, 'fusion/reset', Trigger.Request()).success


def test_one_that_drifted_is_named_and_what_the_rest_taught_is_saved(rig_file, rng):
    before, start_ns = load_rig(rig_file), time.time_ns()
    scans = resting_scans(rng, 600, start_ns)
    for scan in scans:
        scan[2][2][3] += 5.0  # across gravity; 8 times what the data sheet's 0.4 m/s^2 explain
    with node_process('fusion', rig_file=rig_file), ros_peer() as peer:
        diagnostics = peer.collect(DiagnosticArray, '/diagnostics', depth=10)
        peer.wait_for_matches([f'{n}/data_registered' for n in NAMES], ['/diagnostics'])
        answer = peer.call(Trigger, 'fusion/save_biases', Trigger.Request())
        assert not answer.success
        assert 'lay it down for a few seconds' in answer.message
        assert load_rig(rig_file) == before
        stream(peer, 'registered', scans, pace=0.003)  # six seconds by the stamps
        peer.wait_until(lambda: statuses(diagnostics)['fusion: imu2'].level == b'\x01')
        sick, *others = (statuses(diagnostics)[f'fusion: {n}'] for n in ('imu2', 'imu0', 'fusion'))
        assert peer.call(Trigger, 'fusion/save_biases', Trigger.Request()).success
    assert sick.message.startswith('recalibrate imu2: its force is off by 5 m/s^2, ')
    assert [status.message for status in others] == ['ok', 'ok']  # it is still made use of
    figures = {pair.key: float(pair.value) for pair in sick.values}
    assert figures['force beside the others [m/s^2]'] == pytest.approx(5.0, abs=0.05)
    # 0.4 m/s^2 of bias, 1 % of scale and tilt of 9.8 m/s^2, beside the mean of two such.
    sigma = figures['force beside the others, sigma [m/s^2]']
    assert sigma == pytest.approx(np.sqrt(1.5) * 0.43, rel=0.05)
    assert load_rig(f'{rig_file}.old') == before
    for imu in load_rig(rig_file).imus:
        assert 0 < imu.intrinsics.gyroscope.bias_sigma[0] < 2e-3  # g-sensitivity: 9e-4
        assert imu.intrinsics.accelerometer.bias_sigma is None
        assert 4.0 < imu.provenance['biases_rest_s'] < 6.0
        last = datetime.fromisoformat(imu.provenance['biases_last_rest']).timestamp()
        assert 4.0 < last - start_ns * 1e-9 < 6.0
        assert imu.provenance['biases_saved'] >= datetime.fromtimestamp(
            start_ns // 10**9, UTC
        ).isoformat(timespec='seconds')


def test_the_pipeline_also_says_the_stages_that_somebody_wants(rig_file, rng):
    with node_process('pipeline', rig_file=rig_file), ros_peer() as peer:
        calibrated = peer.collect(ImuMessage, 'imu0/data_calibrated')
        registered = peer.collect(ImuMessage, 'imu1/data_registered')
        outputs = ['imu0/data_calibrated', 'imu1/data_registered']
        peer.wait_for_matches([f'{n}/data_raw' for n in NAMES], outputs)
        scans = resting_scans(rng, 20, time.time_ns())
        stream(peer, 'raw', scans)
        peer.wait_until(lambda: len(calibrated) == len(registered) == 20)
    assert calibrated[0].header.frame_id == 'imu0_link'
    x, y, z = scans[0][1][2][:3]  # imu1 is turned by 180 deg about z
    assert_allclose(imu_values(registered[0])[:3], [-x, -y, z], atol=1e-12)


def test_publish_tf_without_tf2_is_one_sentence(rig_file):
    pytest.importorskip('rclpy')
    try:
        import tf2_ros  # noqa: F401
    except ImportError:
        with node_process('fusion', rig_file=rig_file, publish_tf='true') as process:
            assert process.wait() == 1
            assert '`publish_tf` needs tf2_ros' in process.text
    else:
        pytest.skip('tf2_ros is installed')


def test_an_unknown_profile_is_refused_with_the_known_ones(rig_file):
    with node_process('fusion', rig_file=rig_file, profile='boat') as process:
        assert process.wait() == 1
        assert "`profile` must be one of 'hand', 'foot', 'vehicle', got 'boat'" in process.text


def test_the_pipeline_reads_a_port_by_itself(rig_file, tmp_path):
    link = tmp_path / 'port'
    board = subprocess.Popen(
        [sys.executable, '-c', 'from multiimu_ros.cli.emulator import main; main()',
         '--rig', rig_file, '--motion', 'static', '--duration', '60', '--link', link],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        with node_process('pipeline', rig_file=rig_file, port=link) as process, ros_peer() as peer:
            imus, raw = peer.collect(ImuMessage, 'imu/data'), peer.collect(ImuMessage, RAW)
            peer.wait_until(lambda: len(imus) > 100 and len(raw) > 100, 20.0)
            assert process.end()[0] == 0
    finally:
        board.kill()
        board.wait()
    force = np.linalg.norm(imu_values(imus[-1])[3:])
    assert abs(force - 9.81) < 0.3  # three uncalibrated accelerometers
