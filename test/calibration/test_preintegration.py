"""Turns are integrated to fourth order, and their derivatives are those of the turns."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.poses import Transition
from multiimu_ros.calibration.preintegration import integrate_turn, preintegrate
from multiimu_ros.compiled import COMPILED
from multiimu_ros.rotations import exp_so3, log_so3
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.trajectories import calibration_path, trajectory

PARAMETERS = 21
seeds = st.integers(0, 2**32 - 1)


def gyroscope(rng):
    """Return E, b and G of a bad one."""
    E = np.eye(3) + 0.02 * rng.standard_normal((3, 3))
    return E, 0.02 * rng.standard_normal(3), 1e-3 * rng.standard_normal((3, 3))


def motion(name, rate_hz):
    """Return what was true in 2 s of waving, or in a move of 3 s that turns by more than 2 rad."""
    if name == 'move':
        path = calibration_path(3, np.random.default_rng(1), rest=1.0, waving=0.0)
        return Trajectory(path, 5.0).at(np.arange(1.0, 4.0 + 0.5 / rate_hz, 1 / rate_hz))
    return trajectory('hand', 12.0).at(np.arange(5.0, 7.0 + 0.5 / rate_hz, 1 / rate_hz))


def turned(motion, parameters):
    """Return the turn (3, 3) of a gyroscope with these parameters along a motion, and J."""
    E, b, G = parameters
    felt = motion.angular_rate_b + motion.specific_force_b @ G.T
    raw = np.linalg.solve(E, felt.T).T + b
    whole = [Transition(0, 1, 0, len(motion.time))]
    R, J = preintegrate(motion.time, raw, motion.specific_force_b, whole, parameters)
    return R[0], J[0], raw


def wavy(rng, n=9):
    """Return uneven instants (n,), and rates and forces (n, 3) with no regularity at all."""
    return np.cumsum(rng.uniform(0.01, 0.03, n)), *rng.standard_normal((2, n, 3))


def turn_of(time, rate):
    return integrate_turn(time, rate, np.zeros_like(rate), np.zeros_like(rate))[0]


@pytest.mark.parametrize(('name', 'rate_hz'), [('move', 25.0), ('hand', 50.0)])
def test_halving_the_step_leaves_a_sixteenth_of_the_error(name, rate_hz, rng):
    errors = []
    for factor in (1, 2):
        truth = motion(name, factor * rate_hz)
        R, _, _ = turned(truth, gyroscope(rng))
        errors.append(np.linalg.norm(log_so3(R.T @ truth.R_nb[0].T @ truth.R_nb[-1])))
    assert errors[0] < 1e-4
    assert 11 < errors[0] / errors[1] < 23  # 2^4, up to the next order


def test_the_derivatives_are_those_of_the_turn(rng):
    truth, parameters = motion('hand', 50.0), gyroscope(rng)
    R, J, raw = turned(truth, parameters)
    whole = [Transition(0, 1, 0, len(truth.time))]
    flat = np.concatenate([part.ravel() for part in parameters])
    numeric = np.empty((3, PARAMETERS))
    for i in range(PARAMETERS):
        step = 1e-6 * np.eye(PARAMETERS)[i]
        ends = []
        for x in (flat - step, flat + step):
            split = x[:9].reshape(3, 3), x[9:12], x[12:].reshape(3, 3)
            ends.append(preintegrate(truth.time, raw, truth.specific_force_b, whole, split)[0][0])
        numeric[:, i] = log_so3(R.T @ ends[1]) / 2e-6 - log_so3(R.T @ ends[0]) / 2e-6
    for part in (slice(0, 9), slice(9, 12), slice(12, 21)):
        # A trapezium of second order stands for the integrals: some thousandths at 50 Hz.
        size = np.abs(numeric[:, part]).max()
        assert_allclose(J[:, part], numeric[:, part], atol=5e-3 * size)


@given(st.tuples(*[st.floats(-3, 3)] * 3), st.integers(2, 12))
def test_a_constant_rate_turns_by_its_product_with_time(rate, n):
    time = np.cumsum(np.random.default_rng(n).uniform(0.01, 0.1, n))
    R = turn_of(time, np.tile(rate, (n, 1)))
    assert_allclose(R, exp_so3((time[-1] - time[0]) * np.array(rate)), atol=1e-13)


@given(seeds)
def test_about_a_fixed_axis_a_rate_that_is_a_parabola_is_integrated_exactly(seed):
    rng = np.random.default_rng(seed)
    time, (a, b, c) = np.cumsum(rng.uniform(0.01, 0.1, 8)), rng.uniform(-5, 5, 3)
    axis = Rotation.random(random_state=rng).as_matrix()[0]
    angle = np.polyval(np.polyint([a, b, c]), time[[0, -1]])
    R = turn_of(time, np.outer(np.polyval([a, b, c], time), axis))
    assert_allclose(R, exp_so3(np.diff(angle)[0] * axis), atol=1e-13)


@given(seeds)
def test_a_move_backwards_in_time_undoes_it(seed):
    time, rate, _ = wavy(np.random.default_rng(seed))
    back = turn_of(-time[::-1].copy(), -rate[::-1].copy())
    assert_allclose(turn_of(time, rate) @ back, np.eye(3), atol=1e-13)


@given(seeds)
def test_in_turned_axes_the_turn_is_the_same_turn(seed):
    rng = np.random.default_rng(seed)
    time, rate, _ = wavy(rng)
    R_ab = Rotation.random(random_state=rng).as_matrix()
    assert_allclose(turn_of(time, rate @ R_ab), R_ab.T @ turn_of(time, rate) @ R_ab, atol=1e-13)


@given(seeds)
def test_only_differences_of_time_matter_and_the_result_is_a_rotation(seed):
    time, rate, _ = wavy(np.random.default_rng(seed))
    R = turn_of(time, rate)
    assert_allclose(R @ R.T, np.eye(3), atol=1e-13)
    assert_allclose(turn_of(time + 100.0, rate), R, atol=1e-10)  # 100 s cost two digits


def test_two_moves_are_integrated_as_each_alone(rng):
    time, raw, force = wavy(rng, 20)
    parameters = gyroscope(rng)
    pair = [Transition(0, 1, 2, 9), Transition(1, 2, 8, 20)]
    R, J = preintegrate(time, raw, force, pair, parameters)
    for k, one in enumerate(pair):
        R_one, J_one = preintegrate(time, raw, force, [one], parameters)
        assert np.array_equal(R[k], R_one[0])
        assert np.array_equal(J[k], J_one[0])


def test_no_moves_have_no_turns(rng):
    R, J = preintegrate(*wavy(rng), [], gyroscope(rng))
    assert R.shape == (0, 3, 3)
    assert J.shape == (0, 3, PARAMETERS)


def test_two_samples_are_enough():
    assert_allclose(
        turn_of(np.array([0.0, 0.1]), np.array([[1.0, 0, 0], [2.0, 0, 0]])),
        exp_so3(np.array([0.15, 0.0, 0.0])),
        atol=1e-15,
    )


@pytest.mark.skipif(not COMPILED, reason='the switch is off in this run')
def test_compiled_and_plain_agree(rng):
    time, rate, force = wavy(rng)
    plain = integrate_turn.py_func(time, rate, rate, force)
    assert_allclose(integrate_turn(time, rate, rate, force), plain, rtol=1e-12, atol=1e-15)
