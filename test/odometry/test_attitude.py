"""The attitude filter: alignment, rest, honest covariance, gaps and rubbish."""

from dataclasses import replace

from attitude_runs import attitude_error_of_eight, CONFIG
from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import filters, FORCE_DENSITY, G, nees, RATE_DENSITY, run, to_start_frame
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.attitude import AttitudeFilter, level
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.rotations import log_so3

DENSITIES = RATE_DENSITY, FORCE_DENSITY


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


@pytest.mark.compiled
def test_rest_finds_the_gyro_bias_and_its_uncertainty(rng):
    bias = np.array([1e-3, -2e-3, 5e-4])
    attitude = resting(rng, 20.0, bias=bias)
    sigma = np.sqrt(np.diag(attitude.P))[3:]
    # Density / sqrt(time less lag), and a third of the bias walk's variance.
    assert_allclose(sigma, np.hypot(1.2e-4 / np.sqrt(19.75), 4e-6 * np.sqrt(20.0 / 3)), rtol=0.05)
    assert (abs(attitude.gyro_bias - bias) < 4 * sigma).all()


@pytest.mark.compiled
def test_tilt_never_claims_more_than_the_accelerometer_bias_allows(rng):
    attitude = resting(rng, 20.0)
    tilt = np.sqrt(np.diag(attitude.P))[:2]
    assert_allclose(tilt, 0.03 / G, rtol=0.03)
    # Considered, never estimated: even the vertical part, which |f| would show, stays unknown.
    assert_allclose(attitude._P[9:, 9:], 0.03**2 * np.eye(3), atol=1e-12)


@pytest.mark.compiled
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


@pytest.mark.long
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


@pytest.mark.long
@pytest.mark.slow
def test_yaw_drifts_as_its_variance_says_over_five_minutes():
    ratios, dt = [], 0.04
    for seed in range(24):
        rng = np.random.default_rng(seed)
        attitude, bias = AttitudeFilter(CONFIG), 1e-4 * rng.standard_normal(3)
        attitude.restore_gyro_bias(np.zeros(3), np.full(3, 1e-4))
        noise = rng.standard_normal((round(300.0 / dt), 3, 3)) / np.sqrt(dt)
        for white, push, walk in noise:
            rate = bias + RATE_DENSITY * white
            force = np.array([0.0, 0.0, G]) + FORCE_DENSITY * push
            attitude.step(Sample(dt, rate, force, *DENSITIES, False, False))
            bias = bias + 4e-6 * dt * walk
        yaw = np.arctan2(attitude.R_nb[1, 0], attitude.R_nb[0, 0])
        ratios.append(yaw**2 / attitude.P[2, 2])
    # Chi-squared with 24 degrees of freedom: standard error sqrt(2 / 24) = 0.29.
    assert_allclose(np.mean(ratios), 1.0, atol=0.58)


@pytest.mark.slow
@pytest.mark.long
def test_eight_imus_hold_the_attitude_of_a_hand_for_five_minutes():
    tilt, yaw = np.median([attitude_error_of_eight(seed, 300.0, 100.0) for seed in (1, 2, 3)], 0)
    # Measured: 0.011 and 0.043 deg; 0.010 and 0.060 at 200 Hz, medians of five.
    assert tilt <= 0.10
    assert yaw <= 0.15


def sway(attitude, seconds, amplitude, omega=3.0, dt=0.02):
    """Push a level rig to and fro along x; return its largest tilt [rad] after the first half."""
    tilts = []
    for k in range(round(seconds / dt)):
        force = np.array([amplitude * np.cos(omega * k * dt), 0.0, G])
        attitude.push(Sample(dt, np.zeros(3), force, *DENSITIES, False, False))
        tilts.append(np.arccos(min(1.0, attitude.R_nb[2, 2])))
    return max(tilts[len(tilts) // 2 :])


@pytest.mark.compiled
def test_the_acceleration_of_a_bounded_motion_hardly_tilts(rng):
    # 2 m/s^2 look like a tilt of 0.2 rad, a hundred times what is left.
    assert sway(resting(rng, 3.0), 20.0, amplitude=2.0) < 0.002


@pytest.mark.compiled
def test_a_wrong_tilt_is_found_from_motion(rng):
    attitude = AttitudeFilter(replace(CONFIG, rate_bias_sigma=np.zeros(3)))
    attitude.align(np.array([1.0, 0.0, G]), 1.0)  # 0.1 rad wrong, and known to be so
    sway(attitude, 30.0, amplitude=1.0)
    tilt = np.arccos(min(1.0, attitude.R_nb[2, 2]))
    assert tilt < 0.01
    assert tilt < 3.0 * np.sqrt(attitude.P[0, 0] + attitude.P[1, 1])


def test_a_rate_that_is_wrong_in_proportion_widens_tilt_and_only_its_own_turn_yaw(rng):
    up, grown = np.array([0.0, 0.0, G]), {}
    for axis in (0, 2):
        attitude = AttitudeFilter(replace(CONFIG, rate_scale_sigma=0.01))
        attitude.restore_gyro_bias(np.zeros(3), np.zeros(3))
        rate, R = np.zeros(3), np.eye(3)
        rate[axis] = 1.0
        for k in range(200):
            R = Rotation.from_rotvec(rate * 0.005 * k).as_matrix()
            attitude.push(Sample(0.005, rate, R.T @ up, *DENSITIES, False, False))
        P = R @ attitude.P[:3, :3] @ R.T
        grown[axis] = P[2, 2]
    # A second of it: s^2 w^2 sqrt(reach / acceleration), beside N^2.
    assert_allclose(grown[2], 1e-4 * np.sqrt(0.1 / 0.5) + 1.2e-4**2, rtol=0.02)
    assert grown[0] < 0.01 * grown[2]


def test_a_rolling_foot_is_still_though_its_force_is_not_gravity():
    attitude = AttitudeFilter(replace(CONFIG, rolling_arm=0.1, rate_bias_sigma=np.zeros(3)))
    attitude.align(np.array([0.5, 0.0, G]), 0.5)
    for _ in range(100):
        force = np.array([0.0, 0.0, G])
        attitude.push(Sample(0.005, np.zeros(3), force, *DENSITIES, True, False))
    # Half a second at 5 mm/s: tilt is known to a few mrad, for velocity grows by g tilt t.
    assert np.arccos(min(1.0, attitude.R_nb[2, 2])) < 0.005


def test_steps_of_any_length_give_the_same_attitude():
    time = np.cumsum(np.random.default_rng(1).uniform(0.002, 0.008, 1000))
    attitude = AttitudeFilter(replace(CONFIG, rate_bias_sigma=np.zeros(3)))
    errors = []
    for step, t in zip(np.diff(time, prepend=0.0), time, strict=True):
        roll = 0.5 * np.sin(3.0 * t)
        force = np.array([0.0, G * np.sin(roll), G * np.cos(roll)])
        rate = np.array([1.5 * np.cos(3.0 * t), 0.0, 0.0])
        attitude.push(Sample(step, rate, force, *DENSITIES, False, False))
        errors.append(roll - np.arctan2(attitude.R_nb[2, 1], attitude.R_nb[2, 2]))
    # (w dt)^2 / 12 of the 0.5 rad, 1e-5, is what chords would leave; parabolas leave half of it.
    assert np.abs(errors).max() < 9e-6


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
