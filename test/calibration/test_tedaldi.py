"""Tedaldi's two fits find what is true, from far off, or say what is missing."""

from dataclasses import replace

from calibration_runs import exact_board, GRAVITY, parameters, readings, unit
from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.coverage import CANDIDATES
from multiimu_ros.calibration.poses import PoseReadings
from multiimu_ros.calibration.tedaldi import (
    _slope_of_norm,
    fit_accelerometer,
    predicted_spread,
    UPPER,
)
from multiimu_ros.calibration.tedaldi_gyroscope import fit_gyroscope, fit_rest_rate
from multiimu_ros.errors import CalibrationError

seeds = st.integers(0, 2**32 - 1)
ANGLE = np.linspace(0.0, 2 * np.pi, 20, endpoint=False)


def poses_of(force, rate=None, densities=(1e-6, 1e-5)):
    """Return poses of 4 s, 7 s apart, with these mean readings (P, 3)."""
    P = len(force)
    said = [np.full(3, density) for density in densities]
    rates = np.zeros((P, 3)) if rate is None else rate
    return PoseReadings(7.0 * np.arange(P), np.full(P, 4.0), rates, force, *said)


def felt(up, E, bias):
    """Return what an accelerometer reads with `up` (P, 3) on top."""
    return GRAVITY * np.linalg.solve(E, up.T).T + bias


def sphere(rng, count=20):
    up = rng.standard_normal((count, 3))
    return up / np.linalg.norm(up, axis=1, keepdims=True)


def gyroscope_of(board, scale=1.0, unit_of_rate=1.0, moves=slice(None)):
    """Fit the first gyroscope, whose readings are first taken to another unit."""
    view, state = board.views[0], board.states[0]
    up = board.R_k[:, 2]
    raw = view.raw_rate / unit_of_rate
    force = (view.raw_force - state.force_bias) @ state.E_a.T
    still = replace(view.poses, angular_rate=view.poses.angular_rate / unit_of_rate)
    rest = fit_rest_rate(still, GRAVITY * up)
    return fit_gyroscope(view.time, raw, force, up, view.transitions[moves], rest, scale)


def test_an_accelerometer_is_recovered_exactly(rng):
    truth = unit(rng, np.eye(3))
    model = fit_accelerometer(poses_of(felt(sphere(rng), truth.E_a, truth.force_bias)), GRAVITY)
    # The differences of the Jacobian, 1e-8, limit how near to 0 the residuals come.
    assert_allclose(model.E, truth.E_a, atol=1e-8)
    assert_allclose(model.bias, truth.force_bias, atol=1e-7)
    assert_allclose(model.residual, 0.0, atol=1e-7)


@given(seeds)
def test_calibrated_poses_read_gravity_whatever_the_sensor(seed):
    rng = np.random.default_rng(seed)
    truth = unit(rng, np.eye(3), size=3.0)
    up = sphere(rng, 30)
    raw = felt(up, truth.E_a, truth.force_bias)
    model = fit_accelerometer(poses_of(raw), GRAVITY)
    assert_allclose(model.apply(raw), GRAVITY * up, atol=1e-6)


def test_counts_are_fitted_from_a_start_that_is_far_off(rng):
    E = np.array([[2.41e-3, -8e-6, -2e-5], [0.0, 2.43e-3, -5e-5], [0.0, 0.0, 2.40e-3]])
    bias = np.array([33124.0, 33275.0, 32364.0])
    model = fit_accelerometer(
        poses_of(felt(sphere(rng, 36), E, bias)), GRAVITY, (1.0, 32768.0)
    )  # 16 bits
    assert_allclose(model.E, E, atol=1e-10)  # 1e-7 of the scale
    assert_allclose(model.bias, bias, atol=1e-3)  # counts, of which 4000 are g


@given(seeds)
def test_only_the_upper_triangular_frame_is_fitted(seed):
    """Gravity's length says nothing of how the frame is turned: E and R E are the same."""
    rng = np.random.default_rng(seed)
    truth = unit(rng, np.eye(3))
    turned = Rotation.random(random_state=rng).as_matrix() @ truth.E_a
    model = fit_accelerometer(poses_of(felt(sphere(rng, 30), turned, truth.force_bias)), GRAVITY)
    assert_allclose(model.E, truth.E_a, atol=1e-7)  # 1e-8 of the differences, times a condition


@given(seeds, st.floats(1e-3, 1e4), st.permutations([0, 1, 2]))
def test_units_and_names_of_axes_change_nothing_else(seed, scale, order):
    rng = np.random.default_rng(seed)
    truth = unit(rng, np.eye(3))
    raw = felt(sphere(rng, 24), truth.E_a, truth.force_bias) + 1e-3 * rng.standard_normal((24, 3))
    one = fit_accelerometer(poses_of(raw, densities=(1e-6, 2e-3)), GRAVITY)
    said = 1e-6, 2e-3 * scale
    other = fit_accelerometer(
        poses_of(scale * raw[:, order], densities=said), GRAVITY, (1 / scale, 0.0)
    )
    # E' E, for the frame is another one; and 2e-3 of noise, weighed to the tolerance of L-BFGS.
    gram = (one.E.T @ one.E)[np.ix_(order, order)] / scale**2
    assert_allclose(other.E.T @ other.E, gram, rtol=1e-4, atol=1e-5 / scale**2)
    assert_allclose(other.bias, scale * one.bias[order], atol=1e-4 * scale)
    assert_allclose(np.abs(other.residual), np.abs(one.residual), atol=1e-4)


@given(seeds)
def test_the_order_of_the_poses_does_not_matter_where_no_bias_walks(seed):
    rng = np.random.default_rng(seed)
    truth = unit(rng, np.eye(3))
    raw = felt(sphere(rng), truth.E_a, truth.force_bias)
    one = fit_accelerometer(poses_of(raw), GRAVITY)
    other = fit_accelerometer(poses_of(raw[rng.permutation(20)]), GRAVITY)
    assert_allclose(other.E, one.E, atol=1e-8)
    assert_allclose(other.bias, one.bias, atol=1e-7)


def test_the_slope_of_the_norm_is_that_of_finite_differences(rng):
    truth = unit(rng, np.eye(3), size=5.0)
    theta, raw = np.r_[truth.scale, truth.shear, truth.force_bias], 10 * sphere(rng)

    def norms(x):
        M = np.eye(3)
        M[UPPER] = x[3:6]
        return np.linalg.norm((raw - x[6:]) @ (M @ np.diag(x[:3])).T, axis=1)

    steps = 1e-6 * np.eye(9)
    numeric = [(norms(theta + h) - norms(theta - h)) / 2e-6 for h in steps]
    # Central differences: 1e-15 of 10 over the step, 1e-8.
    assert_allclose(_slope_of_norm(theta, raw), np.transpose(numeric), atol=1e-7)


def test_errors_of_an_accelerometer_are_as_large_as_it_says():
    z = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        truth = unit(rng, np.eye(3))
        raw = felt(sphere(rng, 30), truth.E_a, truth.force_bias)
        noisy = raw + 1e-3 * rng.standard_normal(raw.shape)
        model = fit_accelerometer(poses_of(noisy, densities=(1e-6, 2e-3)), GRAVITY)
        error = np.r_[model.scale, model.shear, model.bias] - parameters(truth)[:9]
        z.append(error @ np.linalg.solve(model.covariance, error) / 9)
    # Chi-squared of 9 per fit: mean 1, with a standard error of sqrt(2 / 9 / 60); the components
    # are estimated too, which widens the law a little.
    assert np.mean(z) == pytest.approx(1.0, abs=0.2)


def test_drift_that_a_walking_bias_explains_is_told_from_the_rest():
    rng = np.random.default_rng(4)
    truth = unit(rng, np.eye(3))
    up = sphere(rng, 60)
    # 5 mm/s^2 over 7 minutes, ten times the noise of a mean.
    walked = 0.1 * np.cumsum(rng.standard_normal((60, 3)), axis=0)
    raw = felt(up, truth.E_a, truth.force_bias) + 0.05 * walked
    noisy = raw + 5e-4 * rng.standard_normal(raw.shape)
    model = fit_accelerometer(poses_of(noisy, densities=(1e-6, 1e-3)), GRAVITY)
    assert model.walk > 0
    left = model.residual - model.drift
    assert left.std() < 0.6 * model.residual.std()


def test_of_two_choices_of_poses_the_better_one_has_the_smaller_spread(rng):
    truth = unit(rng, np.eye(3))
    raw = felt(sphere(rng, 30), truth.E_a, truth.force_bias)
    quiet, loud = (raw + s * rng.standard_normal(raw.shape) for s in (1e-3, 1e-2))
    best = predicted_spread(quiet, GRAVITY)
    # Ten times the noise is log 10 more; the sample scatters by 1 / sqrt(2 21), twice.
    assert predicted_spread(loud, GRAVITY) == pytest.approx(best + np.log(10), abs=0.7)
    assert predicted_spread(quiet[:12], GRAVITY) > best
    assert predicted_spread(quiet[:9], GRAVITY) == np.inf


def test_too_few_poses_are_refused_with_what_is_missing():
    raw = GRAVITY * CANDIDATES[:8]  # the six faces, +y+z and +y-z
    with pytest.raises(CalibrationError, match='need at least 9 still poses, got 8') as told:
        fit_accelerometer(poses_of(raw), GRAVITY)
    named = str(told.value).partition('lying still with ')[2].rstrip('.').split(', ')
    assert len(named) == 6
    assert not {'+y+z up', '+y-z up', '+x up', '-z up'} & set(named)


def test_counts_that_are_too_few_name_the_same_poses():
    raw = 4000 * CANDIDATES[:8] + 32768
    with pytest.raises(CalibrationError) as counts:
        fit_accelerometer(poses_of(raw), GRAVITY, (GRAVITY / 4000, 32768.0))
    with pytest.raises(CalibrationError) as plain:
        fit_accelerometer(poses_of(GRAVITY * CANDIDATES[:8]), GRAVITY)
    assert str(counts.value) == str(plain.value)


@pytest.mark.parametrize('noise', [0.0, 1e-3, 1e-2])
@pytest.mark.parametrize('axis', [0, 1, 2])
def test_poses_on_one_circle_are_refused_and_name_the_poles(axis, noise, rng):
    up = np.insert(np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=1), axis, 0.0, axis=1)
    raw = GRAVITY * up + noise * rng.standard_normal(up.shape)
    with pytest.raises(CalibrationError, match='too much alike') as told:
        fit_accelerometer(poses_of(raw, densities=(1e-6, 2e-3)), GRAVITY)
    named = str(told.value).partition('lying still with ')[2].rstrip('.').split(', ')
    assert set(named[:2]) == {f'+{"xyz"[axis]} up', f'-{"xyz"[axis]} up'}
    assert all('xyz'[axis] in name for name in named)  # edges that leave the circle


@pytest.mark.parametrize('noise', [0.0, 1e-3])
def test_poses_within_30_degrees_are_refused(noise, rng):
    tilt = np.deg2rad(30) * np.sqrt(rng.uniform(0, 1, 20))
    turn = rng.uniform(0, 2 * np.pi, 20)
    up = np.stack([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1)
    raw = GRAVITY * up + noise * rng.standard_normal(up.shape)
    with pytest.raises(CalibrationError, match=r'too much alike .* with -z up'):
        fit_accelerometer(poses_of(raw, densities=(1e-6, 2e-3)), GRAVITY)


def test_faces_only_are_refused_and_edges_asked_for():
    raw = GRAVITY * np.repeat(CANDIDATES[:6], 3, axis=0)
    with pytest.raises(CalibrationError, match='too much alike') as told:
        fit_accelerometer(poses_of(raw), GRAVITY)
    named = str(told.value).partition('lying still with ')[2].rstrip('.').split(', ')
    assert all(len(name) == len('+x+y up') for name in named)


@pytest.mark.parametrize('with_g_sensitivity', [True, False])
def test_rest_tells_bias_and_g_sensitivity_exactly(with_g_sensitivity, rng):
    truth = unit(rng, np.eye(3))
    force = GRAVITY * sphere(rng)
    G = truth.G if with_g_sensitivity else np.zeros((3, 3))
    rate, _ = readings(replace(truth, G=G), np.zeros_like(force), force)
    bias, H, pose_variance, walk = fit_rest_rate(poses_of(force, rate), force, with_g_sensitivity)
    assert_allclose(bias, truth.rate_bias, atol=1e-12)  # linear: rounding
    assert_allclose(truth.E @ H, G, atol=1e-12)
    assert pose_variance == walk == 0.0


def test_g_sensitivity_that_is_left_out_is_seen_as_a_variance_of_the_poses(rng):
    truth = unit(rng, np.eye(3), size=3.0)
    force = GRAVITY * sphere(rng)
    rate, _ = readings(truth, np.zeros_like(force), force)
    still = poses_of(force, rate, densities=(1e-4, 1e-3))
    _, _, with_it, _ = fit_rest_rate(still, force)
    _, _, without, _ = fit_rest_rate(still, force, False)
    assert with_it == 0.0
    left = rate - rate.mean(axis=0)
    # Random poses scatter like an error of each; the walk takes at most a share of it.
    assert without > 0.3 * left.var(axis=0, ddof=1).mean()


def test_a_gyroscope_is_recovered_exactly(rng):
    board = exact_board(rng)
    model, truth = gyroscope_of(board), board.states[0]
    # Gauss-Newton with the derivatives of `preintegration` ends at its xtol of 1e-12.
    assert_allclose(model.E, truth.E, atol=1e-9)
    assert_allclose(model.bias, truth.rate_bias, atol=1e-12)
    assert_allclose(model.G, truth.G, atol=1e-12)
    assert_allclose(model.residual, 0.0, atol=1e-9)


@pytest.mark.parametrize('wrong', [0.76, 1.3])
def test_a_gyroscope_is_fitted_from_a_scale_that_is_far_off(wrong, rng):
    board = exact_board(rng)
    per_count = 1 / 4778  # the scale of an Xsens MTi; its reference program starts at 1 / 6258
    model = gyroscope_of(board, wrong * per_count, per_count)
    assert_allclose(model.E, board.states[0].E * per_count, atol=1e-9 * per_count)


@settings(max_examples=10)  # slow where nothing is compiled
@given(seeds)
def test_a_gyroscope_is_found_in_the_frame_of_the_accelerometer(seed):
    """Turned against the accelerometer, it has the E of the turn times its own."""
    rng = np.random.default_rng(seed)
    board = exact_board(rng, samples=5)
    R = Rotation.from_rotvec(0.1 * rng.standard_normal(3)).as_matrix()
    view = board.views[0]
    seen = replace(board, views=(replace(view, raw_rate=view.raw_rate @ R, poses=replace(
        view.poses, angular_rate=view.poses.angular_rate @ R)),))  # fmt: skip
    assert_allclose(gyroscope_of(seen).E, board.states[0].E @ R, atol=1e-8)


def test_too_few_moves_are_refused(rng):
    with pytest.raises(CalibrationError, match=r'need at least 5 unbroken moves .*, got 4'):
        gyroscope_of(exact_board(rng), moves=slice(4))


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_moves_that_never_turn_about_an_axis_are_refused_by_its_name(axis, rng):
    turned = np.ones(3)
    turned[axis] = 0.0
    name = 'xyz'[axis]
    with pytest.raises(CalibrationError, match=f'undetermined about {name}; .* its {name} axis'):
        gyroscope_of(exact_board(rng, axes=turned, density=(1e-4, 0.0)))


@pytest.mark.parametrize('axis', [0, 1, 2])
def test_moves_about_one_axis_are_refused_by_the_name_of_another(axis, rng):
    others = set('xyz') - {'xyz'[axis]}
    with pytest.raises(CalibrationError, match='undetermined about') as told:
        gyroscope_of(exact_board(rng, axes=np.eye(3)[axis], density=(1e-4, 0.0)))
    assert str(told.value).partition('undetermined about ')[2][0] in others
