"""The attitude filter: alignment, rest, honest covariance, gaps and rubbish."""

from dataclasses import replace

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import filters, FORCE_DENSITY, G, nees, RATE_DENSITY, run, to_start_frame
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.attitude import AttitudeConfig, AttitudeFilter, level
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.rotations import log_so3

DENSITIES = RATE_DENSITY, FORCE_DENSITY
CONFIG = AttitudeConfig(
    rate_bias_sigma=np.full(3, 2e-3),
    force_bias_sigma=np.full(3, 0.03),
    rate_bias_walk=np.full(3, 4e-6),
    motion_sigma=0.5,
    still_sigma=0.03,
    motion_reach=0.1,
    still_velocity_sigma=0.005,
    still_velocity_time=0.05,
)


def resting(rng, seconds, rate_hz=200, bias=(0.0, 0.0, 0.0), up=(0.0, 0.0, G)):
    """Return a filter that has rested, and knew it."""
    attitude = AttitudeFilter(CONFIG)
    noise = np.sqrt(rate_hz) * rng.standard_normal((round(seconds * rate_hz), 2, 3))
    for w, f in noise:
        rate, force = np.array(bias) + RATE_DENSITY * w, np.array(up) + FORCE_DENSITY * f
        attitude.push(Sample(1 / rate_hz, rate, force, *DENSITIES, True, True))
    return attitude


@given(st.floats(0.0, np.pi), st.floats(0.0, 2 * np.pi))
def test_level_puts_the_force_upright_and_yaw_at_zero(polar, azimuth):
    up = Rotation.from_euler('YZ', [polar, azimuth]).as_matrix()[2]
    R = level(G * up)
    assert_allclose(R @ up, [0.0, 0.0, 1.0], atol=1e-12)
    assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    if abs(up[0]) < 0.999:
        assert abs(np.arctan2(R[1, 0], R[0, 0])) < 1e-9


def test_rest_finds_the_gyro_bias_and_its_uncertainty(rng):
    bias = np.array([1e-3, -2e-3, 5e-4])
    attitude = resting(rng, 20.0, bias=bias)
    sigma = np.sqrt(np.diag(attitude.P))[3:]
    # Density / sqrt(time less lag), and a third of the bias walk's variance.
    assert_allclose(sigma, np.hypot(1.2e-4 / np.sqrt(19.75), 4e-6 * np.sqrt(20.0 / 3)), rtol=0.05)
    assert (abs(attitude.gyro_bias - bias) < 4 * sigma).all()


def test_tilt_never_claims_more_than_the_accelerometer_bias_allows(rng):
    attitude = resting(rng, 20.0)
    tilt = np.sqrt(np.diag(attitude.P))[:2]
    assert_allclose(tilt, 0.03 / G, rtol=0.03)
    # Considered, never estimated: even the vertical part, which |f| would show, stays unknown.
    assert_allclose(attitude._P[9:, 9:], 0.03**2 * np.eye(3), atol=1e-12)


def test_yaw_variance_grows_in_motion_and_stops_at_rest(rng):
    attitude = resting(rng, 5.0)
    before = attitude.P[2, 2]
    up = np.array([0.0, 0.0, G])
    for _ in range(2000):
        attitude.push(Sample(0.005, attitude.gyro_bias, up, *DENSITIES, False, False))
    grown = attitude.P[2, 2] - before
    # 10 s of white noise, and of a bias known to density / sqrt(4.75 s): lag excluded.
    assert_allclose(grown, 1.2e-4**2 * (10 + 100 / 4.75), rtol=0.1)
    held = attitude.P[2, 2]
    for _ in range(200):
        attitude.push(Sample(0.005, attitude.gyro_bias, up, *DENSITIES, True, True))
    assert attitude.P[2, 2] < held + 1e-9


@pytest.mark.slow  # where nothing is compiled
def test_uncertainty_is_what_the_error_is():
    errors = []
    for seed in range(6):
        ran = run('hand', 'hand', 30.0, 200, seed)
        true_R, _, _ = to_start_frame(ran.motion)
        for k in range(1400, len(true_R), 200):
            R, bias, P = ran.attitude[k]
            theta = log_so3(np.ascontiguousarray(R.T @ true_R[k]))
            errors.append((nees(theta, P[:3, :3]), nees(ran.gyro_bias[k] - bias, P[3:, 3:])))
    # 6 independent runs of 3 axes: standard error about sqrt(2 / 18) = 0.33 at worst.
    assert_allclose(np.mean(errors, axis=0), 1.0, atol=0.66)


def test_a_gap_is_bridged_with_the_last_rate_and_admitted(rng):
    attitude = resting(rng, 3.0)
    turn, up = np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, G])
    attitude.push(Sample(0.005, turn, up, *DENSITIES, False, False))
    before = attitude.P[2, 2]
    attitude.push(Sample(2.0, turn, up, *DENSITIES, False, False))
    yaw = np.arctan2(attitude.R_nb[1, 0], attitude.R_nb[0, 0])
    assert abs(yaw - 1.0) < 0.01
    assert attitude.P[2, 2] - before > 1.0  # nobody saw what happened in 2 s


def test_what_is_not_finite_is_bridged(rng):
    attitude, other = resting(rng, 2.0), resting(np.random.default_rng(20260711), 2.0)
    turn, up = np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, G])
    attitude.push(Sample(0.01, np.full(3, np.nan), up, *DENSITIES, False, False))
    attitude.push(Sample(0.01, turn, np.full(3, np.inf), *DENSITIES, False, False))
    attitude.push(Sample(0.01, turn, up, *DENSITIES, False, False))
    other.push(Sample(0.03, turn, up, *DENSITIES, False, False))
    assert_allclose(attitude.R_nb, other.R_nb, atol=1e-12)
    assert np.isfinite(attitude.P).all()


def test_a_saved_bias_is_taken_up():
    _, attitude, _ = filters('hand')
    attitude.restore_gyro_bias(np.array([0.01, 0.0, 0.0]), np.full(3, 1e-4))
    assert attitude.gyro_bias[0] == 0.01
    assert_allclose(np.diag(attitude.P)[3:], 1e-8)


def test_alignment_by_the_mean_of_a_still_start():
    attitude = AttitudeFilter(CONFIG)
    assert not attitude.aligned
    tilted = Rotation.from_euler('YX', [0.3, -0.2]).as_matrix()
    attitude.align(1.01 * G * tilted[2], 0.01)
    assert attitude.aligned
    assert_allclose(attitude.R_nb, tilted, atol=1e-12)


def test_bad_settings_are_named():
    with pytest.raises(ValueError, match='`motion_sigma` must not be negative, got nan'):
        replace(CONFIG, motion_sigma=np.nan)
