"""What a scan's readings may be off by: time, white noise, what lasts, and lever arms."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose

from multiimu_ros.fusion.fusion_state import FORCES, fresh_state, INTERVAL, PERIOD, RATES, VALUE
from multiimu_ros.fusion.rig_model import bare_model
from multiimu_ros.fusion.scan_noise import (
    cross_variance,
    follow_time,
    interpolation_gain,
    slow_variance,
    STARTING_PERIOD,
    white_noise,
)

DENSITY = np.tile(np.repeat([1e-4, 2e-3], 3), (3, 1))
STEP_NS = 5_000_000


def state_of(model, scans=200, hole_ns=0):
    state = fresh_state(model)
    for n in range(scans):
        stamp = n * STEP_NS + (hole_ns if n == scans - 1 else 0)
        follow_time(state, stamp)
        state.stamps[-1], state.scans[0] = stamp, n + 1
    return state


def test_a_hole_in_the_stream_is_no_change_of_its_rate():
    state = state_of(bare_model(DENSITY), hole_ns=3_000_000_000)
    assert_allclose(state.clock[INTERVAL], 3.005, rtol=1e-12)
    # It counts as ten periods in a mean of 64: 9 / 64 of 5 ms.
    assert_allclose(state.clock[PERIOD], 0.005 * (1 + 9 / 64), rtol=1e-9)


def test_before_there_are_two_scans_the_period_is_a_guess():
    state = fresh_state(bare_model(DENSITY))
    follow_time(state, 123)
    assert state.clock[INTERVAL] == STARTING_PERIOD
    R = white_noise(state, np.zeros((3, 6)), np.ones(3))
    assert_allclose(R, DENSITY**2 / STARTING_PERIOD, rtol=1e-12)


def test_noise_is_density_squared_times_rate_more_on_probation_and_infinite_without_a_reading():
    state = state_of(bare_model(DENSITY))
    values = np.zeros((3, 6))
    values[2] = np.nan
    R = white_noise(state, values, np.array([1.0, 0.25, 1.0]))
    assert_allclose(R[0], DENSITY[0] ** 2 * 200.0, rtol=1e-9)
    assert_allclose(R[1], 4.0 * R[0], rtol=1e-12)
    assert np.isinf(R[2]).all()
    assert np.isinf(white_noise(state, values, np.zeros(3))).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_the_variance_of_a_cross_product_is_that_of_its_matrix(seed):
    rng = np.random.default_rng(seed)
    arm, half = rng.standard_normal(3), rng.standard_normal((3, 3))
    P = half @ half.T
    x, y, z = arm
    A = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])  # a x r = A a
    assert_allclose(cross_variance(arm, P), np.diag(A @ P @ A.T), rtol=1e-9, atol=1e-12)


def test_what_is_slow_is_told_by_the_motion_of_most_in_this_very_scan():
    known = {
        'response_variance': np.tile(1e-4 * np.eye(6), (3, 1, 1)),
        'floor': np.full((3, 6), 1e-8),
        'delay_variance': np.full(3, 1e-6),
    }
    state = state_of(bare_model(DENSITY, **known))
    z = np.zeros((3, 6))
    z[:, 0] = [2.0, 2.0, 50.0]  # one spike is no motion
    slow = slow_variance(bare_model(DENSITY, **known), state, RATES, z, np.zeros((3, 3)))
    assert_allclose(slow[:, 0], 1e-8 + 1e-4 * 4.0 + 1e-6 * (2.0 / 0.005) ** 2, rtol=1e-9)
    assert_allclose(slow[:, 1:], 1e-8, rtol=1e-9)
    z[:, 0] = np.nan  # nobody says: it is as it was
    state.fused[VALUE, 0] = 3.0
    slow = slow_variance(bare_model(DENSITY, **known), state, RATES, z, np.zeros((3, 3)))
    assert_allclose(slow[:, 0], 1e-8 + 1e-4 * 9.0, rtol=1e-9)


def test_a_bias_that_was_compared_often_is_known_and_arms_count_for_forces_only():
    arms = np.array([[0.1, 0.0, 0.0]] * 3)
    model = bare_model(DENSITY, bias_variance=np.full((3, 6), 1e-2), lever_arms_b=arms)
    state = state_of(model)
    state.tally[:3, 0] = [0.0, 100.0, 10_000.0]
    z, P_a = np.zeros((3, 6)), np.diag([1.0, 2.0, 3.0])
    white = DENSITY[0, 0] ** 2 * 200.0
    slow = slow_variance(model, state, RATES, z, P_a)
    assert_allclose(slow[:, 0], 1.0 / (100.0 + np.array([0, 100, 10_000]) / white), rtol=1e-9)
    slow = slow_variance(model, state, FORCES, z, P_a)
    # a x (0.1, 0, 0) = (0, 0.1 a_z, -0.1 a_y)
    assert_allclose(slow[0] - 1e-2, [0.0, 0.03, 0.02], rtol=1e-9, atol=1e-15)


def test_interpolation_lowers_the_variance_of_each_by_its_own_part():
    b, R = np.full((2, 6), 0.5), np.ones((2, 6))
    R[1] = 3.0
    assert_allclose(interpolation_gain(b, R, np.array([1.0, 0.6])), (1 + 3 * 0.6) / 4, rtol=1e-12)
    b[:, 0], R[:, 0] = 0.0, np.inf
    assert interpolation_gain(b, R, np.ones(2))[0] == 1.0
