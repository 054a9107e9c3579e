"""The federated filter against the centralised one, and its own promises."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.federated import federated_step, information_shares

seeds = st.integers(0, 2**32 - 1)


def centralised_step(x, P, z, R, Q):
    """One Kalman step on all measurements at once, in information form: the reference."""
    prior = 1.0 / (P + Q)
    information = prior + (1.0 / R).sum(axis=0)
    return (prior * x + (z / R).sum(axis=0)) / information, 1.0 / information


@given(seed=seeds)
def test_shares_sum_to_one_and_follow_the_information(seed):
    R = np.random.default_rng(seed).uniform(0.1, 10.0, (5, 3))
    b = information_shares(R)
    assert_allclose(b.sum(axis=0), 1.0, rtol=1e-12)
    assert_allclose(b * R, np.broadcast_to((b * R)[0], R.shape), rtol=1e-12)


@given(seed=seeds)
def test_the_federated_filter_equals_the_centralised_one_for_any_shares(seed):
    rng = np.random.default_rng(seed)
    R, Q = rng.uniform(0.1, 10.0, (4, 6)), rng.uniform(0.0, 1.0, 6)
    x, P = np.zeros(6), np.full(6, 5.0)
    reference = x, P
    for _ in range(30):
        z = rng.standard_normal((4, 6))
        b = rng.dirichlet(np.ones(4), 6).T
        x, P = federated_step(x, P, z, R, Q, b)
        reference = centralised_step(*reference, z, R, Q)
    # Two orders of the same sums; the shares may be as small as 1e-3 and cost some digits.
    assert_allclose((x, P), reference, rtol=1e-9, atol=1e-11)


@pytest.mark.compiled
def test_the_error_is_as_large_as_the_filter_says(rng):
    R, Q, runs = np.array([[1.0], [4.0], [9.0]]) * np.ones((3, 2000)), np.full(2000, 0.3), 400
    truth, x, P = np.zeros(2000), np.zeros(2000), np.full(2000, np.inf)
    b = information_shares(R)
    for _ in range(runs):
        truth += np.sqrt(Q) * rng.standard_normal(2000)
        z = truth + np.sqrt(R) * rng.standard_normal((3, 2000))
        x, P = federated_step(x, P, z, R, Q, b)
    # NEES of 2000 independent filters: standard error sqrt(2 / 2000) = 0.032, three of them.
    assert np.mean((x - truth) ** 2 / P) == pytest.approx(1.0, abs=0.1)


def test_the_first_measurement_is_the_estimate_where_nothing_was_known():
    R, unknown = np.array([[1.0], [3.0]]), np.array([np.inf])
    x, P = federated_step(
        np.zeros(1), unknown, np.array([[2.0], [6.0]]), R, np.ones(1), information_shares(R)
    )
    assert_allclose((x[0], P[0]), (3.0, 0.75), rtol=1e-12)  # weighted mean of 2 and 6, 3 : 1


def test_a_sensor_without_a_reading_has_no_share_and_no_influence():
    R = np.array([[1.0], [np.inf]])
    x, P = federated_step(
        np.zeros(1), np.ones(1), np.array([[2.0], [np.nan]]), R, np.zeros(1), information_shares(R)
    )
    assert_allclose((x[0], P[0]), (1.0, 0.5), rtol=1e-12)


def test_an_axis_that_nobody_sees_is_only_predicted():
    R = np.full((2, 1), np.inf)
    b = information_shares(R)
    x, P = federated_step(np.ones(1), np.ones(1), np.full((2, 1), np.nan), R, np.full(1, 0.5), b)
    assert (b == 0.0).all()
    assert_allclose((x[0], P[0]), (1.0, 1.5), rtol=1e-12)
