"""Calibration and registration as processes: a message in gives the core's answer out."""

import time

from diagnostic_msgs.msg import DiagnosticArray
from diagnostics_page import told
import numpy as np
from numpy.testing import assert_allclose
import pytest
from ros_helpers import imu_message, imu_values, node_process, ros_peer
from sensor_msgs.msg import Imu as ImuMessage
import yaml

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import load_rig

pytestmark = pytest.mark.ros

READING = [0.1, -0.2, 0.3, 1.0, 2.0, 9.0]
RATE_HZ = 100  # of the stamps; the covariances depend on it
DENSITY = {'accelerometer': [2e-3] * 3, 'gyroscope': [1e-4] * 3}
KNOWN = {'scale_sigma': [0.0] * 3, 'bias_sigma': [0.0] * 3}  # only white noise is left
IMU = {
    'name': 'imu0',
    'frame_id': 'imu0_link',
    'intrinsics': {
        'gyroscope': {'scale': [1.1, 1.0, 1.0], 'bias': [0.01, 0.0, 0.0], **KNOWN},
        'accelerometer': {
            'misalignment': [[1, 0.02, 0], [0, 1, 0], [0, 0, 1]], 'bias': [0, 0.1, 0], **KNOWN
        },
    },
    'noise': {'noise_density': DENSITY},
    'extrinsics': {'rotation': [0.0, 0.0, 0.6, 0.8], 'rotation_sigma': [0, 0, 0]},
    'time_offset': 0.002,
}  # fmt: skip


@pytest.fixture
def rig_file(tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text(yaml.safe_dump({'version': 1, 'rig': {'name': 'one'}, 'imus': [IMU]}))
    return path


def stamps(n):
    start = time.time_ns()
    return [start + k * 10**9 // RATE_HZ for k in range(n)]


def exchange(name, rig_file, send_to, hear_from, messages):
    """Return what the node answers to these messages."""
    with node_process(name, rig_file=rig_file) as process, ros_peer() as peer:
        answers = peer.collect(ImuMessage, hear_from)
        peer.wait_for_matches([send_to], [hear_from])
        for msg in messages:
            peer.send(send_to, msg)
        peer.wait_until(lambda: len(answers) == len(messages), 5.0)
        assert process.end()[0] == 0
    return answers


def test_calibration_gives_the_sensor_models_answer_with_its_stamp_and_frame(rig_file):
    sent = [imu_message('imu0_link', stamp, READING) for stamp in stamps(20)]
    answers = exchange('calibration', rig_file, 'imu0/data_raw', 'imu0/data_calibrated', sent)
    A, c = affine(load_rig(rig_file).imus[0].intrinsics)
    for before, after in zip(sent, answers, strict=True):
        assert after.header == before.header
        assert_allclose(imu_values(after), A @ READING + c, rtol=1e-12)
        assert after.orientation_covariance[0] == -1  # REP 145: there is none


def test_calibration_covariance_is_the_noise_density_at_the_measured_rate(rig_file):
    sent = [imu_message('imu0_link', stamp, READING) for stamp in stamps(20)]
    answers = exchange('calibration', rig_file, 'imu0/data_raw', 'imu0/data_calibrated', sent)
    assert not answers[0].angular_velocity_covariance.any()  # zeros: unknown, as the rate is
    last = answers[-1]
    assert_allclose(
        last.angular_velocity_covariance.reshape(3, 3), 1e-4**2 * RATE_HZ * np.eye(3), rtol=1e-6
    )
    assert_allclose(
        last.linear_acceleration_covariance.reshape(3, 3), 2e-3**2 * RATE_HZ * np.eye(3), rtol=1e-6
    )


def test_registration_rotates_vectors_and_covariances_and_moves_the_stamp(rig_file):
    C = np.array([[3.0, 1.0, 0.0], [1.0, 2.0, 0.5], [0.0, 0.5, 1.0]])
    stamp = stamps(1)[0]
    sent = imu_message('imu0_link', stamp, READING)
    sent.angular_velocity_covariance = C.ravel()
    sent.linear_acceleration_covariance = 2 * C.ravel()
    [answer] = exchange(
        'registration', rig_file, 'imu0/data_calibrated', 'imu0/data_registered', [sent]
    )
    A, offset_ns = mounting(load_rig(rig_file).imus[0])
    R = A[:3, :3]
    assert answer.header.frame_id == 'base_link'
    assert answer.header.stamp.sec * 10**9 + answer.header.stamp.nanosec == stamp + offset_ns
    assert_allclose(imu_values(answer), A @ READING, rtol=1e-12)
    rotated = answer.angular_velocity_covariance.reshape(3, 3)
    assert_allclose(rotated, R @ C @ R.T, rtol=1e-12, atol=1e-15)
    doubled = answer.linear_acceleration_covariance.reshape(3, 3)
    assert_allclose(doubled, 2 * R @ C @ R.T, rtol=1e-12, atol=1e-15)


def test_what_is_not_a_number_is_never_published(rig_file):
    with node_process('calibration', rig_file=rig_file), ros_peer() as peer:
        answers = peer.collect(ImuMessage, 'imu0/data_calibrated')
        peer.wait_for_matches(['imu0/data_raw'], ['imu0/data_calibrated'])
        for stamp in stamps(5):
            peer.send('imu0/data_raw', imu_message('a', stamp, [np.nan, *READING[1:]]))
            peer.send('imu0/data_raw', imu_message('a', stamp, READING))
        peer.wait_until(lambda: len(answers) == 5, 5.0)
        peer.spin(0.2)
    assert len(answers) == 5
    assert np.isfinite([imu_values(answer) for answer in answers]).all()


def figures(said):
    """Return the names of the figures of each status that was said."""
    lines = [line for array in said for line in array.status]
    return {line.name: sorted(value.key for value in line.values) for line in lines}


def test_diagnostics_tell_who_has_met_whom(rig_file):
    def ends():
        lines = [line for array in said for line in array.status]
        own = [line for line in lines if line.name == 'calibration: imu0']
        values = {value.key: value.value for value in own[-1].values} if own else {}
        return values.get('publishers'), values.get('subscribers')

    with node_process('calibration', rig_file=rig_file), ros_peer() as peer:
        said = peer.collect(DiagnosticArray, '/diagnostics', depth=10)
        peer.wait_until(lambda: ends() == ('0', '0'), 5.0)
        peer.collect(ImuMessage, 'imu0/data_calibrated')
        peer.wait_for_matches(['imu0/data_raw'], ['imu0/data_calibrated'])
        peer.wait_until(lambda: ends() == ('1', '1'), 5.0)
        peer.wait_until(lambda: 'calibration: node' in figures(said), 5.0)
    assert told('calibration: imu<k>') == figures(said)['calibration: imu0']
    assert told('node') == figures(said)['calibration: node']


@pytest.mark.parametrize('name', ['calibration', 'registration', 'fusion'])
def test_a_bad_rig_file_ends_the_node_with_one_sentence(name, tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text('version: 1\nrig: {name: x}\nimus: [{name: imu0, frame_id: a, modle: b}]\n')
    with node_process(name, rig_file=path) as process:
        assert process.wait() == 1
        assert f'{path}: `imus[0].modle`: ' in process.text
        assert 'Traceback' not in process.text


def test_a_topic_list_of_the_wrong_length_is_refused(rig_file):
    with node_process('calibration', rig_file=rig_file, topics='[a, b]') as process:
        assert process.wait() == 1
        assert 'Parameter `topics` must name 1 topics, got 2' in process.text
