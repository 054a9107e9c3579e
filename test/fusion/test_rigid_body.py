"""Lever arms against the cross products of the textbook, and the slope of a noisy rate."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.rigid_body import (
    end_slope,
    HISTORY,
    lever_arm_matrix,
    push_slope,
    specific_force_at,
)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_matrix_gives_the_cross_products(seed):
    rate, acceleration, arm, force = np.random.default_rng(seed).standard_normal((4, 1, 3))
    felt = specific_force_at(arm[0], force, rate, acceleration)
    moved = force[0] + lever_arm_matrix(rate[0], acceleration[0]) @ arm[0]
    assert_allclose(moved, felt[0], rtol=1e-12, atol=1e-12)


def test_eight_centimetres_at_three_radians_a_second_cost_what_the_sources_deny():
    rate = 3.0 * np.random.default_rng(0).standard_normal((4000, 3)) / np.sqrt(3.0)
    felt = specific_force_at(
        np.array([0.08, 0.0, 0.0]), np.zeros((4000, 3)), rate, np.zeros((4000, 3))
    )
    # ALGORITHMS: 1.7 m/s^2 with the angular acceleration of a hand; its centripetal part alone:
    assert 0.5 < np.sqrt(np.mean(np.sum(felt**2, axis=1))) < 1.7


@pytest.mark.parametrize('count', [3, 5, 21])
def test_the_slope_of_a_parabola_is_exact_at_its_newest_end(count, rng):
    ages = np.sort(rng.uniform(-0.02, 0.0, count))
    ages[-1] = 0.0
    constant, slope, curvature = rng.standard_normal((3, 1, 3))
    values = constant + slope * ages[:, None] + curvature * ages[:, None] ** 2
    assert_allclose(end_slope(ages, values)[0], slope[0], rtol=1e-7)


def test_two_samples_give_their_difference_and_one_gives_nothing():
    slope, gain = end_slope(np.array([-0.5, 0.0]), np.array([[1.0, 2.0, 3.0], [2.0, 2.0, 2.0]]))
    assert slope.tolist() == [2.0, 0.0, -2.0]
    assert gain == 8.0  # two variances over the interval squared
    slope, gain = end_slope(np.zeros(1), np.ones((1, 3)))
    assert slope.tolist() == [0.0, 0.0, 0.0]
    assert gain == np.inf


def test_the_gain_is_the_variance_of_the_slope(rng):
    ages = np.linspace(-0.02, 0.0, 5)
    slopes = np.array([end_slope(ages, rng.standard_normal((5, 3)))[0] for _ in range(3000)])
    gain = end_slope(ages, np.zeros((5, 3)))[1]
    # 9000 numbers: the standard error of their variance is 1.5 %, three of them.
    assert slopes.var() == pytest.approx(gain, rel=0.045)


@pytest.mark.parametrize('rate_hz', [62.5, 200.0, 1000.0, 3000.0])
def test_the_live_slope_follows_a_hand_within_two_per_cent(rate_hz):
    state = np.zeros(HISTORY, dtype=np.int64), np.zeros((HISTORY, 3)), np.zeros(1, dtype=np.int64)
    omega, errors = 2 * np.pi, []  # a hand reverses once a second
    for n in range(int(rate_hz)):
        t = n / rate_hz
        slope, _ = push_slope(*state, round(t * 1e9), np.sin(omega * t) * np.ones(3))
        errors.append(slope[0] - omega * np.cos(omega * t))
    assert np.max(np.abs(errors[5:])) < 0.02 * omega


def test_samples_from_before_a_hole_do_not_make_a_slope():
    state = np.zeros(HISTORY, dtype=np.int64), np.zeros((HISTORY, 3)), np.zeros(1, dtype=np.int64)
    push_slope(*state, 0, np.zeros(3))
    slope, gain = push_slope(*state, 1_000_000_000, np.ones(3))
    assert (slope == 0.0).all()
    assert gain == np.inf
