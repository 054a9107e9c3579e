"""The sources' scheme on a stream, and what both baselines share."""

from attitude_runs import CONFIG
import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import FORCE_DENSITY, G, RATE_DENSITY
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.madgwick import MadgwickAttitude
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.rk4_attitude import Rk4Attitude
from multiimu_ros.odometry.strapdown import attitude_rk4

BASELINES = (Rk4Attitude, MadgwickAttitude)
UP = np.array([0.0, 0.0, G])


def sample(rate, force=UP, dt=0.005):
    return Sample(dt, np.array(rate), np.array(force), RATE_DENSITY, FORCE_DENSITY, False, False)


def test_stream_agrees_with_batch(rng):
    rate, dt = rng.standard_normal((200, 3)), rng.uniform(0.004, 0.006, 199)
    stream, answers = Rk4Attitude(CONFIG), []
    for k in range(200):
        stream.push(sample(rate[k], dt=dt[k - 1] if k else 0.005))
        answers.append(stream.R_nb)
    # One kernel: not even rounding differs.
    assert_allclose(answers, attitude_rk4(np.eye(3), rate, dt), rtol=0, atol=0)


@pytest.mark.parametrize('kind', BASELINES)
def test_a_restored_bias_is_taken_off_and_yaw_told_to_drift(kind):
    bias, sigma = np.array([1e-3, -2e-3, 5e-3]), np.full(3, 1e-4)
    attitude = kind(CONFIG)
    attitude.restore_gyro_bias(bias, sigma)
    for _ in range(2001):
        attitude.push(sample(bias))
    assert_allclose(attitude.R_nb, np.eye(3), atol=1e-12)
    assert_allclose(attitude.gyro_bias, bias)
    # 10 s of white noise, of a constant bias, and of its walk: N^2 t + s^2 t^2 + K^2 t^3 / 3.
    expected = 1.2e-4**2 * 10 + (1e-4 * 10) ** 2 + 4e-6**2 * 1000 / 3
    assert_allclose(attitude.P[2, 2], expected, rtol=1e-3)
    assert (np.linalg.eigvalsh(attitude.P) > 0).all()


@pytest.mark.parametrize('kind', BASELINES)
def test_the_first_sample_aligns_and_what_is_not_finite_is_bridged(kind):
    tilted = Rotation.from_euler('YX', [0.3, -0.2]).as_matrix()
    attitude, other = kind(CONFIG), kind(CONFIG)
    assert not attitude.aligned
    attitude.push(sample([np.nan, 0.0, 0.0]))
    assert not attitude.aligned
    for each in (attitude, other):
        each.push(sample([0.0, 0.0, 0.0], G * tilted[2]))
        assert_allclose(each.R_nb, tilted, atol=1e-12)
    attitude.push(sample([0.0, 0.0, 0.5], [np.inf, 0.0, 0.0]))
    attitude.push(sample([0.0, 0.0, 0.5], G * tilted[2]))
    other.push(sample([0.0, 0.0, 0.5], G * tilted[2], dt=0.01))
    assert_allclose(attitude.R_nb, other.R_nb, rtol=1e-12)
