"""Biases back into the rig file: what the filters found is gone from the readings afterwards."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.biases import with_biases
from multiimu_ros.pipeline import Rest
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import parse_rig

REST = Rest(12.349, 82_800_000_000_000)  # 23 hours


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
def test_the_saved_rate_bias_is_gone_from_the_registered_readings(seed):
    rng = np.random.default_rng(seed)
    rig, raw, bias = skewed_rig(rng), rng.standard_normal(6), rng.standard_normal(6)
    corrected = with_biases(rig, bias[None], np.ones((1, 6)), REST, 0.0)
    # What one pose shows of an accelerometer is bias, scale and tilt together: it stays out.
    gone = bias * [1, 1, 1, 0, 0, 0]
    assert_allclose(readings(corrected, raw), readings(rig, raw) - gone, atol=1e-12)


def bare_rig(**imu):
    imus = [{'name': name, 'frame_id': 'x'} | imu for name in ('a', 'b')]
    return parse_rig({'version': 1, 'rig': {'name': 'x'}, 'imus': imus}, 'test')


def test_date_rest_and_sigma_are_kept():
    variances = np.tile([1.0, 4.0, 9.0, 16.0, 25.0, 36.0], (2, 1))
    rig = bare_rig(provenance={'bag': 'y'})
    imu = with_biases(rig, np.zeros((2, 6)), variances, REST, 86400.7).imus[0]
    assert imu.provenance == {
        'bag': 'y',
        'biases_saved': '1970-01-02T00:00:00+00:00',
        'biases_source': 'attitude filter at rest, gyroscope only',
        'biases_rest_s': 12.35,
        'biases_last_rest': '1970-01-01T23:00:00+00:00',
    }
    assert imu.intrinsics.gyroscope.bias_sigma == (1.0, 2.0, 3.0)


def test_the_accelerometer_stays_as_the_calibration_left_it():
    triad = {'bias': [0.1, 0.2, 0.3], 'bias_sigma': [1e-3] * 3}
    rig = bare_rig(intrinsics={'accelerometer': triad})
    corrected = with_biases(rig, np.ones((2, 6)), np.ones((2, 6)), REST, 0.0)
    assert corrected.imus[0].intrinsics.accelerometer == rig.imus[0].intrinsics.accelerometer
    nominal = with_biases(bare_rig(), np.ones((2, 6)), np.ones((2, 6)), REST, 0.0)
    assert nominal.imus[0].intrinsics.accelerometer.bias_sigma is None


def test_an_imu_that_did_not_rest_with_the_others_stays_as_it_is():
    biases = np.ones((2, 6))
    biases[1] = np.nan
    rig = bare_rig()
    corrected = with_biases(rig, biases, np.ones((2, 6)), REST, 0.0)
    assert corrected.imus[0] != rig.imus[0]
    assert corrected.imus[1] == rig.imus[1]


@pytest.mark.parametrize(('seconds', 'bias'), [(0.0, 1.0), (5.0, np.nan)])
def test_a_rig_that_never_rested_is_told_to(seconds, bias):
    with pytest.raises(ConfigError, match='lay it down for a few seconds and call `save_biases`'):
        with_biases(bare_rig(), np.full((2, 6), bias), np.ones((2, 6)), Rest(seconds, 0), 0.0)
