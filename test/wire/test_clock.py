"""The clock against simulated boards whose true time is known."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.wire.clock import DeviceClock

START = 1_780_000_000_000_000_000  # an instant in 2026 [ns]


def late_arrivals(rng, skew_ppm, seconds, first_ticks=0, rate_hz=200):
    """Return true instants, ticks and arrivals [ns], [us], [ns] of a board with a skewed clock.

    Lateness is log-normal: 0.6 ms in the median, 5 ms in the 99th percentile.
    """
    true = np.arange(0, seconds * 1e9, 1e9 / rate_hz).astype(np.int64)
    ticks = (first_ticks + np.rint(true / 1000 * (1 + skew_ppm * 1e-6)).astype(np.int64)) % 2**32
    sigma = np.log(5.0 / 0.6) / 2.326  # 2.326: the 99th percentile of a normal
    late = 0.6e6 * np.exp(sigma * rng.standard_normal(len(true)))
    arrivals = np.maximum.accumulate(START + true + late.astype(np.int64))
    return START + true, ticks, arrivals


def run(clock, ticks, arrivals):
    return np.array([clock.observe(int(t), int(a)) for t, a in zip(ticks, arrivals, strict=True)])


@pytest.mark.parametrize('skew_ppm', [3000, -500])
@pytest.mark.parametrize('seed', range(5))
def test_skew_is_found_within_10_ppm_in_20_s(skew_ppm, seed):
    clock = DeviceClock()
    true, ticks, arrivals = late_arrivals(np.random.default_rng(seed), skew_ppm, 20)
    stamps = run(clock, ticks, arrivals)
    assert clock.skew_ppm == pytest.approx(skew_ppm, abs=10)
    # The least of 200 delays a second is about 50 us; arrivals themselves are 600 us late.
    assert np.abs((stamps - true)[-1000:]).max() < 150e3
    assert np.std((stamps - true)[-1000:]) < 30e3


def test_jitter_is_that_of_the_arrivals(rng):
    clock = DeviceClock()
    true, ticks, arrivals = late_arrivals(rng, 100, 20)
    run(clock, ticks, arrivals)
    # One second holds 200 heavy-tailed delays: their spread is known to a few tens of percent.
    assert clock.jitter_us == pytest.approx(np.std(arrivals - true) / 1000, rel=0.7)


def test_stamps_do_not_notice_the_wrap_of_the_ticks(rng):
    _, ticks, arrivals = late_arrivals(rng, 50, 20, first_ticks=2**32 - 10_000_000)
    assert ticks[-1] < ticks[0]
    clock = DeviceClock()
    stamps = run(clock, ticks, arrivals)
    assert_allclose(stamps, run(DeviceClock(), (ticks + 10_000_000) % 2**32, arrivals), atol=0)
    assert clock.epochs == 1


def test_a_silence_of_hours_keeps_the_epoch(rng):
    clock = DeviceClock()
    true, ticks, arrivals = late_arrivals(rng, 0, 10)
    run(clock, ticks, arrivals)
    pause = 3 * 3600 * 1_000_000_000
    stamp = clock.observe((int(ticks[-1]) + pause // 1000) % 2**32, int(true[-1]) + pause)
    assert clock.epochs == 1
    assert stamp - true[-1] - pause == pytest.approx(0, abs=0.2e9)  # 20 ppm of three hours


def test_a_reset_board_begins_a_new_epoch_behind_the_last_stamp(rng):
    clock = DeviceClock()
    _, ticks, arrivals = late_arrivals(rng, 0, 15)
    stamps = run(clock, ticks, arrivals)
    again = run(clock, ticks, arrivals + 15_500_000_000)
    assert clock.epochs == 2
    assert again[0] > stamps[-1]
    assert again[0] == arrivals[0] + 15_500_000_000  # nothing is known of a new clock but this


def test_a_new_epoch_cannot_begin_before_the_last_stamp():
    clock = DeviceClock()
    last = clock.observe(5000, START)
    clock.restart()
    assert clock.observe(0, START - 1_000_000) == last + 1
    assert clock.observe(1, START - 999_000) == last + 2


@given(
    skew_ppm=st.integers(-15_000, 15_000),
    seed=st.integers(0, 2**32 - 1),
    stall_ms=st.integers(0, 3000),
)
def test_stamps_never_step_backwards(skew_ppm, seed, stall_ms):
    _, ticks, arrivals = late_arrivals(np.random.default_rng(seed), skew_ppm, 4)
    arrivals[300:] = np.maximum(arrivals[300:], arrivals[300] + stall_ms * 1_000_000)
    stamps = run(DeviceClock(), ticks, arrivals)
    # A stamp advances by its ticks, give or take the skew (2 %) and the bend (1 %) allowed, or
    # a quarter more slowly after one that was ahead of its own arrival.
    rate = np.diff(stamps) / (1000 * np.diff(ticks))
    assert rate.min() >= 0.7299
    assert rate.max() <= 1.0301


@pytest.mark.parametrize('first_late_ms', [15, 200])
def test_first_bytes_that_were_late_are_soon_forgotten(rng, first_late_ms):
    true, ticks, arrivals = late_arrivals(rng, 100, 12)
    arrivals = np.maximum(arrivals, arrivals[0] + first_late_ms * 1_000_000)  # a busy machine
    error = run(DeviceClock(), ticks, arrivals) - true
    assert error[0] > 0.9e6 * first_late_ms
    over = 0.1 + 5e-3 * first_late_ms  # [s] the bytes must catch up, then the stamps
    assert np.abs(error[round(200 * over) :]).max() < 2e6  # as with the first bytes in time
    assert np.ptp(error[1200:]) < 50e3


def test_exchanges_take_off_the_constant_part_of_the_delay(rng):
    true, ticks, arrivals = late_arrivals(rng, 200, 20)
    arrivals += 4_000_000  # a long frame on a slow line
    clock = DeviceClock()
    for k, (t, a) in enumerate(zip(ticks, arrivals, strict=True)):
        stamp = clock.observe(int(t), int(a))
        if k % 200 == 0:  # short frames need 0.3 ms out and 0.4 ms back
            clock.bound(int(t), int(true[k]) - 300_000, int(true[k]) + 400_000)
    assert stamp - true[-1] == pytest.approx(50e3, abs=50e3)  # half the difference remains


def test_an_exchange_before_the_first_scan_is_ignored():
    clock = DeviceClock()
    clock.bound(5, START, START + 1)
    assert clock.epochs == 0
