"""Paths meet their keyframes, are smooth in between, and rest exactly."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.simulation.paths import Path, stepper_move, through


def random_path(rng, count):
    """Return a path through `count` random keyframes, at rest at both ends."""
    time = np.cumsum(rng.uniform(0.1, 1.0, count))
    value, first, second = rng.standard_normal((3, count, 6))
    first[[0, -1]] = second[[0, -1]] = 0.0
    return Path(time, value, first, second)


@given(seed=st.integers(0, 2**32 - 1))
def test_the_path_meets_its_keyframes_from_both_sides(seed):
    path = random_path(np.random.default_rng(seed), 5)
    for shift in (-1e-9, 0.0, 1e-9):
        value, first, second = path.at(path.time + shift)
        # In 1 ns nothing moves by more than the third derivative allows, some 1e4 here.
        assert_allclose(value, path.value, atol=1e-6)
        assert_allclose(first, path.first, atol=1e-5)
        assert_allclose(second[1:-1], path.second[1:-1], atol=1e-3)


@given(seed=st.integers(0, 2**32 - 1))
def test_superposed_paths_add_up(seed):
    rng = np.random.default_rng(seed)
    one, other = random_path(rng, 4), random_path(rng, 6)
    times = np.linspace(-1.0, 7.0, 200)
    both = (one + other).at(times)
    for order in range(3):
        # The same quintics, expanded about other points: rounding grows with 1 / piece^5.
        assert_allclose(both[order], one.at(times)[order] + other.at(times)[order], atol=1e-6)


def test_still_is_flagged_where_and_only_where_the_path_pauses():
    path = through([0.0, 1.0, 2.0, 3.0], x=[0, 0, 1, 1])
    times = np.array([-1.0, 0.0, 0.5, 1.0, 1.5, 1.999, 2.0, 2.5, 3.0, 9.0])
    assert path.still(times).tolist() == [True] * 3 + [False] * 3 + [True] * 4


def test_a_stepper_move_accelerates_cruises_brakes_and_stops():
    path = stepper_move(1.0, 3.0, x=0.5)
    value, first, second = path.at(np.array([0.9, 1.5, 2.5, 3.5, 4.0]))
    up, cruise, down = second[1:4, 0]
    assert up > 0
    # Rounding only: the profile is symmetric, its cruise unaccelerated.
    assert_allclose([cruise, down], [0, -up], atol=1e-12)
    assert_allclose(value[[0, -1], 0], [0, 0.5], atol=1e-12)
    # Trapezoid of 3 s with ramps of a third: distance = top speed x 2 s.
    assert_allclose(first[2, 0], 0.25, rtol=1e-12)


def test_keyframes_out_of_order_are_refused():
    with pytest.raises(ValueError, match='`time` of the keyframes must increase'):
        through([0.0, 1.0, 1.0])


def test_a_path_that_ends_in_motion_is_refused():
    moving = np.ones((2, 6))
    with pytest.raises(ValueError, match='must be 0 at both ends'):
        Path(np.array([0.0, 1.0]), moving, moving, moving)
