"""The linearised measurements of the joint fit: zero at the truth, and with the right slopes."""

from dataclasses import replace

from calibration_runs import exact_board, GRAVITY, parameters, unit
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.rig_calibration.imu_state import ImuState, UNKNOWNS, Weights
from multiimu_ros.rig_calibration.measurements import (
    _force_rows,
    _rate_rows,
    _turn_rows,
    measure,
    NO_SLIPS,
    Slips,
)

NOTHING = Weights((0.0, 0.0), (0.0, 0.0))
STEP = 1e-5  # central differences lose its square, and 1e-16 over it


@pytest.fixture(scope='module')
def board():
    """Return two IMUs, turned against each other, in 4 poses with fine moves between."""
    return exact_board(np.random.default_rng(3), imus=2, poses=4, samples=25)


def blocks(view, state, R_k, slips=NO_SLIPS):
    """Return force, rate and turn rows: (residual, own, attitudes) each."""
    known = np.flatnonzero(view.poses.known)
    up = GRAVITY * R_k[known, 2]
    s = up @ state.R
    return [
        _force_rows(view, state, known, up, s),
        _rate_rows(view, state, known, up, s),
        _turn_rows(view, state, R_k, slips)[0],
    ]


def moved(state, R_k, column, step):
    """Return state and attitudes after a step in one of the unknowns."""
    full = np.zeros(UNKNOWNS + 3 * len(R_k))
    full[column] = step
    turn = Rotation.from_rotvec(full[UNKNOWNS:].reshape(-1, 3)).as_matrix()
    return state.moved(full[:UNKNOWNS]), R_k @ turn


def numeric(view, state, R_k, block):
    """Return the central differences (M, 33 + 3 P) of one block of residuals."""
    columns = []
    for column in range(UNKNOWNS + 3 * len(R_k)):
        low, high = (
            blocks(view, *moved(state, R_k, column, sign * STEP))[block][0] for sign in (-1, 1)
        )
        columns.append((high - low) / (2 * STEP))
    return np.transpose(columns)


@pytest.mark.parametrize('imu', [0, 1])
def test_at_the_truth_all_residuals_are_zero(board, imu):
    for residual, _, _ in blocks(board.views[imu], board.states[imu], board.R_k):
        assert_allclose(residual, 0.0, atol=1e-12)  # rounding of 10 m/s^2 and of products


@pytest.mark.parametrize('imu', [0, 1])
@pytest.mark.parametrize('block', [0, 1])
def test_the_slopes_of_the_poses_are_those_of_finite_differences(board, imu, block, rng):
    # Anywhere, not only at the truth.
    state = board.states[imu].moved(0.01 * rng.standard_normal(UNKNOWNS))
    R_k = board.R_k @ Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    _, own, attitudes = blocks(board.views[imu], state, R_k)[block]
    expected = numeric(board.views[imu], state, R_k, block)
    assert_allclose(np.hstack([own, attitudes]), expected, atol=1e-8)


@pytest.mark.parametrize('imu', [0, 1])
def test_the_slopes_of_the_turns_are_those_of_finite_differences(board, imu):
    """Taken at the truth; away from it the logarithm has a Jacobian of its own, left out."""
    view, state = board.views[imu], board.states[imu]
    _, own, attitudes = blocks(view, state, board.R_k)[2]
    expected = numeric(view, state, board.R_k, 2)
    assert_allclose(attitudes, expected[:, UNKNOWNS:], atol=1e-8)
    assert_allclose(own[:, 30:], expected[:, 30:UNKNOWNS], atol=1e-8)
    for part in (slice(9, 18), slice(18, 21), slice(21, 30)):
        # The trapezium of `preintegration`, at 80 ms: a few hundredths at most.
        size = np.abs(expected[:, part]).max()
        assert_allclose(own[:, part], expected[:, part], atol=0.03 * size)
    # The accelerometer turns nothing but through the g-sensitivity of 1e-4, in 2 s: left out.
    assert np.abs(expected[:, :9]).max() < 5e-4 * GRAVITY
    assert not own[:, :9].any()


@pytest.mark.parametrize('imu', [0, 1])
def test_the_slopes_of_slips_are_those_of_finite_differences(board, imu):
    view, state = board.views[imu], board.states[imu]
    places = {(1, 2): 0, (2, 3): 1}  # the first move has none

    def turns(values):
        return blocks(view, state, board.R_k, Slips(places, values.reshape(2, 3)))[2]

    steps = STEP * np.eye(6)
    expected = np.transpose([(turns(h)[0] - turns(-h)[0]) / (2 * STEP) for h in steps])
    _, _, shared = turns(np.zeros(6))
    assert_allclose(shared[:, 12:], expected, atol=1e-8)
    assert_allclose(shared[:, :12], blocks(view, state, board.R_k)[2][2], atol=1e-15)


def test_whitened_rows_are_those_of_the_covariance(board):
    """With white noise alone every row is divided by its own sigma."""
    view, state = board.views[0], board.states[0].moved(np.full(UNKNOWNS, 1e-3))
    weights = Weights((4e-6, 0.0), (1e-8, 0.0))
    rows = measure(view, state, board.R_k, GRAVITY, weights)
    force, rate, _ = blocks(view, state, board.R_k)
    poses = view.poses
    sigma = [
        np.sqrt(poses.force_density**2 / 4.0 + 4e-6),  # 4 s in each pose
        np.sqrt(poses.rate_density**2 / 4.0 + 1e-8),
    ]
    expected = np.r_[force[0] / np.tile(sigma[0], 4), rate[0] / np.tile(sigma[1], 4)]
    assert_allclose(rows.residual[:24], expected, rtol=1e-10)
    assert_allclose(rows.own[:12], force[1] / np.tile(sigma[0], 4)[:, np.newaxis], rtol=1e-10)
    assert rows.moves == slice(24, 33)


def test_white_noise_is_whitened_to_sigma_1():
    squares = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        board = exact_board(rng, poses=8, samples=25, density=(1.2e-4, 1.8e-3))
        rows = measure(board.views[0], board.states[0], board.R_k, GRAVITY, NOTHING)
        squares.append([np.mean(rows.residual[:48] ** 2), np.mean(rows.residual[rows.moves] ** 2)])
    # 48 and 21 rows, 12 seeds: standard errors 0.06 and 0.09; a trapezium of 25 weighs the two
    # ends by half, which takes off 2 %.
    assert_allclose(np.mean(squares, axis=0), 1.0, atol=0.25)


def test_a_walking_bias_is_the_same_in_poses_and_moves():
    walk, squares = 1e-8, []  # [(rad/s)^2/s] 0.24 mrad/s from pose to pose; white are 0.02
    for seed in range(12):
        rng = np.random.default_rng(seed)
        board = exact_board(rng, poses=8, samples=25, density=(4e-5, 1e-5))
        view, state = board.views[0], board.states[0]
        time = view.poses.time
        steps = np.sqrt(walk * np.diff(time, prepend=time[0]))[:, np.newaxis]
        bias = np.cumsum(steps * rng.standard_normal((8, 3)), axis=0)
        bias -= bias.mean(axis=0)
        # In a move the bias is taken as the mean of both ends.
        during = np.repeat((bias[:-1] + bias[1:]) / 2, 25, axis=0)
        still = replace(view.poses, angular_rate=view.poses.angular_rate + bias)
        drifting = replace(view, poses=still, raw_rate=view.raw_rate + during)
        weights = Weights((0.0, 0.0), (0.0, walk))
        rows = measure(drifting, state, board.R_k, GRAVITY, weights)
        squares.append(np.mean(rows.residual[24:] ** 2))
        alone = measure(drifting, state, board.R_k, GRAVITY, NOTHING)
        assert np.mean(alone.residual[24:] ** 2) > 30
    # 24 + 21 rows, of which three sums are fixed by the mean.
    assert np.mean(squares) == pytest.approx(42 / 45, abs=0.25)


def test_a_pose_that_was_not_heard_has_no_rows(board):
    view = board.views[0]
    unheard = view.poses.specific_force.copy()
    unheard[2] = np.nan
    deaf = replace(
        view,
        poses=replace(view.poses, specific_force=unheard),
        transitions=(view.transitions[0],),
    )
    rows = measure(deaf, board.states[0], board.R_k, GRAVITY, NOTHING)
    assert len(rows.residual) == 6 * 3 + 3
    assert rows.moves == slice(18, 21)
    assert not rows.attitudes[:, 6:9].any()
    assert np.isfinite(rows.own).all()


def test_a_step_and_its_opposite_are_none(rng):
    state = unit(rng, Rotation.random(random_state=rng).as_matrix())
    step = 0.1 * rng.standard_normal(UNKNOWNS)
    back = state.moved(step).moved(-step)
    assert_allclose(parameters(back), parameters(state), atol=1e-15)
    assert_allclose(back.R, state.R, atol=1e-15)


def test_a_state_is_what_the_single_fits_found(rng):
    truth = unit(rng, np.eye(3))

    class Accelerometer:
        scale, shear, bias = truth.scale, truth.shear, truth.force_bias

    class Gyroscope:
        E, bias, G = truth.E, truth.rate_bias, truth.G

    state = ImuState.of(Accelerometer, Gyroscope, np.eye(3))
    assert np.array_equal(parameters(state), parameters(truth))
    upper = np.triu(np.ones((3, 3)), 1)
    assert np.array_equal(state.E_a, truth.M_a @ np.diag(truth.scale))
    assert np.array_equal(truth.M_a * upper != 0, upper != 0)
