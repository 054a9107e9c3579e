"""Lever arms: exact without errors, honest with them, and unknown where nothing tells them."""

from functools import cache

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.interpolate import CubicSpline
from scipy.stats import chi2

from multiimu_ros.registration import lever_arms
from multiimu_ros.registration.lever_arms import (
    fit_lever_arms,
    lever_arm_matrices,
    REACH,
    weakest_axis,
)
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.paths import through
from multiimu_ros.simulation.trajectories import calibration_path

RATE = 50.0
NOISE = 0.02  # [m/s^2] of a sample: a BMI160 at 200 Hz, smoothed
ARMS = np.array([[0.08, 0.0, 0.0], [-0.04, 0.07, 0.01], [-0.04, -0.07, 0.0]])  # [m]
RELATIVE = ARMS - ARMS[0]


def matrices(rate, acceleration):
    return lever_arm_matrices(np.einsum('ni,nj->nij', rate, rate), acceleration)


@cache
def waved(seconds=20.0):
    """Return rate, angular acceleration and force (N, 3) of a board waved about by hand."""
    path = calibration_path(1, np.random.default_rng(4), waving=seconds)
    motion = Trajectory(path, 100.0).at(np.arange(17.0, 16.0 + seconds, 1 / RATE))
    return motion.angular_rate_b, motion.angular_acceleration_b, motion.specific_force_b


def felt(rate, acceleration, force, arms=ARMS):
    """Return what accelerometers at the arms feel (N, K, 3)."""
    return force[:, np.newaxis] + np.einsum('nij,kj->nki', matrices(rate, acceleration), arms)


def seconds_of(count):
    return (np.arange(count) / RATE).astype(np.int64)


def random_case(seed, seconds, noise=NOISE):
    """Return forces of noisy, biased, badly scaled accelerometers on a random motion, and L."""
    rng = np.random.default_rng(seed)
    knots = np.arange(-2.0, seconds + 2.0, 0.3)
    time = np.arange(0.0, seconds, 1 / RATE)
    path = CubicSpline(knots, rng.standard_normal((len(knots), 3)))
    force = CubicSpline(knots, [0, 0, 9.8] + 3 * rng.standard_normal((len(knots), 3)))(time)
    L = matrices(path(time), path(time, 1))
    mixing = 2e-4 * rng.standard_normal((3, 3, 3))
    forces = force[:, np.newaxis] + np.einsum('nij,kj->nki', L, ARMS)
    forces += np.einsum('kij,nj->nki', mixing, force) + 0.01 * rng.standard_normal((3, 3))
    return forces + noise * rng.standard_normal(forces.shape), L


@given(seed=st.integers(0, 2**32 - 1))
def test_L_times_an_arm_is_the_two_cross_products(seed):
    rate, acceleration, arm = np.random.default_rng(seed).standard_normal((3, 5, 3))
    naive = np.cross(acceleration, arm) + np.cross(rate, np.cross(rate, arm))
    found = np.einsum('nij,nj->ni', matrices(rate, acceleration), arm)
    assert_allclose(found, naive, rtol=1e-12, atol=1e-12)


def test_forces_without_errors_give_the_arms():
    rate, acceleration, _ = waved()
    fit = fit_lever_arms(felt(*waved()), matrices(rate, acceleration), seconds_of(len(rate)))
    # The prior weighs as much as the residuals say, which vanish: only rounding is left.
    assert_allclose(fit.position, RELATIVE, rtol=0, atol=1e-9)
    assert fit.residual_rms.max() < 1e-9
    before = felt(*waved()) - felt(*waved()).mean(axis=1, keepdims=True)
    assert_allclose(fit.residual_rms_before, np.sqrt((before**2).sum(axis=2).mean(axis=0)))
    assert not fit.position[0].any()
    assert not fit.covariance[0].any()


def test_a_common_shift_of_all_imus_is_not_seen():
    rate, acceleration, _ = waved()
    L, block = matrices(rate, acceleration), seconds_of(len(rate))
    shifted = fit_lever_arms(felt(*waved(), ARMS + np.array([0.02, -0.01, 0.03])), L, block)
    assert_allclose(shifted.position, RELATIVE, rtol=0, atol=1e-9)


@pytest.mark.parametrize('seconds', [20, 60])
def test_stated_sigmas_are_not_below_the_errors(seconds):
    z = []
    for seed in range(60):
        force, L = random_case(seed, seconds)
        fit = fit_lever_arms(force, L, seconds_of(len(L)))
        z.append(((fit.position - RELATIVE) / fit.sigma.clip(1e-12))[1:])
    square = np.mean(np.square(z))
    # 360 values, of which the two IMUs of a run share the noise of the first: 240 count.
    low, high = chi2(240).ppf([1e-3, 1 - 1e-3]) / 240
    # `_cautious` may make sigmas too wide, by a fifth where blocks are few.
    assert low / 1.2**2 < square < high
    assert np.mean(np.abs(z) < 1.96) > 0.92


def test_one_block_that_decides_the_fit_does_not_look_certain():
    # A turn of one second in twenty: its residual is fitted away, its leverage must not be.
    z = []
    for seed in range(60):
        force, L = random_case(seed, 20)
        weak = np.where(seconds_of(len(L)) == 7, 1.0, 0.1)
        quiet = L * weak[:, np.newaxis, np.newaxis]
        force = force - np.einsum('nij,kj->nki', L - quiet, ARMS)
        fit = fit_lever_arms(force, quiet, seconds_of(len(L)))
        z.append(((fit.position - RELATIVE) / fit.sigma.clip(1e-12))[1:])
    assert np.mean(np.abs(z) < 1.96) > 0.92


def test_a_stretch_that_happens_to_be_quiet_does_not_make_an_arm_certain():
    time = np.arange(0.0, 20.0, 1 / RATE)
    swing = np.column_stack((2 * np.sin(3 * time), 6 * np.cos(3 * time)))
    rate, acceleration = np.zeros((len(time), 3)), np.zeros((len(time), 3))
    for axis, part in ((0, time < 10.0), (2, time >= 10.0)):
        rate[part, axis], acceleration[part, axis] = swing[part].T
    force = np.tile([0.0, 0.0, 9.81], (len(time), 1))
    noise = NOISE * np.random.default_rng(8).standard_normal((len(time), 3, 3))
    L, block = matrices(rate, acceleration), seconds_of(len(time))
    even = fit_lever_arms(felt(rate, acceleration, force) + noise, L, block)
    noise[time >= 10.0] *= 0.01
    odd = fit_lever_arms(felt(rate, acceleration, force) + noise, L, block)
    # The quiet half alone tells x: 0.01 of its sigma by itself, 0.7 by the average level.
    assert 0.5 < odd.sigma[1, 0] / even.sigma[1, 0] < 1.0


def test_what_turns_about_one_axis_does_not_know_its_arms_along_it():
    time = np.arange(0.0, 20.0, 1 / RATE)
    rate, acceleration, force = (np.zeros((len(time), 3)) for _ in range(3))
    rate[:, 2], acceleration[:, 2] = 2 * np.sin(3 * time), 6 * np.cos(3 * time)
    force[:] = [0.0, 0.0, 9.81]
    rng = np.random.default_rng(1)
    forces = felt(rate, acceleration, force) + NOISE * rng.standard_normal((len(time), 3, 3))
    L = matrices(rate, acceleration)
    fit = fit_lever_arms(forces, L, seconds_of(len(time)))
    assert_allclose(fit.position[:, :2], RELATIVE[:, :2], rtol=0, atol=1e-3)
    assert fit.sigma[1:, :2].max() < 1e-3
    # Both ends of a difference are known by the prior only.
    assert_allclose(fit.sigma[1:, 2], np.sqrt(2) * REACH, rtol=0.5)
    drawn = fit_lever_arms(forces, L, seconds_of(len(time)), RELATIVE)
    assert_allclose(drawn.position[:, 2], RELATIVE[:, 2], rtol=0, atol=1e-4)  # what was drawn
    values, axes = weakest_axis(L)
    assert values[0] < 1e-12 * values[2]
    assert_allclose(np.abs(axes[:, 0]), [0.0, 0.0, 1.0], atol=1e-9)


def test_an_error_of_scale_would_pass_for_a_lever_arm(monkeypatch):
    goals = np.random.default_rng(2).uniform(-1.0, 1.0, (3, 20))
    path = through(3.0 * np.arange(20), roll=goals[0], pitch=goals[1], yaw=goals[2])
    motion = Trajectory(path, 57.0).at(np.arange(0.0, 57.0, 1 / RATE))
    rocked = motion.angular_rate_b, motion.angular_acceleration_b, motion.specific_force_b
    forces, L = felt(*rocked), matrices(*rocked[:2])
    forces[:, 1] *= 1 + 50e-6
    with_mixing = fit_lever_arms(forces, L, seconds_of(len(L)))
    # The mixing of the mean force explains all but the arms' own share: 50 ppm of 0.15 m.
    assert_allclose(with_mixing.position, RELATIVE, rtol=0, atol=10e-6)
    monkeypatch.setattr(lever_arms, 'MIXING', 1e-12)
    without = fit_lever_arms(forces, L, seconds_of(len(L)))
    # Gravity's share of 0.5 mm/s^2 swings with the tilt, as does the acceleration of 2 rad/s^2.
    assert np.abs(without.position - RELATIVE).max() > 50e-6


def test_noise_of_one_imu_is_in_its_own_sigma():
    force, L = random_case(3, 60)
    loud = force.copy()
    loud[:, 2] += 5 * NOISE * np.random.default_rng(9).standard_normal((len(L), 3))
    fit = fit_lever_arms(loud, L, seconds_of(len(L)))
    # sqrt((1 + 26) / 2) = 3.7, and less a third by the common mean, which the loud one joins.
    assert 2.0 < np.mean(fit.sigma[2] / fit.sigma[1]) < 4.5
