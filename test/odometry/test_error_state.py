"""The odometry filter: Jacobians, rest, honesty, and a walk around the block."""

from dataclasses import replace
import os
from pathlib import Path
import subprocess
import sys

import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import filters, FORCE_DENSITY, G, nees, RATE_DENSITY, read, run, to_start_frame
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.error_dynamics import transition
from multiimu_ros.odometry.error_state import (
    ErrorStateConfig,
    ErrorStateFilter,
    pose_covariance,
    twist_covariance,
)
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.strapdown import increments
from multiimu_ros.rotations import exp_so3, log_so3
from multiimu_ros.simulation.gait import duration_of
from multiimu_ros.simulation.trajectories import make_motion

DENSITIES = RATE_DENSITY, FORCE_DENSITY
UP = np.array([0.0, 0.0, G])


def moved(x, R, readings, dt):
    """Advance state x (15,) and R by the exact mechanisation, without covariance."""
    rate0, force0, rate1, force1 = readings
    bg, ba = x[9:12], x[12:15]
    phi, dv, dp = increments(rate0 - bg, force0 - ba, rate1 - bg, force1 - ba, dt)
    down = np.array([0.0, 0.0, -G])
    position = x[:3] + dt * x[3:6] + R @ dp + 0.5 * dt**2 * down
    return position, x[3:6] + R @ dv + dt * down, R @ exp_so3(phi)


def test_transition_is_the_derivative_of_the_mechanisation(rng):
    dt, R = 0.005, Rotation.random(rng=rng).as_matrix()
    rate, force = 3.0 * rng.standard_normal(3), UP + 5.0 * rng.standard_normal(3)
    readings = (rate, force, rate + 0.2, force - 0.5)
    p, v, turned = moved(np.zeros(15), R, readings, dt)
    numeric, step = np.empty((15, 15)), 1e-5
    for j in range(15):
        error = np.zeros(15)
        error[j] = step
        p1, v1, turned1 = moved(error, R @ exp_so3(error[6:9]), readings, dt)
        theta = log_so3(np.ascontiguousarray(turned.T @ turned1))
        numeric[:, j] = np.concatenate((p1 - p, v1 - v, theta, error[9:12], error[12:15])) / step
    F = transition(R, *increments(*readings, dt), dt)
    # What F leaves out is of order dt^3 |w| |f| = 4e-6; central terms agree far better.
    assert_allclose(F, numeric, atol=2e-5)


@pytest.mark.compiled
def test_a_standing_rig_stays_where_it_is(rng):
    for profile in ('hand', 'foot'):
        detector, _, odometry = filters(profile)
        still = make_motion('static', 60.0, 50)
        rate, force, *_ = read(still, rng, 50)
        positions = []
        for w, f in zip(rate, force, strict=True):
            odometry.push(Sample(0.02, w, f, *DENSITIES, *detector.push(0.02, w, f, *DENSITIES)))
            positions.append(odometry.position_n)
        # What moves is the first seconds, before rest is known; then nothing does.
        settled = np.array(positions[150:])
        assert np.abs(settled - settled[0]).max() < 1e-3
        assert np.abs(positions[-1]).max() < 3 * np.sqrt(odometry.P[0, 0])


@pytest.mark.long
@pytest.mark.slow  # where nothing is compiled
def test_uncertainty_is_what_the_error_is():
    scores = []
    for seed in range(6):
        ran = run('hand', 'hand', 30.0, 200, seed)
        true_R, true_p, true_v = to_start_frame(ran.motion)
        for k in range(1400, len(true_p), 200):
            p, v, R, bg, ba, P = ran.odometry[k]
            theta = log_so3(np.ascontiguousarray(R.T @ true_R[k]))
            errors = (true_p[k] - p, true_v[k] - v, theta)
            errors += (ran.gyro_bias[k] - bg, ran.accel_bias[k] - ba)
            blocks = [P[i : i + 3, i : i + 3] for i in range(0, 15, 3)]
            scores.append([nees(e, block) for e, block in zip(errors, blocks, strict=True)])
    # Errors last for a whole run: 6 runs of 3 axes have a standard error of sqrt(2/18) = 0.33.
    assert_allclose(np.mean(scores, axis=0), 1.0, atol=0.66)


@pytest.mark.slow  # where nothing is compiled
def test_a_walk_of_100_m_ends_where_it_began():
    ran = run('foot', 'foot', duration_of(100.0), 200, seed=1)
    _, true_p, _ = to_start_frame(ran.motion)
    error = np.array([state[0] for state in ran.odometry]) - true_p
    # A published-style 15-state filter with SHOE ends at 0.19 % of such a loop.
    assert np.linalg.norm(error[-1]) < 0.194
    assert np.sqrt(np.mean(np.sum(error**2, axis=1))) < 0.194
    P = ran.odometry[-1][-1]
    assert (np.abs(error[-1]) < 3 * np.sqrt(np.diag(P)[:3])).all()


def test_zero_velocity_tells_the_same_at_any_rate():
    sigmas = []
    for rate_hz in (100, 1000):
        _, _, odometry = filters('foot')
        for _ in range(rate_hz // 2):
            odometry.push(Sample(1 / rate_hz, np.zeros(3), UP, *DENSITIES, True, False))
        sigmas.append(np.sqrt(odometry.P[3, 3]))
    # 10 ms of correlation: at 100 Hz two updates count as one.
    assert_allclose(sigmas[0], sigmas[1], rtol=0.15)


def test_a_swing_that_looks_still_for_a_moment_is_not_believed():
    _, _, odometry = filters('foot')
    for _ in range(400):
        odometry.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, True, False))
    for _ in range(40):
        odometry.push(
            Sample(0.005, np.zeros(3), np.array([10.0, 0.0, G]), *DENSITIES, False, False)
        )
    speed = odometry.velocity_n[0]
    assert speed > 1.5
    odometry.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, True, False))
    assert abs(odometry.velocity_n[0] - speed) < 0.1
    for _ in range(100):  # 0.5 s is no swing any more
        odometry.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, True, False))
    assert abs(odometry.velocity_n[0]) < 0.1


def rocking(seconds, height, rate_hz=200):
    """Return rates and forces (N, 3) of a rig that rocks by 0.1 rad about a point below it."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz
    turn = 2 * np.pi * 1.0
    pitch, rate = 0.1 * (1 - np.cos(turn * t)), 0.1 * turn * np.sin(turn * t)
    slope = 0.1 * turn**2 * np.cos(turn * t)  # of the rate
    # In the body frame the rig is at [0, 0, height] from the point: a = dw x r + w x (w x r).
    acceleration = np.stack([slope * height, 0 * t, -(rate**2) * height], axis=1)
    up = np.stack([-np.sin(pitch), 0 * t, np.cos(pitch)], axis=1)
    return np.stack([0 * t, rate, 0 * t], axis=1), acceleration + G * up


def rock(rolling_height, seconds):
    """Return what a filter with such a height makes of a rig that rocks 0.1 m above a point."""
    _, _, odometry = filters('foot')
    odometry = ErrorStateFilter(replace(odometry._config, rolling_height=rolling_height))
    for w, f in zip(*rocking(seconds, 0.1), strict=True):
        odometry.push(Sample(0.005, w, f, *DENSITIES, True, False))
    return odometry


def test_a_stance_that_rolls_moves_with_the_foot():
    # After half a turn the rig has rocked by 0.2 rad, 0.1 m above the ground.
    flat, rolling = (rock(height, 0.5).position_n[0] for height in (0.0, 0.1))
    truth = 0.1 * np.sin(0.2)
    assert abs(rolling - truth) < 0.1 * truth
    assert abs(flat - truth) > 0.3 * truth


def test_a_stance_that_rolls_tells_neither_gyro_bias_nor_yaw(rng):
    odometry = rock(0.04, 0.5)
    _, _, before = filters('foot')
    yaw = np.arctan2(odometry.R_nb[1, 0], odometry.R_nb[0, 0])
    # It only turned about y: yaw would come of corrections alone, bias as well.
    assert abs(yaw) < 1e-9
    assert not odometry.gyro_bias.any()
    assert_allclose(odometry.P[9:12, 9:12], before.P[9:12, 9:12], rtol=1e-3)


def test_the_rate_at_which_a_stance_began_counts_against_it():
    def velocity_sigma(settling_time):
        _, _, odometry = filters('foot')
        odometry = ErrorStateFilter(replace(odometry._config, settling_time=settling_time))
        odometry.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, False, False))
        odometry.push(Sample(0.005, np.array([0.0, 2.0, 0.0]), UP, *DENSITIES, False, False))
        for _ in range(4):
            odometry.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, True, False))
        return np.sqrt(odometry.P[5, 5])

    at_once, settled = velocity_sigma(0.0), velocity_sigma(0.03)
    # 0.15 m times 2 rad/s, less what 20 ms forget, over what 3 mm/s of a foot at rest leave.
    assert settled > 10 * at_once


def stride_variance(error, strides=4):
    """Return the variance of a velocity after `strides` whose swings are misread by `error`."""
    _, _, odometry = filters('foot')
    for _ in range(strides):
        for _ in range(20):
            odometry.push(Sample(0.02, np.zeros(3), UP, *DENSITIES, True, False))
        for push in np.repeat([8.0 + error, -8.0], 15):
            force = np.array([push, 0.0, G])
            odometry.push(Sample(0.02, np.zeros(3), force, *DENSITIES, False, False))
    return odometry.P[3, 3]


def test_stances_tell_how_large_the_errors_of_a_swing_are():
    exact, poor, worse = (stride_variance(error) for error in (0.0, 1.0, 3.0))
    # Misread by 1 m/s^2 for 0.3 s, a stance corrects 0.3 m/s; a tenth of that surprise is learnt.
    assert exact < 0.8 * poor < 0.8 * worse  # a perfect stride takes a tenth off, four a third


@pytest.mark.compiled
def test_covariance_survives_a_long_wild_run(rng):
    _, _, odometry = filters('vehicle')
    for k in range(4000):
        still = k % 1000 > 900
        rate = np.zeros(3) if still else 3.0 * rng.standard_normal(3)
        force = UP if still else UP + 20.0 * rng.standard_normal(3)
        odometry.push(Sample(0.01, rate, force, *DENSITIES, still, still and k % 1000 > 950))
    P = odometry.P
    assert_allclose(P, P.T, rtol=1e-12)
    scale = np.sqrt(np.diag(P))
    assert np.linalg.eigvalsh(P / np.outer(scale, scale)).min() > -1e-9


def test_gaps_and_rubbish_are_bridged_and_admitted():
    _, _, odometry = filters('hand')
    for _ in range(400):
        odometry.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, True, True))
    before = odometry.P[0, 0]
    odometry.push(Sample(0.5, np.full(3, np.nan), UP, *DENSITIES, False, False))
    odometry.push(Sample(0.5, np.zeros(3), UP, *DENSITIES, False, False))
    assert np.isfinite(odometry.P).all()
    assert np.abs(odometry.position_n).max() < 0.1
    assert np.sqrt(odometry.P[0, 0] - before) > 0.1  # 0.5 m/s^2 unseen for a second


def pose_of(position, R):
    """Return what ROS calls a pose: position and rotation about fixed axes."""
    return np.concatenate((position, Rotation.from_matrix(R).as_rotvec()))


def test_pose_and_twist_covariance_match_finite_differences(rng):
    root = 1e-3 * rng.standard_normal((15, 15))
    P, R = root @ root.T, Rotation.random(rng=rng).as_matrix()
    v, step = rng.standard_normal(3), 1e-6
    pose, twist = np.empty((6, 15)), np.empty((6, 15))
    for j, error in enumerate(step * np.eye(15)):
        turned = R @ exp_so3(error[6:9])
        pose[:, j] = pose_of(error[:3], turned @ R.T) / step
        body = turned.T @ (v + error[3:6]) - R.T @ v
        twist[:, j] = np.concatenate((body, -error[9:12])) / step
    # Forward differences: relative error of the order of the step.
    assert_allclose(pose_covariance(R, P), pose @ P @ pose.T, atol=1e-9)
    noise = np.array([1e-6, 2e-6, 3e-6])
    expected = twist @ P @ twist.T + np.diag([0, 0, 0, *noise])
    assert_allclose(twist_covariance(R, v, P, noise), expected, atol=1e-9)


def test_biases_are_restored_and_survive_a_reset():
    _, _, odometry = filters('hand')
    odometry.restore_biases(np.full(3, 0.01), np.full(3, 1e-4), np.full(3, 0.1), np.full(3, 0.01))
    odometry.align(UP + 0.1, 0.01, 0.0)
    odometry.push(Sample(0.01, np.full(3, 0.01), UP + 0.1, *DENSITIES, False, False))
    odometry.push(Sample(0.01, np.full(3, 0.01), UP + 0.1, *DENSITIES, False, False))
    R = odometry.R_nb
    odometry.reset_motion()
    assert_allclose(odometry.state[:9], 0.0)
    assert_allclose(odometry.gyro_bias, 0.01, atol=1e-6)
    assert_allclose(odometry.accel_bias, 0.1, atol=1e-3)
    assert_allclose(odometry.R_nb, R)
    assert odometry.P[3, 3] == 0.5**2  # a hand's velocity
    odometry.push(Sample(0.01, np.full(3, 0.01), UP + 0.1, *DENSITIES, False, False))
    assert np.isfinite(odometry.P).all()


PLAIN = """
from odometry_runs import run
ran = run('hand', 'hand', 6.0, 100, 5)
p, v, R, bg, ba, P = ran.odometry[-1]
R_nb, bias, Q = ran.attitude[-1]
for array in (p, v, R, bg, ba, P, R_nb, bias, Q):
    print(*(float(x).hex() for x in array.ravel()))
"""


def test_plain_python_gives_the_same_answer_to_1e_12():
    printed = []
    for compiled in '01':
        there = str(Path(__file__).parents[1])
        environment = os.environ | {'MULTIIMU_COMPILED': compiled, 'PYTHONPATH': there}
        command = [sys.executable, '-c', PLAIN]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        printed.append([float.fromhex(word) for word in done.stdout.split()])
    assert_allclose(printed[0], printed[1], rtol=1e-9, atol=1e-12)


def test_bad_settings_are_named():
    config = ErrorStateConfig(
        rate_bias_sigma=np.ones(3),
        force_bias_sigma=np.ones(3),
        rate_bias_walk=np.ones(3),
        force_bias_walk=np.ones(3),
        zero_velocity_sigma=0.01,
        zero_velocity_time=0.1,
        motion_sigma=1.0,
        motion_velocity_sigma=1.0,
    )
    assert ErrorStateFilter(config).P.shape == (15, 15)
    with pytest.raises(ValueError, match='`rolling_arm` must not be negative, got -1'):
        replace(config, rolling_arm=-1.0)
