"""Biases back into the rig file: what the filters found is gone from the readings afterwards."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.nodes.biases import with_biases
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import parse_rig


def skewed_rig(rng):
    """Return a rig of one IMU with every kind of error."""
    upper = np.eye(3) + np.triu(0.02 * rng.standard_normal((3, 3)), 1)
    triad = {'misalignment': upper.tolist(), 'scale': [1.1, 0.9, 1.05], 'bias': [0.1, 0.2, 0.3]}
    coupling = (1e-4 * rng.standard_normal((3, 3))).tolist()
    gyroscope = triad | {'g_sensitivity': coupling}
    imu = {
        'name': 'imu0',
        'frame_id': 'a',
        'intrinsics': {'accelerometer': triad, 'gyroscope': gyroscope},
        'extrinsics': {'rotation': Rotation.random(random_state=rng).as_quat().tolist()},
    }
    return parse_rig({'version': 1, 'rig': {'name': 'x'}, 'imus': [imu]}, 'test')


def readings(rig, raw):
    """Return what a raw reading becomes in the base frame."""
    A, c = affine(rig.imus[0].intrinsics)
    return mounting(rig.imus[0])[0] @ (A @ raw + c)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_saved_bias_is_gone_from_the_registered_readings(seed):
    rng = np.random.default_rng(seed)
    rig, raw, bias = skewed_rig(rng), rng.standard_normal(6), rng.standard_normal(6)
    corrected = with_biases(rig, bias[None], np.ones((1, 6)), 0.0)
    assert_allclose(readings(corrected, raw), readings(rig, raw) - bias, atol=1e-12)


def test_age_and_sigma_are_kept(rng):
    rig = parse_rig(
        {'version': 1, 'rig': {'name': 'x'}, 'imus': [{'name': 'a', 'frame_id': 'a'}]}, 'test'
    )
    variances = np.array([[1.0, 4.0, 9.0, 16.0, 25.0, 36.0]])
    imu = with_biases(rig, np.zeros((1, 6)), variances, 86400.0).imus[0]
    assert imu.provenance == {'biases_saved': '1970-01-02T00:00:00+00:00'}
    assert imu.intrinsics.gyroscope.bias_sigma == (1.0, 2.0, 3.0)
    assert imu.intrinsics.accelerometer.bias_sigma == (4.0, 5.0, 6.0)
