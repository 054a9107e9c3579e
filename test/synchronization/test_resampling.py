"""Resampling: what it must keep, what it must take out, and what it must not make up."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from multiimu_ros.synchronization.resampling import (
    bridge,
    Grid,
    make_grid,
    REACH,
    resample,
    smooth,
    WIDTH,
)

STEP = 0.005
TAIL = 3.2e-5  # of a Gaussian, beyond 4 sigma on one side


def stamps_of(rng, seconds=4.0, jitter=0.0003):
    time = np.arange(0.0, seconds, STEP)
    return time + jitter * rng.uniform(-1, 1, len(time))


def waves(time, rates=(2.0, 3.5, 5.0)):
    """Return three channels of hand-like motion on top of gravity, (N, 3)."""
    return np.column_stack([9.81 + np.sin(2 * np.pi * f * time + f) for f in rates])


def brought(time, values, grid, usable=None):
    usable = np.ones(len(time), bool) if usable is None else usable
    return resample(time, values, usable, grid)


@given(seed=st.integers(0, 2**32 - 1), order=st.integers(0, 1))
def test_a_linear_relation_between_streams_survives_exactly(seed, order):
    rng = np.random.default_rng(seed)
    time = stamps_of(rng, 1.0)
    mixing, offset = rng.standard_normal((3, 3)), rng.standard_normal(3)
    first = rng.standard_normal((len(time), 3))  # noise, the hardest signal
    grid = make_grid(0.1, 0.9, STEP)
    a, b = (
        smooth(brought(time, values, grid), grid, order)
        for values in (first, first @ mixing.T + offset)
    )
    known = np.isfinite(a).all(axis=1)
    assert known.sum() > 100
    expected = a @ mixing.T + (offset if order == 0 else 0.0)
    # Every step is linear: only rounding is left, a derivative's divided by the step.
    assert_allclose(b[known], expected[known], rtol=0, atol=1e-10 / STEP**order)


def test_streams_sampled_at_other_instants_agree_where_they_move_like_a_hand(rng):
    grid = make_grid(0.5, 3.5, STEP)
    found = [
        smooth(brought(time, waves(time), grid), grid)
        for time in (stamps_of(rng), stamps_of(rng) + 0.0022)
    ]
    # A cubic spline errs by 5/384 h^4 |f''''| at most: 1.3e-5 at 5 Hz, h = 5.6 ms.
    assert_allclose(found[0], found[1], rtol=0, atol=2 * 1.3e-5)


def test_smoothing_divides_a_sine_by_the_gaussian_of_its_frequency():
    grid = Grid(0.0, STEP, 4000, 2 * STEP)
    for frequency in (1.0, 10.0, 30.0):
        wave = np.sin(2 * np.pi * frequency * grid.time)[:, np.newaxis]
        gain = np.exp(-((2 * np.pi * frequency * grid.sigma) ** 2) / 2)
        middle = slice(100, -100)  # the ends are held
        # The kernel is cut at 6 sigma: 2e-9 of it is missing.
        assert_allclose(smooth(wave, grid)[middle], gain * wave[middle], rtol=0, atol=1e-8)


def test_the_smoothed_derivative_is_the_derivative_of_the_smoothed_signal():
    grid = make_grid(0.0, 4.0, STEP)
    omega = 2 * np.pi * np.array([0.5, 5.0, 20.0])
    signal, slope = np.sin(np.outer(grid.time, omega)), omega * np.cos(np.outer(grid.time, omega))
    middle = slice(50, -50)
    # 20 Hz of 126 /s: the kernel of 1.25 steps is sampled and cut at 6 sigma, 1e-8 of it is lost.
    assert_allclose(
        smooth(signal, grid, 1)[middle], smooth(slope, grid)[middle], rtol=0, atol=1e-6 * 126
    )


def test_a_difference_quotient_would_be_biased():
    grid = make_grid(0.0, 4.0, STEP)
    omega = 2 * np.pi * 5.0
    wave = np.sin(omega * grid.time)[:, np.newaxis]
    quotient = np.gradient(smooth(wave, grid), STEP, axis=0)[50:-50]
    ours = smooth(wave, grid, 1)[50:-50]
    # sin(x)/x of x = omega h = 0.157 is 1 - 0.0041.
    assert_allclose(np.abs(quotient).max() / np.abs(ours).max(), 1 - 0.0041, atol=2e-4)


@given(begin=st.integers(30, 300), length=st.integers(3, 200), spare=st.integers(0, 300))
def test_nan_is_around_holes_and_outside_the_samples_and_nowhere_else(begin, length, spare):
    count = begin + length + 60 + spare
    time = STEP * np.arange(count)
    kept = np.ones(count, bool)
    kept[begin : begin + length] = False
    grid = Grid(-20 * STEP, STEP, count + 40, WIDTH * STEP)
    usable = np.ones(kept.sum(), bool)
    found = smooth(resample(time[kept], waves(time[kept]), usable, grid), grid)
    place = np.arange(grid.count) - 20
    # Spoilt are the instants strictly inside the hole, and outside; grids and stamps may round.
    bad = (place < 0) | (place >= count) | ((place >= begin) & (place < begin + length))
    reach = int(np.ceil(REACH * WIDTH))
    near = np.array([bad[max(k - reach, 0) : k + reach + 1].any() for k in range(grid.count)])
    edge = np.array([near[max(k - 1, 0) : k + 2].any() for k in range(grid.count)])
    inner = np.array([near[max(k - 1, 0) : k + 2].all() for k in range(grid.count)])
    missing = np.isnan(found).any(axis=1)
    assert not missing[~edge].any()
    assert missing[inner].all()


def test_one_or_two_lost_samples_are_no_hole(rng):
    time = stamps_of(rng, jitter=0.0)
    kept = rng.random(len(time)) > 0.1
    kept[1:] |= ~kept[:-1]  # never two in a row
    grid = make_grid(0.5, 3.5, STEP)
    assert np.isfinite(brought(time[kept], waves(time[kept]), grid)).all()


def test_samples_that_must_not_be_used_leave_no_trace(rng):
    time = stamps_of(rng)
    values = waves(time)
    spoilt, usable = values.copy(), np.ones(len(time), bool)
    usable[300:340] = False
    spoilt[300:340] = 1e9
    spoilt[500:520] = np.nan
    grid = make_grid(0.5, 3.5, STEP)
    out = smooth(brought(time, spoilt, grid, usable), grid)
    clean = smooth(brought(time, values, grid), grid)
    missing = np.isnan(out).any(axis=1)
    assert 60 < missing.sum() < 100  # 40 + 20 samples, and 2 x 2 x 5 steps around them
    # The spline forgets by 0.27 a sample and 4 sigma are 5 steps: 1.4e-3 of its end effect.
    assert_allclose(out[~missing], clean[~missing], rtol=0, atol=1e-4)


def test_a_tone_that_a_slower_grid_cannot_carry_is_taken_out():
    slow = 4 * STEP
    grid = make_grid(0.0, 8.0, STEP, WIDTH * slow)
    for share in (0.55, 0.9, 1.0, 1.6):
        tone = np.sin(2 * np.pi * share / slow * grid.time)[:, np.newaxis]
        # exp(-(2 pi 0.55 x 1.25)^2 / 2) = 8.9e-5
        assert np.abs(smooth(tone, grid)[100:-100]).max() < 1e-4


def test_nothing_rings_beside_a_bridged_hole():
    grid = make_grid(0.0, 4.0, STEP)
    values = waves(grid.time)
    holed = values.copy()
    holed[300:320] = np.nan
    out, whole = smooth(holed, grid), smooth(values, grid)
    used = np.isfinite(out).all(axis=1)
    assert used.sum() == grid.count - 20 - 4 * int(np.ceil(REACH * WIDTH))  # and both ends
    apart = np.abs(bridge(holed) - values).max()
    # What a straight line makes up is felt through the tails of the kernel only.
    assert np.abs(out - whole)[used].max() < TAIL * apart
    zeros = np.nan_to_num(holed)
    assert np.abs(smooth(zeros, grid) - whole)[used].max() > TAIL * apart  # zeros would be felt


def test_a_bridge_is_straight_and_the_ends_are_held():
    nan = np.nan
    values = np.array([[nan, 5.0], [1.0, nan], [nan, nan], [nan, 8.0], [4.0, nan]])
    expected = [[1.0, 5.0], [1.0, 6.0], [2.0, 7.0], [3.0, 8.0], [4.0, 8.0]]
    assert_allclose(bridge(values), expected, rtol=1e-12)
    assert_array_equal(np.isnan(bridge(np.full((4, 2, 3), nan))), np.ones((4, 2, 3), bool))


@pytest.mark.parametrize('count', [0, 3])
def test_a_stream_of_hardly_any_samples_tells_nothing(count):
    grid = make_grid(0.0, 1.0, STEP)
    time = STEP * np.arange(count)
    out = resample(time, np.ones((count, 6)), np.ones(count, bool), grid)
    assert out.shape == (grid.count, 6)
    assert np.isnan(out).all()


def test_a_grid_covers_its_span_and_is_empty_where_there_is_none():
    grid = make_grid(2.0, 3.0, 0.1)
    assert_allclose(grid.time, 2.0 + 0.1 * np.arange(11)[: grid.count], rtol=1e-12)
    assert grid.count in (10, 11)  # 1.0 / 0.1 may round either way
    assert make_grid(3.0, 2.0, 0.1).count == 0
