"""The rests of a recording are found, whatever the units, and only those."""

from dataclasses import replace

from calibration_runs import recorded, rests_of
from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.static_intervals import (
    board_ratio,
    find_intervals,
    StaticConfig,
    StaticIntervals,
    variance_ratio,
)
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.errors import BMI160, TriadErrors

CONFIG = StaticConfig()
STEP_NS = 10_000_000  # 100 Hz


def seconds(intervals, origin_ns=0):
    spans = np.column_stack([intervals.begin_ns, intervals.end_ns]) - origin_ns
    return spans / NANOSECONDS


def found(tracks, threshold=3.0, config=CONFIG):
    stamp_ns, ratio = board_ratio(tracks, config)
    return find_intervals(stamp_ns, ratio, threshold, config)


def rested(quiet, stamp_ns=None, config=CONFIG):
    """Return the intervals [s] where the ratio is 1, at 100 Hz unless stamped otherwise."""
    ratio = np.where(quiet, 1.0, 100.0)
    stamps = STEP_NS * np.arange(len(ratio)) if stamp_ns is None else stamp_ns
    return seconds(find_intervals(stamps, ratio, 3.0, config))


@pytest.fixture(scope='module')
def recording():
    """Return 9 rests seen by two IMUs, the second of which lags by 0.4 ms."""
    return recorded(8, imus=2)


@pytest.mark.parametrize('imus', [1, 2])
def test_the_rests_of_a_calibration_are_found_within_a_window(recording, imus):
    spans = seconds(found(recording.raw[:imus]), recording.raw[0].stamp_ns[0])
    assert len(spans) == 9
    # A quintic of 3 s is still for its first tenths too, as far as the noise can tell.
    assert_allclose(spans, rests_of(recording), atol=CONFIG.window_s)


def test_about_all_that_is_found_at_rest_is_at_rest(recording):
    samples = recording.raw[0]
    spans = found([samples])
    inside = np.zeros(len(samples), bool)
    for begin, end in zip(spans.begin_ns, spans.end_ns, strict=True):
        inside |= (samples.stamp_ns >= begin) & (samples.stamp_ns <= end)
    truth = recording.truth
    assert np.linalg.norm(truth.angular_rate_b[inside], axis=1).max() < 0.1  # of 2 rad/s
    # Of the half window at either end of 3 s, half is given back: 0.25 s may be lost.
    assert inside[truth.still].mean() > 1 - 0.25 / 3


def test_at_rest_the_ratio_is_about_1_and_in_motion_far_above(recording):
    ratio = variance_ratio(recording.raw[0])
    still = recording.truth.still
    # The quietest windows of 50 samples have a variance a fifth or so below the average.
    assert np.median(ratio[still]) == pytest.approx(1.2, abs=0.2)
    assert np.median(ratio[~still]) > 1000


@given(rate=st.floats(1e-4, 1e4), force=st.floats(1e-4, 1e4), offset=st.floats(-1e4, 1e4))
def test_the_ratio_does_not_depend_on_units_and_offsets(rate, force, offset):
    rng = np.random.default_rng(1)
    samples = ImuSamples(STEP_NS * np.arange(300), *rng.standard_normal((2, 300, 3)))
    other = ImuSamples(
        samples.stamp_ns,
        rate * (samples.angular_rate + offset),
        force * (samples.specific_force - offset),
    )
    # Adding an offset of 1e4 costs four of the sixteen digits, and squares twice that.
    assert_allclose(variance_ratio(other), variance_ratio(samples), rtol=1e-7)


def test_the_ratio_is_that_of_the_naive_formula(rng):
    samples = ImuSamples(STEP_NS * np.arange(200), *rng.standard_normal((2, 200, 3)))
    ratio = np.zeros(200)
    for vectors in (samples.angular_rate, samples.specific_force):
        padded = np.pad(vectors, ((25, 24), (0, 0)), mode='edge')  # 0.5 s are 50 samples
        variance = np.array([padded[i : i + 50].var(axis=0).sum() for i in range(200)])
        ratio += variance / np.quantile(variance, 0.05) / 2
    assert_allclose(variance_ratio(samples), ratio, rtol=1e-10)  # var by two ways


def test_the_board_rests_only_where_all_imus_do():
    calm = recorded(3, seed=1).raw[0]
    shaken = calm.specific_force.copy()
    during = slice(150, 250)  # 1.5 to 2.5 s, in the first rest
    shaken[during] += np.sin(np.arange(100))[:, np.newaxis]
    other = replace(calm, specific_force=shaken)
    assert len(found([calm])) == 4
    both = seconds(found([calm, other]), calm.stamp_ns[0])
    assert len(both) == 5
    assert both[0, 1] < 1.5
    assert both[1, 0] > 2.5


def test_imus_of_other_rates_count_alike():
    fast, slow = recorded(3, rate_hz=200.0).raw[0], recorded(3, rate_hz=50.0).raw[0]
    spans = seconds(found([fast, slow]), fast.stamp_ns[0])
    assert_allclose(spans, rests_of(recorded(3)), atol=CONFIG.window_s)


def test_a_hole_cuts_a_rest_in_two():
    stamps = STEP_NS * np.r_[np.arange(200), np.arange(300, 500)]
    # Neither part reaches into the hole, whose last and first samples are at 1.99 and 3 s.
    assert_allclose(rested(np.ones(400, bool), stamps), [[0.0, 1.99], [3.0, 4.99]], atol=1e-12)


def test_one_lost_sample_is_no_hole():
    stamps = STEP_NS * np.r_[np.arange(200), np.arange(201, 400)]
    assert_allclose(rested(np.ones(399, bool), stamps), [[0.0, 3.99]], atol=1e-12)


def test_intervals_reach_half_of_half_a_window_beyond_the_quiet_samples():
    quiet = np.zeros(500, bool)
    quiet[100:301] = True
    assert_allclose(rested(quiet), [[1.0 - 0.125, 3.0 + 0.125]], atol=1e-12)


@given(st.integers(1, 120), st.integers(1, 120))
def test_short_rests_are_left_out(first, second):
    quiet = np.r_[np.zeros(50), np.ones(first), np.zeros(50), np.ones(second), np.zeros(50)] > 0
    # A run of n quiet samples lasts n - 1 steps and reaches an eighth of a second either way.
    kept = [n for n in (first, second) if (n - 1) * 0.01 + 0.25 >= 0.8 - 1e-9]
    assert_allclose(np.ptp(rested(quiet), axis=1), [(n - 1) * 0.01 + 0.25 for n in kept])


@given(st.lists(st.booleans(), min_size=2, max_size=300), st.integers(0, 3))
def test_intervals_are_ordered_and_inside_the_recording(quiet, seed):
    steps = np.random.default_rng(seed).choice([1, 1, 1, 20], len(quiet))
    stamps = STEP_NS * np.cumsum(steps)
    spans = find_intervals(
        stamps, np.where(quiet, 1.0, 9.0), 3.0, replace(CONFIG, shortest_s=0.0, margin=0.0)
    )
    edges = np.column_stack([spans.begin_ns, spans.end_ns]).ravel()
    assert (np.diff(edges)[1::2] > 0).all()
    assert (np.diff(edges)[::2] >= 0).all()
    covered = sum(
        int(((stamps >= a) & (stamps <= b)).sum())
        for a, b in zip(spans.begin_ns, spans.end_ns, strict=True)
    )
    assert covered == sum(quiet)  # each quiet sample once, and no other


def test_a_board_that_never_rests_has_no_intervals():
    assert len(find_intervals(STEP_NS * np.arange(100), np.full(100, 50.0), 3.0)) == 0


@pytest.mark.parametrize('rate_hz', [100.0, 2000.0])  # the finer, the softer a move begins
def test_a_noiseless_recording_rests_too(rate_hz):
    silent = replace(BMI160, gyroscope=TriadErrors(), accelerometer=TriadErrors())
    spans = seconds(
        found(recorded(3, rate_hz=rate_hz, errors=silent).raw), recorded(3).raw[0].stamp_ns[0]
    )
    assert_allclose(spans, rests_of(recorded(3)), atol=CONFIG.window_s)


@pytest.mark.parametrize('step', [0.01, 0.1, 0.5])
def test_a_sensor_too_coarse_to_show_its_noise_rests_too(step):
    samples = recorded(3).raw[0]  # noise of 0.02 m/s^2
    coarse = replace(samples, specific_force=np.round(samples.specific_force / step) * step)
    spans = seconds(found([coarse]), samples.stamp_ns[0])
    assert_allclose(spans, rests_of(recorded(3)), atol=CONFIG.window_s)


def test_selected_intervals_keep_their_length():
    spans = StaticIntervals(np.array([0, 5, 9]) * NANOSECONDS, np.array([2, 8, 10]) * NANOSECONDS)
    assert spans.duration_s.tolist() == [2.0, 3.0, 1.0]
    assert spans.select(np.array([True, False, True])).duration_s.tolist() == [2.0, 1.0]
