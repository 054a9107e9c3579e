"""The shared update against the textbook's matrix form."""

import numpy as np
from numpy.testing import assert_allclose

from multiimu_ros.odometry.kalman import (
    propagate,
    scalar_update,
    transform_block,
    white_equivalent,
)


def covariance(rng, n):
    """Return a random (n, n) covariance."""
    root = rng.standard_normal((n, n))
    return root @ root.T + np.eye(n)


def test_three_scalars_equal_one_vector_measurement(rng):
    P, H = covariance(rng, 9), rng.standard_normal((3, 9))
    z, r = rng.standard_normal(3), np.array([0.5, 1.0, 2.0])
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(r))
    error, sequential = np.zeros(9), P.copy()
    for axis in range(3):
        scalar_update(error, sequential, H[axis], z[axis], r[axis], 0, 9)
    # Independent noises: the order does not matter, so both are the same estimate.
    assert_allclose(error, K @ z, rtol=1e-9, atol=1e-12)
    assert_allclose(sequential, (np.eye(9) - K @ H) @ P, rtol=1e-9, atol=1e-9)


def test_considered_states_widen_but_never_move(rng):
    P, h = covariance(rng, 9), rng.standard_normal(9)
    s = h @ P @ h + 0.7
    K = P @ h / s
    K[:2], K[6:] = 0.0, 0.0
    joseph = np.eye(9) - np.outer(K, h)
    expected = joseph @ P @ joseph.T + 0.7 * np.outer(K, K)
    error, updated = np.zeros(9), P.copy()
    scalar_update(error, updated, h, 1.3, 0.7, 2, 6)
    assert_allclose(updated, expected, rtol=1e-10, atol=1e-10)
    assert not error[[0, 1, 6, 7, 8]].any()
    assert_allclose(updated[:2, :2], P[:2, :2], rtol=1e-12)
    assert_allclose(updated[6:, 6:], P[6:, 6:], rtol=1e-12)


def test_a_nan_changes_nothing(rng):
    P = covariance(rng, 6)
    error, updated = np.zeros(6), P.copy()
    scalar_update(error, updated, np.eye(6)[2], np.nan, 1.0, 0, 6)
    scalar_update(error, updated, np.eye(6)[2], 1.0, np.nan, 0, 6)
    assert not error.any()
    assert (updated == P).all()


def test_propagation_over_zeros_is_the_matrix_product(rng):
    P, F = covariance(rng, 15), rng.standard_normal((15, 15))
    F[rng.random((15, 15)) < 0.6] = 0.0
    propagated = P.copy()
    propagate(propagated, F)
    assert_allclose(propagated, F @ P @ F.T, rtol=1e-12, atol=1e-12)
    assert (propagated == propagated.T).all()


def test_transform_is_a_congruence(rng):
    P, G = covariance(rng, 9), rng.standard_normal((3, 3))
    full = np.eye(9)
    full[3:6, 3:6] = G
    transformed = P.copy()
    transform_block(transformed, G, 3)
    assert_allclose(transformed, full @ P @ full.T, rtol=1e-12, atol=1e-12)


def test_information_of_correlated_samples_does_not_depend_on_the_rate():
    # One second of samples: information = samples / variance.
    slow = 100 / white_equivalent(0.02, 0.05, 0.01)
    fast = 1000 / white_equivalent(0.02, 0.05, 0.001)
    assert_allclose(slow, fast, rtol=1e-12)
    # 1 s holds 1 / (2 tau) = 10 independent values.
    assert_allclose(fast, 10 / 0.02**2, rtol=1e-12)
    assert white_equivalent(0.02, 0.05, 10.0) == 0.02**2
