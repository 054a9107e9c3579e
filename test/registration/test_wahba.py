"""Wahba's problem: against the published cost, its own covariance, and what it must refuse."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from multiimu_ros.errors import CalibrationError
from multiimu_ros.registration.wahba import fit_rotation

TURN = Rotation.from_rotvec([0.7, -1.9, 0.4])


def test_a_known_turn_is_found_to_rounding(rng):
    b = rng.standard_normal((5, 3))
    fit = fit_rotation(TURN.apply(b), b)
    # Closed form: only rounding remains.
    assert (fit.rotation * TURN.inv()).magnitude() < 1e-14
    assert fit.residual_rms < 1e-14


def test_two_gravity_vectors_suffice():
    b = np.array([[0.0, 0.0, 9.81], [9.81, 0.0, 0.0]])
    assert (fit_rotation(TURN.apply(b), b).rotation * TURN.inv()).magnitude() < 1e-14


def test_the_fit_minimises_the_published_weighted_cost(rng):
    b, noise = rng.standard_normal((2, 8, 3))
    a, weights = TURN.apply(b) + 0.1 * noise, rng.uniform(0.5, 3.0, 8)

    def cost(rotvec):  # thesis (6.2), with weights
        return np.sum(weights * np.sum((a - Rotation.from_rotvec(rotvec).apply(b)) ** 2, axis=1))

    fit = fit_rotation(a, b, weights)
    best = minimize(cost, TURN.as_rotvec(), options={'gtol': 1e-9})
    # The solver's gradient comes from differences, good to sqrt(epsilon) of the step.
    assert_allclose(fit.rotation.as_rotvec(), best.x, atol=1e-6)
    assert_allclose(fit.residual_rms, np.sqrt(best.fun / weights.sum()), rtol=1e-9)


@given(st.integers(0, 2**32 - 1))
def test_turning_both_sets_turns_the_answer(seed):
    rng = np.random.default_rng(seed)
    b, noise = rng.standard_normal((2, 6, 3))
    a = TURN.apply(b) + 1e-2 * noise
    left, right = Rotation.random(2, random_state=rng)
    fit, turned = fit_rotation(a, b), fit_rotation(left.apply(a), right.apply(b))
    # R' = L R X', and theta' = X theta; six random vectors may be ill spread, so 1e-9.
    assert (left * fit.rotation * right.inv() * turned.rotation.inv()).magnitude() < 1e-9
    X = right.as_matrix()
    assert_allclose(turned.covariance, X @ fit.covariance @ X.T, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(('sigma_a', 'sigma_b'), [(0.05, 0.0), (0.0, 0.05), (0.2, 0.3)])
def test_the_covariance_is_honest_with_noise_in_either_set(rng, sigma_a, sigma_b):
    shape = [2.0, 1.0, 0.5]  # unequal spread, so that the three axes are known unequally well
    distances = []
    for _ in range(400):
        b = shape * rng.standard_normal((100, 3))
        noise = rng.standard_normal((2, 100, 3))
        fit = fit_rotation(TURN.apply(b) + sigma_a * noise[0], b + sigma_b * noise[1])
        theta = (fit.rotation.inv() * TURN).as_rotvec()
        distances.append(theta @ np.linalg.solve(fit.covariance, theta))
    # Three degrees of freedom; 400 draws would show covariances that are 15 % off.
    assert kstest(distances, chi2(3).cdf).pvalue > 1e-3
    # The mean of 400 is 3 +- sqrt(6/400) = 0.12; s^2 from 297 residuals adds 0.6 %.
    assert abs(np.mean(distances) - 3.0) < 4 * 0.12


def test_weights_that_are_inverse_variances_give_an_honest_covariance(rng):
    distances = []
    for _ in range(400):
        b = rng.standard_normal((60, 3))
        sigma = rng.uniform(0.01, 0.1, 60)
        a = TURN.apply(b) + sigma[:, np.newaxis] * rng.standard_normal((60, 3))
        fit = fit_rotation(a, b, 1 / sigma**2)
        theta = (fit.rotation.inv() * TURN).as_rotvec()
        distances.append(theta @ np.linalg.solve(fit.covariance, theta))
    assert abs(np.mean(distances) - 3.0) < 4 * 0.12


def test_the_sigma_is_about_the_axes_of_b(rng):
    b = [0.3, 0.3, 3.0] * rng.standard_normal((50, 3))  # mostly along z: the turn about z is worst
    fit = fit_rotation(TURN.apply(b) + 0.01 * rng.standard_normal((50, 3)), b)
    assert fit.sigma[2] > 5 * max(fit.sigma[:2])  # sqrt((9 + .09) / .18) = 7


@pytest.mark.parametrize('noise', [0.0, 0.01])
@pytest.mark.parametrize(('axis', 'name'), [(0, 'x'), (1, 'y'), (2, 'z')])
@pytest.mark.parametrize('count', [2, 20, 2000])
def test_parallel_vectors_are_refused_and_the_axis_is_named(rng, noise, axis, name, count):
    b = np.zeros((count, 3))
    b[:, axis] = rng.standard_normal(count)  # both senses: still one line
    noises = noise * rng.standard_normal((2, count, 3))
    with pytest.raises(CalibrationError, match=rf'nearest axis {name}\), so the rotation about'):
        fit_rotation(TURN.apply(b) + noises[0], b + noises[1])


def test_a_spread_that_is_no_larger_than_the_noise_is_refused(rng):
    b = rng.standard_normal((2000, 3)) * [0.3, 0.3, 3.0]
    noises = 2.0 * rng.standard_normal((2, 2000, 3))
    # x and y hold 0.09 of signal in 4 of noise; 2000 samples would call that known to 0.2 rad.
    with pytest.raises(CalibrationError, match='nearest axis z'):
        fit_rotation(TURN.apply(b) + noises[0], b + noises[1])


def test_vectors_in_a_narrow_cone_are_refused_even_without_noise(rng):
    b = np.array([0.0, 0.0, 9.81]) + 9.81 * 0.03 * rng.standard_normal((20, 3)) * [1, 1, 0]
    b[:, :2] *= 0.5  # 0.015 rad per axis, 1.2 deg in all: a scale error of 1 % would be a turn
    with pytest.raises(CalibrationError, match='nearest axis z'):
        fit_rotation(TURN.apply(b), b)


@pytest.mark.parametrize('noise', [0.0, 0.1])
def test_an_axis_with_the_wrong_sign_is_called_a_mirror(rng, noise):
    b = [1.0, 2.0, 3.0] * rng.standard_normal((30, 3))
    a = TURN.apply(b * [1, -1, 1]) + noise * rng.standard_normal((30, 3))
    with pytest.raises(CalibrationError, match='mirror images'):
        fit_rotation(a, b)


def test_noise_on_vectors_in_a_plane_is_not_called_a_mirror(rng):
    b = [3.0, 3.0, 0.0] * rng.standard_normal((200, 50, 3))
    noise = 0.7 * rng.standard_normal((2, 200, 50, 3))
    for k in range(200):  # the third singular value is noise, negative in every other draw
        fit = fit_rotation(TURN.apply(b[k]) + noise[0, k], b[k] + noise[1, k])
        # Six sigmas of the worst axis: sqrt(2) 0.7 / (3 sqrt(50)) = 47 mrad.
        assert (fit.rotation * TURN.inv()).magnitude() < 0.28


def test_the_covariance_is_the_inverse_curvature_of_the_cost(rng):
    b = [3.0, 3.0, 0.0] * rng.standard_normal((6, 3))
    out_of_plane = rng.uniform(-0.8, 0.8, 6)
    a = TURN.apply(b + np.outer(out_of_plane, [0, 0, 1]))
    a += 0.3 * rng.standard_normal((6, 3))
    b[:, 2] = -out_of_plane
    assert np.linalg.det(a.T @ b) < 0  # the third singular value counts as negative
    fit = fit_rotation(a, b)

    def cost(theta):
        turned = (fit.rotation * Rotation.from_rotvec(theta)).apply(b)
        return 0.5 * np.sum((a - turned) ** 2)

    def mixed(p, q):
        h = 1e-4
        signed = [s * t * cost(h * (s * p + t * q)) for s in (1, -1) for t in (1, -1)]
        return sum(signed) / (4 * h * h)

    curvature = [[mixed(p, q) for p in np.eye(3)] for q in np.eye(3)]
    variance = 2 * cost(np.zeros(3)) / 15  # 18 residuals, 3 parameters
    # Central differences err by h^2 and by epsilon / h^2.
    assert_allclose(fit.covariance, variance * np.linalg.inv(curvature), rtol=1e-5, atol=1e-9)


def test_three_vectors_give_as_much_variance_as_there_is(rng):
    noise = 0.01 * rng.standard_normal((400, 3, 3))
    sigmas = [fit_rotation(TURN.apply(np.eye(3)) + n, np.eye(3)).covariance for n in noise]
    # H = 2 I for three unit vectors; s^2 has 6 degrees of freedom: sqrt(2 / 6 / 400) = 2.9 %.
    assert_allclose(np.mean([np.trace(c) for c in sigmas]), 3 * 1e-4 / 2, rtol=4 * 0.029)


def test_one_vector_or_none_that_turns_is_refused():
    with pytest.raises(CalibrationError, match='nearest axis z'):
        fit_rotation(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, 1.0]]))
    with pytest.raises(CalibrationError, match='nearly parallel'):
        fit_rotation(np.zeros((5, 3)), np.zeros((5, 3)))


def test_bad_input_is_named_in_the_message():
    with pytest.raises(ValueError, match='got 3, 2 and'):
        fit_rotation(np.eye(3), np.eye(3)[:2])
    with pytest.raises(ValueError, match=r'`vectors_b` must have shape \(N, 3\)'):
        fit_rotation(np.eye(3), np.eye(2))
    with pytest.raises(ValueError, match='must be finite'):
        fit_rotation(np.eye(3), np.full((3, 3), np.nan))
    with pytest.raises(ValueError, match=r'`weights` must be positive, got 0\.0'):
        fit_rotation(np.eye(3), np.eye(3), np.array([1.0, 0.0, 1.0]))
