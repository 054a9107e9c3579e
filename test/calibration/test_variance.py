"""Variance components are those that made the residuals, whatever the fit has spent."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.calibration.variance import (
    _restricted_likelihood,
    fit_components,
    walk_covariance,
)

TIME = np.r_[0.0, 20.0 + 7.0 * np.arange(15)]  # [s] a long rest, and a pose every 7 s
P, D = len(TIME), 4
KERNELS = [np.eye(P), walk_covariance(TIME)]


def design(rng):
    return np.hstack([np.ones((P, 1)), rng.standard_normal((P, D - 1))])


def residuals(rng, A, V, axes=3):
    """Return what a plain fit of A leaves of noise with covariance V (axes, P)."""
    noise = np.linalg.cholesky(V) @ rng.standard_normal((P, axes))
    return (noise - A @ np.linalg.lstsq(A, noise, rcond=None)[0]).T


def estimates(V, whites, kernels, count):
    rng = np.random.default_rng(5)
    found = []
    for _ in range(count):
        A = design(rng)
        found.append(fit_components(residuals(rng, A, V), A, np.tile(whites, (3, 1)), kernels))
    return np.array(found)


def naive(r, A, V):
    """Return -2 log of the restricted likelihood as textbooks have it."""
    W = np.linalg.inv(V)
    spent = A.T @ W @ A
    projector = W - W @ A @ np.linalg.inv(spent) @ A.T @ W
    return np.linalg.slogdet(V)[1] + np.linalg.slogdet(spent)[1] + r @ projector @ r


def test_the_restricted_likelihood_is_that_of_the_textbook(rng):
    for _ in range(10):
        A, r = design(rng), rng.standard_normal(P)
        root = rng.standard_normal((P, P))
        V = root @ root.T + np.eye(P)
        # Inverses of a condition number of some hundred.
        assert_allclose(_restricted_likelihood(r, A, V), naive(r, A, V), rtol=1e-10)


def test_no_other_components_are_likelier(rng):
    A, whites = design(rng), rng.uniform(0.5, 2.0, (3, P))
    r = residuals(rng, A, np.eye(P) * 4 + 0.1 * KERNELS[1])
    found = fit_components(r, A, whites, KERNELS)
    assert (found > 0).all()

    def cost(factors):
        K = factors[0] * KERNELS[0] + factors[1] * KERNELS[1]
        return sum(naive(one, A, np.diag(w) + K) for one, w in zip(r, whites, strict=True))

    best = cost(found)
    for change in ([1.02, 1], [0.98, 1], [1, 1.02], [1, 0.98], [10, 1], [0, 1], [1, 10], [1, 0]):
        assert cost(found * change) > best


def test_a_component_is_recovered_without_bias():
    whites = np.full(P, 0.2)
    found = estimates(np.eye(P) + np.diag(whites), whites, KERNELS[:1], 100)[:, 0]
    # The mean of 100 fits with 36 degrees of freedom has a standard error of 0.028; the full
    # likelihood, which forgets what four parameters of 16 have taken, would say 0.7.
    assert found.mean() == pytest.approx(1.0, abs=3 * 1.2 * np.sqrt(2 / 36 / 100))


@pytest.mark.long
def test_two_components_are_told_apart():
    whites = np.full(P, 0.2)
    V = np.diag(whites) + 1.0 * KERNELS[0] + 0.05 * KERNELS[1]
    found = estimates(V, whites, KERNELS, 60)
    error = found.std(axis=0) / np.sqrt(60)
    assert_allclose(found.mean(axis=0), [1.0, 0.05], atol=3 * error.max())
    assert (np.abs(found.mean(axis=0) - [1.0, 0.05]) < 3 * error).all()
    assert found[:, 1].mean() > 0.03  # the walk is seen at all


def test_where_there_is_only_white_noise_components_are_zero_or_small():
    found = estimates(np.eye(P), np.ones(P), KERNELS, 30)
    assert (found[:, 0] == 0).mean() > 0.3  # by symmetry about half
    assert found[:, 0].mean() < 0.2  # the estimate's own sigma, sqrt(2 / 36)


def test_residuals_smaller_than_their_noise_leave_exactly_zero(rng):
    A = design(rng)
    r = residuals(rng, A, 0.2 * np.eye(P))
    assert fit_components(r, A, np.ones((3, P)), KERNELS).tolist() == [0.0, 0.0]


def test_residuals_of_zero_leave_exactly_zero(rng):
    found = fit_components(np.zeros((1, P)), design(rng), np.ones((1, P)), KERNELS)
    assert found.tolist() == [0.0, 0.0]


@given(st.floats(1e-6, 1e6))
def test_components_go_with_the_square_of_the_units(unit):
    rng = np.random.default_rng(2)
    A, whites = design(rng), np.ones((3, P))
    r = residuals(rng, A, 3 * np.eye(P))
    one = fit_components(r, A, whites, KERNELS[:1])
    other = fit_components(unit * r, A, unit**2 * whites, KERNELS[:1])
    assert_allclose(other, unit**2 * one, rtol=1e-3)  # the tolerance of L-BFGS


def test_what_the_parameters_explain_does_not_count(rng):
    A, whites = design(rng), np.ones((1, P))
    r = residuals(rng, A, 3 * np.eye(P), axes=1)
    moved = r + A @ rng.standard_normal(D)
    found = fit_components(r, A, whites, KERNELS[:1])
    assert_allclose(fit_components(moved, A, whites, KERNELS[:1]), found, rtol=1e-3)  # L-BFGS


def test_a_walk_about_its_mean_has_the_covariance_of_many(rng):
    steps = np.sqrt(np.diff(TIME, prepend=0.0)) * rng.standard_normal((40_000, P))
    walks = np.cumsum(steps, axis=1)
    walks -= walks.mean(axis=1, keepdims=True)
    spread = walk_covariance(TIME)
    # An entry of 40 000 samples has a standard error of at most sqrt(2 / 40 000) of the largest.
    assert_allclose(walks.T @ walks / 40_000, spread, atol=4 * 0.0071 * spread.max())
    assert_allclose(spread.sum(axis=0), 0.0, atol=1e-10)  # rounding of 120 s
    assert_allclose(walk_covariance(TIME + 1000.0), spread, atol=1e-9)
