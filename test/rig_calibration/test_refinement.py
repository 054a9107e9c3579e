"""The joint fit finds the truth, says how well, and is never worse than the fits it refines."""

from dataclasses import replace

from calibration_runs import exact_board, GRAVITY, parameters
from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig_calibration import refinement
from multiimu_ros.rig_calibration.imu_state import ROTATION, UNKNOWNS, Weights
from multiimu_ros.rig_calibration.refinement import first_attitudes, refine

NOTHING = Weights((0.0, 0.0), (0.0, 0.0))
BMI160 = (1.2e-4, 1.8e-3)  # [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)]
seeds = st.integers(0, 2**32 - 1)


def refined(board, rng, imus=None, *, off=1e-3, weights=NOTHING):
    """Refine IMUs of a board, all unknowns starting `off` the truth."""
    chosen = range(len(board.views)) if imus is None else imus
    states = []
    for k in chosen:
        step = off * rng.standard_normal(UNKNOWNS)
        states.append(board.states[k].moved(step))
    states[0] = replace(states[0], R=np.eye(3))  # its rotation into itself is no unknown
    views = [board.views[k] for k in chosen]
    tilt = Rotation.from_rotvec(off * rng.standard_normal((len(board.R_k), 3))).as_matrix()
    return refine(views, states, [weights] * len(views), board.R_k @ tilt, GRAVITY)


def error(fit, board, imu):
    return parameters(fit.states[imu]) - parameters(board.states[imu])


def sigma(fit, imu):
    return np.sqrt(np.diag(fit.covariance_of(imu)))[:30]


def turn_error(fit, board):
    """Return the rotation vector (3,) by which the second IMU is off."""
    return Rotation.from_matrix(board.states[1].R.T @ fit.states[1].R).as_rotvec()


@pytest.mark.parametrize('imus', [1, 2])
def test_without_noise_the_fit_ends_at_the_truth(imus, rng):
    board = exact_board(rng, imus=imus)
    fit = refined(board, rng, off=5e-3)
    for imu in range(imus):
        assert np.abs(error(fit, board, imu) / sigma(fit, imu)).max() < 0.01  # the fit stops
        assert_allclose(parameters(fit.states[imu]), parameters(board.states[imu]), atol=1e-7)
    if imus == 2:
        assert_allclose(turn_error(fit, board), 0.0, atol=1e-8)
    assert fit.chi_square < 1e-4  # of the sigma of a reading that is said to be 1e-6


def test_with_noise_chi_square_is_1_and_errors_are_as_large_as_the_fit_says():
    chi, z = [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        board = exact_board(rng, samples=15, density=BMI160)
        fit = refined(board, rng)
        chi.append(fit.chi_square)
        own = error(fit, board, 0)
        z.append(own @ np.linalg.solve(fit.covariance_of(0)[:30, :30], own) / 30)
    # 123 residuals for 30 + 41 unknowns: 52 degrees of freedom, 12 seeds, 0.057; three of it.
    # A trapezium of 15 takes 3.5 % off the variance of a turn; the excess of turns adds as much.
    assert np.mean(chi) == pytest.approx(1.0, abs=0.19)
    assert np.mean(z) == pytest.approx(1.0, abs=0.3)  # 3 sqrt(2 / 30 / 12), and the same


def test_the_yaw_that_nothing_determines_changes_nothing(rng, monkeypatch):
    board = exact_board(rng, samples=7, density=BMI160)
    one = refined(board, np.random.default_rng(1))
    turn = Rotation.from_rotvec([0.0, 0.0, 1.2]).as_matrix()
    other = refined(replace(board, R_k=turn @ board.R_k), np.random.default_rng(1))
    assert np.abs(parameters(one.states[0]) - parameters(other.states[0])).max() < 1e-9
    assert_allclose(other.R_k[:, 2], one.R_k[:, 2], atol=1e-9)  # the vertical in each pose
    monkeypatch.setattr(refinement, 'HELD', 1e2)
    held = refined(board, np.random.default_rng(1))
    shift = parameters(held.states[0]) - parameters(one.states[0])
    assert np.abs(shift / sigma(one, 0)).max() < 1e-2  # the tolerance of the fit, DONE, tenfold
    assert_allclose(sigma(held, 0), sigma(one, 0), rtol=1e-2)
    assert one.chi_square == pytest.approx(held.chi_square, rel=1e-3)


@pytest.mark.long
def test_two_imus_together_are_at_least_as_good_as_each_alone():
    together, alone = [], []
    for seed in range(6):
        board = exact_board(np.random.default_rng(seed), imus=2, density=BMI160)
        joint = refined(board, np.random.default_rng(9))
        for imu in range(2):
            view = replace(board, R_k=board.R_k @ board.states[imu].R)  # attitudes of that IMU
            single = refined(view, np.random.default_rng(9), [imu])
            same = joint.weights[imu].turn <= single.weights[0].turn
            # More is known, if the weights are alike; rounding of inverses.
            assert not same or (sigma(joint, imu) <= sigma(single, 0) * (1 + 1e-4)).all()
            together.append(error(joint, board, imu) / sigma(single, 0))
            alone.append((parameters(single.states[0]) - parameters(board.states[imu]))
                         / sigma(single, 0))  # fmt: skip
    assert np.mean(np.square(together)) < np.mean(np.square(alone))


@pytest.mark.long
def test_the_rotation_between_two_imus_is_as_good_as_it_says():
    z = []
    for seed in range(12):
        board = exact_board(np.random.default_rng(seed), imus=2, density=BMI160)
        fit = refined(board, np.random.default_rng(9))
        spread = fit.covariance_of(1)[ROTATION, ROTATION]
        off = turn_error(fit, board)
        assert np.abs(off).max() < 1e-3  # 0.2 mrad of a pose's mean, and 14 poses
        z.append(off @ np.linalg.solve(spread, off) / 3)
    assert np.mean(z) == pytest.approx(1.0, abs=3 * np.sqrt(2 / 3 / 12))


def test_the_first_rotation_is_no_unknown(rng):
    fit = refined(exact_board(rng, imus=2), rng)
    assert not fit.covariance[ROTATION].any()
    assert not fit.covariance[:, ROTATION].any()
    assert np.array_equal(fit.states[0].R, np.eye(3))
    assert (np.diag(fit.covariance_of(1)) > 0).all()
    assert_allclose(fit.covariance, fit.covariance.T, atol=1e-12)


def test_turns_that_err_more_than_white_noise_are_believed_less():
    extra, found = 1e-3, []  # [rad per rad]
    for seed in range(6):
        rng = np.random.default_rng(seed)
        board = exact_board(rng, samples=31, density=BMI160)
        view = board.views[0]
        raw = view.raw_rate.copy()
        for move in view.transitions:
            span = slice(move.begin, move.end)
            rate = np.linalg.norm((raw[span] - board.states[0].rate_bias), axis=1)
            angle = np.trapezoid(rate, view.time[span])
            # A jerk of 2 steps of 1/15 s in the middle, about a random axis.
            jerk = extra * angle * rng.standard_normal(3) / (2 / 15)
            raw[move.begin + 14 : move.begin + 17] += np.outer([0.5, 1.0, 0.5], jerk)
        found.append(refined(replace(board, views=(replace(view, raw_rate=raw),)), rng))
    components = [fit.weights[0].turn for fit in found]
    # 39 rows, of which a third is spent: 28 % each, and 12 % of six; three of it.
    assert np.mean(components) == pytest.approx(extra**2, rel=0.4)
    assert np.mean([fit.chi_square for fit in found]) == pytest.approx(1.0, abs=0.25)


def test_turns_without_an_error_of_their_own_get_none(rng):
    assert refined(exact_board(rng), rng).weights[0].turn == 0.0


@given(seeds)
def test_first_attitudes_are_the_true_ones_but_for_the_yaw(seed):
    rng = np.random.default_rng(seed)
    R_k = Rotation.random(6, random_state=rng).as_matrix()
    turns = [(k, k + 1, R_k[k].T @ R_k[k + 1]) for k in range(5)]
    found = first_attitudes(R_k[:, 2], turns)
    common = found @ R_k.transpose(0, 2, 1)
    assert_allclose(common, np.tile(common[0], (6, 1, 1)), atol=1e-7)
    assert_allclose(common[0, 2], [0, 0, 1], atol=1e-7)
    # Level is exact, but within 1e-12 of upright.
    assert_allclose(np.einsum('kij,kj->ki', found, R_k[:, 2]), [[0, 0, 1]] * 6, atol=1e-7)


@pytest.mark.parametrize('up', [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]])
def test_a_face_that_points_up_is_on_top(up):
    R = first_attitudes(np.array([up]), [])[0]
    assert_allclose(R @ up, [0.0, 0.0, 1.0], atol=1e-15)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_a_pose_that_was_not_heard_starts_level():
    unheard = np.full((1, 3), np.nan)
    assert np.array_equal(first_attitudes(unheard, [])[0], np.eye(3))


def test_a_start_from_which_nothing_settles_is_refused(rng):
    board = exact_board(rng, poses=5)
    lost = board.states[0].moved(np.r_[np.full(3, -0.99), np.zeros(30)])
    with pytest.raises(CalibrationError, match=r'does not settle; record more poses'):
        refine(board.views, [lost], [NOTHING], board.R_k[::-1], GRAVITY)


@pytest.mark.parametrize('seed', range(12))
def test_a_wild_start_ends_at_the_truth_or_in_a_refusal(seed):
    rng = np.random.default_rng(seed)
    board = exact_board(rng, imus=2, poses=9)
    try:
        fit = refined(board, rng, off=10 ** rng.uniform(-3.5, 1.5))
    except CalibrationError:  # one sentence, and no warning of an overflow before
        return
    for imu in range(2):
        assert np.abs(error(fit, board, imu)).max() < 1e-6
