"""What cannot be used is taken out, flagged and counted, and nothing else is."""

from dataclasses import replace

from hypothesis import given, strategies as st
import numpy as np
import pytest

from multiimu_ros.calibration.cleaning import at_limit, clean
from multiimu_ros.samples import ImuSamples

STEP_NS = 10_000_000  # 100 Hz
LIMIT = 34.9  # [rad/s] 2000 deg/s


@pytest.fixture
def samples(rng):
    """Return 4 s that wave about well inside the range."""
    noise = rng.standard_normal((2, 400, 3))
    return ImuSamples(STEP_NS * np.arange(400), noise[0], noise[1])


def with_rates(samples, rates):
    return replace(samples, angular_rate=rates)


def test_a_sound_recording_stays_as_it_is(samples):
    track = clean(samples)
    assert np.array_equal(track.samples.angular_rate, samples.angular_rate)
    assert track.usable.all()
    counts = track.not_finite, track.backward, track.saturated, track.gaps, track.missing_s
    assert counts == (0, 0, 0, 0, 0.0)


@pytest.mark.parametrize('value', [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize('name', ['angular_rate', 'specific_force'])
def test_readings_that_are_not_finite_are_dropped_and_counted(samples, name, value):
    vectors = getattr(samples, name).copy()
    vectors[[7, 9, 200], [0, 1, 2]] = value
    track = clean(replace(samples, **{name: vectors}))
    assert track.not_finite == 3
    assert np.array_equal(track.samples.stamp_ns, np.delete(samples.stamp_ns, [7, 9, 200]))


def test_stamps_that_repeat_or_go_back_are_dropped_until_time_advances_again(samples):
    stamps = samples.stamp_ns.copy()
    stamps[11] = stamps[10]  # the same twice
    stamps[100:103] = stamps[50]  # three back, and the next is ahead again
    track = clean(replace(samples, stamp_ns=stamps))
    assert track.backward == 4
    dropped = [11, 100, 101, 102]
    assert np.array_equal(track.samples.stamp_ns, np.delete(samples.stamp_ns, dropped))
    assert np.array_equal(track.samples.angular_rate, np.delete(samples.angular_rate, dropped, 0))


@given(st.lists(st.integers(0, 30), max_size=40))
def test_what_is_left_advances_and_no_more_than_needed_is_dropped(stamps):
    readings = np.zeros((len(stamps), 3))
    track = clean(ImuSamples(np.array(stamps, dtype=np.int64), readings, readings))
    kept = track.samples.stamp_ns.tolist()
    records = [s for k, s in enumerate(stamps) if s > max(stamps[:k], default=-1)]
    assert kept == records
    assert track.backward == len(stamps) - len(records)


@pytest.mark.parametrize('sign', [1, -1])
@pytest.mark.parametrize('name', ['angular_rate', 'specific_force'])
def test_clipped_peaks_are_flagged_with_their_neighbours(samples, name, sign):
    wave = getattr(samples, name) + 0.0
    wave[:, 1] += sign * 40 * np.exp(-(((np.arange(400) - 200) / 12) ** 2))
    wave = np.clip(wave, -LIMIT, LIMIT)
    track = clean(replace(samples, **{name: wave}))
    clipped = np.flatnonzero(np.abs(wave[:, 1]) == LIMIT)
    assert len(clipped) >= 5
    assert track.saturated == len(clipped)
    spoilt = np.unique(np.clip(clipped[:, np.newaxis] + np.arange(-2, 3), 0, 399))
    assert np.flatnonzero(~track.usable).tolist() == spoilt.tolist()


def test_saturation_at_the_ends_of_a_recording_spoils_what_is_there(samples):
    rates = samples.angular_rate.copy()
    rates[[0, 1, 2, 397, 398, 399], 0] = LIMIT
    track = clean(with_rates(samples, rates))
    assert np.flatnonzero(~track.usable).tolist() == [0, 1, 2, 3, 4, *range(395, 400)]


def test_a_peak_that_is_reached_once_or_twice_is_not_a_limit(samples):
    rates = samples.angular_rate.copy()
    rates[[30, 130, 230, 330], 2] = 12.0  # four times: less than a pile
    assert clean(with_rates(samples, rates)).usable.all()


@given(step=st.floats(0.05, 20.0), offset=st.floats(-5.0, 5.0), seed=st.integers(0, 99))
def test_noise_at_rest_is_no_limit_however_coarse_the_steps(step, offset, seed):
    noise = np.random.default_rng(seed).standard_normal((1000, 3)) + offset
    assert not at_limit(np.round(noise / step) * step).any()


def test_holes_are_counted_with_what_they_lack(samples):
    kept = np.ones(400, bool)
    kept[100:150] = False  # 50 missing
    kept[200] = False  # one is no hole
    kept[300:303] = False  # three are: 4 periods from neighbour to neighbour
    track = clean(samples.select(kept))
    assert track.gaps == 2
    assert track.missing_s == pytest.approx(0.53, rel=1e-12)


def test_a_recording_without_samples_is_clean():
    none = np.zeros((0, 3))
    track = clean(ImuSamples(np.zeros(0, dtype=np.int64), none, none))
    assert (len(track.samples), len(track.usable), track.gaps) == (0, 0, 0)


def test_new_stamps_change_nothing_else(samples):
    track = clean(samples)
    moved = track.restamped(samples.stamp_ns + 5)
    assert np.array_equal(moved.samples.stamp_ns, samples.stamp_ns + 5)
    assert moved.usable is track.usable
    assert moved.saturated == track.saturated
    assert moved.seconds_since(5)[100] == pytest.approx(1.0, rel=1e-12)
