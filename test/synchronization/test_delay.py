"""Delays: exact without errors, honest with them, and refused where there is none to find."""

from dataclasses import replace
from functools import cache

from hypothesis import given, settings, strategies as st
import kth
import numpy as np
from numpy.testing import assert_allclose
import pytest
from realdata import data_set
from scipy.interpolate import CubicSpline
from scipy.signal import correlate
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.errors import SyncError
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import calibration_path
from multiimu_ros.synchronization.delay import fit_time_map
from multiimu_ros.synchronization.rate_track import correlate_tracks, onset_delay, RateTrack

DELAY = 0.0123  # [s] by which the second clock is behind
RATE = 100.0  # [Hz]
NOISE = 0.002  # [rad/s] of a sample: a BMI160 at 200 Hz
LIMIT = np.deg2rad(1998.0)  # [rad/s] where the KTH gyroscopes end


def turning(seed, seconds=60.0):
    """Return a smooth random rate of turn, 1 rad/s rms and a second or so from turn to turn."""
    rng = np.random.default_rng(seed)
    knots = np.arange(-2.0, seconds + 2.0, 0.25)
    return CubicSpline(knots, rng.standard_normal((len(knots), 3)))


def pair(seed, *, delay=DELAY, skew=0.0, noise=NOISE, jitter=0.0, seconds=60.0):
    """Return what two gyroscopes on one body record; the second is read 0.4 ms later."""
    rng, path = np.random.default_rng([seed, 1]), turning(seed, seconds)
    mixing = Rotation.random(random_state=seed).as_matrix() * (1 + 0.01 * rng.standard_normal(3))
    time = np.arange(0.0, seconds, 1 / RATE)
    later = time + 0.0004
    a = path(time) + noise * rng.standard_normal((len(time), 3))
    b = path(later) @ mixing.T + 0.01 + noise * rng.standard_normal((len(time), 3))
    # first = t + delay + skew (t - middle), so the second clock says t = ...
    stamp = seconds / 2 + (later - seconds / 2 - delay) / (1 + skew)
    stamp = stamp + jitter * rng.standard_normal(len(time))
    return RateTrack(time, a), RateTrack(np.sort(stamp), b)


def deviations(seeds, **keys):
    """Return errors of the delay and what they are in units of the stated sigma."""
    maps = [fit_time_map(*pair(seed, **keys)) for seed in seeds]
    errors = np.array([found.delay - keys.get('delay', DELAY) for found in maps])
    return errors, errors / [found.delay_sigma for found in maps]


def assert_standard_normal(z):
    """Check the mean square of `z`, too large or too small, at the level of 1e-3 either way."""
    low, high = chi2(np.size(z)).ppf([1e-3, 1 - 1e-3])
    assert low < np.sum(np.square(z)) < high


def masked(track, bad):
    return RateTrack(track.time, np.where(bad[:, np.newaxis], np.nan, track.rate))


@cache
def carried(seed, g_sensitivity):
    """Return the rate tracks of three BMI160s waved about for a minute, 2 ms apart in time."""
    base = ring(3)
    late = [imu.model_copy(update={'time_offset': 0.002 * k}) for k, imu in enumerate(base.imus)]
    path = calibration_path(10, np.random.default_rng(seed), waving=60)
    errors = BMI160 if g_sensitivity else replace(BMI160, g_sensitivity_sigma=0.0)
    true = base.model_copy(update={'imus': tuple(late)})
    raw = simulate(true, Trajectory(path, 140.0), 200.0, errors, seed=seed).raw
    leak = BMI160.g_sensitivity_sigma * np.ones((3, 3))
    return [
        RateTrack(
            (track.stamp_ns - raw[0].stamp_ns[0]) / NANOSECONDS,
            track.angular_rate,
            track.specific_force,
            leak if g_sensitivity else None,
        )
        for track in raw
    ]


def errors_and_z(seeds, g_sensitivity):
    """Return errors [s] and errors over sigma of the delays in the recordings of some seeds."""
    errors, z = [], []
    for seed in seeds:
        tracks = carried(seed, g_sensitivity)
        for k in (1, 2):
            found = fit_time_map(tracks[0], tracks[k])
            errors.append(found.delay - 0.002 * k)
            z.append(errors[-1] / found.delay_sigma)
    return np.array(errors), np.array(z)


@pytest.mark.parametrize('delay', [0.0, DELAY, -0.3, 2.7])
def test_perfect_streams_give_the_delay_to_the_nanosecond_and_no_skew(delay):
    found = fit_time_map(*pair(3, delay=delay, noise=0.0))
    # What is left is the splines' error at 100 Hz, of the order 1e-9 s: asked for is 10 ns.
    assert abs(found.delay - delay) < 10e-9
    assert abs(found.skew) < 1e-9
    assert found.jitter < 1e-6


@given(seed=st.integers(0, 10**6), offset=st.sampled_from([0.0, 1e3, -1e6, 1e6]))
@settings(max_examples=8)
def test_clocks_may_be_any_time_apart(seed, offset):
    first, second = pair(seed, seconds=20.0)
    moved = RateTrack(second.time - offset, second.rate)
    expected = fit_time_map(first, second)
    found = fit_time_map(first, moved)
    assert abs(expected.delay - DELAY) < 6 * expected.delay_sigma
    # Float seconds of 1e6 have steps of 0.1 ns; the fit stops at 0.01 sigma of a step.
    assert abs(found.delay - offset - expected.delay) < 0.1 * expected.delay_sigma + 1e-9


@pytest.mark.long
def test_stated_sigmas_are_those_of_the_errors():
    errors, z = deviations(range(60))
    assert np.abs(errors).max() < 20e-6
    assert_standard_normal(z)
    # 60 times 95 %: binomial, below 50 once in a thousand.
    assert np.sum(np.abs(z) < 1.96) >= 50


@pytest.mark.long
def test_stamps_that_jitter_by_a_millisecond_cost_tens_of_microseconds():
    errors, z = deviations(range(40), jitter=0.001)
    # 1 ms over the root of 6000 samples is 13 us; where nothing turns they tell little.
    assert np.sqrt(np.mean(errors**2)) < 30e-6
    assert_standard_normal(z)
    found = fit_time_map(*pair(0, jitter=0.001))
    # The kernel averages over 4.4 samples, 1/sqrt(4.4) = 0.48, and is wider than some turns.
    assert 0.2e-3 < found.jitter < 0.6e-3
    assert fit_time_map(*pair(0)).jitter < 0.1e-3


@pytest.mark.long
def test_a_bmi160_without_g_sensitivity_is_aligned_within_three_microseconds():
    errors, z = errors_and_z(range(5), g_sensitivity=False)
    assert np.abs(errors).max() < 3e-6
    assert_standard_normal(z)


@pytest.mark.long
def test_an_unknown_g_sensitivity_is_in_the_sigma():
    errors, z = errors_and_z(range(5), g_sensitivity=True)
    assert np.abs(errors).max() > 5e-6  # it does matter
    assert np.abs(errors).max() < 60e-6
    assert np.abs(z).max() < 3.5  # ten draws: one in two hundred
    tracks = [replace(track, leak_sigma=None) for track in carried(1, True)]
    assert abs(fit_time_map(tracks[0], tracks[1]).delay_sigma) < 3e-6  # and would be missing


@pytest.mark.parametrize('skew', [50e-6, -200e-6])
def test_a_skew_is_recovered_over_the_whole_recording(skew):
    errors = []
    for seed in range(4):
        first, second = pair(seed, skew=skew, seconds=120.0)
        found = fit_time_map(first, second)
        assert abs(found.skew - skew) < 5 * found.skew_sigma
        errors.append(found.apply(second.time) - first.time - 0.0004)
    # 3 us in the middle and 0.1 ppm over a minute from there, five times.
    assert np.abs(errors).max() < 5 * np.hypot(3e-6, 6e-6)


def test_clocks_of_one_rate_get_no_skew():
    assert [fit_time_map(*pair(seed)).skew for seed in range(30)] == [0.0] * 30


def test_holes_and_clipped_samples_do_no_harm():
    first, second = pair(7)
    bad = np.zeros(len(first.time), bool)
    bad[1000:1600] = True
    hole = (second.time < 30.0) | (second.time > 37.0)
    holed = RateTrack(second.time[hole], second.rate[hole])
    found = fit_time_map(masked(first, bad), holed)
    assert abs(found.delay - DELAY) < 4 * found.delay_sigma
    whole = fit_time_map(first, second)
    assert whole.delay_sigma < found.delay_sigma < 1.5 * whole.delay_sigma  # 13 of 60 s are gone
    spikes = second.rate.copy()
    spikes[::500] = 3.0  # a dozen wrong readings
    wild = fit_time_map(first, RateTrack(second.time, spikes))
    assert abs(wild.delay - DELAY) < 4 * wild.delay_sigma < 40e-6


def unnormalised_delay(first, second):
    """Return the peak of the plain sum of |w_a| |w_b| over lags, by a parabola."""
    a, b = (np.linalg.norm(track.rate, axis=1) for track in (first, second))
    values = correlate(a, b, mode='full')
    k = int(np.argmax(values))
    before, here, after = values[k - 1 : k + 2]
    fraction = 0.5 * (before - after) / (before - 2 * here + after)
    return (k + fraction - (len(b) - 1)) / RATE + first.time[0] - second.time[0]


def test_correlation_that_is_not_normalised_by_the_overlap_is_biased():
    pairs = [pair(seed, delay=1.5, seconds=30.0) for seed in range(60)]
    ours = np.array([correlate_tracks(*tracks).offset for tracks in pairs]) - 1.5
    naive = np.array([unnormalised_delay(*tracks) for tracks in pairs]) - 1.5
    # |w| has a mean of 1.6 rad/s: the sum grows with the overlap, and the peak leans to it.
    assert naive.mean() < -0.1e-3
    assert naive.mean() < -8 * naive.std() / np.sqrt(60)
    assert abs(ours.mean()) < 3 * ours.std() / np.sqrt(60)
    assert abs(ours.mean()) < 0.5 * abs(naive.mean())


def test_a_long_hole_takes_no_part_in_the_correlation():
    first, second = pair(4)
    heard = (second.time < 12.0) | (second.time > 42.0)
    found = fit_time_map(first, RateTrack(second.time[heard], second.rate[heard]))
    assert found.correlation > 0.95  # as without the hole; a line across it would leave 0.7
    assert abs(found.delay - DELAY) < 4 * found.delay_sigma


def test_the_correlation_of_an_overlap_is_pearsons():
    first, second = pair(2, delay=0.0, seconds=10.0)
    found = correlate_tracks(first, second)
    a, b = (np.linalg.norm(t.rate - np.median(t.rate, axis=0), axis=1) for t in (first, second))
    a, b = a[:-1], b[:-1]  # the grid ends before the last sample
    for shift in (0, 7, 150):
        expected = np.corrcoef(a[shift:], b[: len(b) - shift])[0, 1]
        k = np.argmin(np.abs(found.lags - (shift / RATE + first.time[0] - second.time[0])))
        # One end of the grid may round away: one of 1000 samples.
        assert_allclose(found.values[k], expected, rtol=0, atol=1e-3)


def test_two_bodies_are_refused_with_a_reason():
    first, _ = pair(1)
    _, other = pair(2)
    with pytest.raises(SyncError, match='are both IMUs on one rigid body, and was it turned'):
        fit_time_map(first, other)


def test_a_body_that_rests_is_refused_with_a_reason(rng):
    time = np.arange(0.0, 30.0, 1 / RATE)
    rest = [RateTrack(time, NOISE * rng.standard_normal((len(time), 3))) for _ in range(2)]
    with pytest.raises(SyncError, match='was it turned'):
        fit_time_map(*rest)


def test_short_tracks_are_refused_with_a_reason():
    with pytest.raises(SyncError, match='must overlap by 5 s to be aligned; record longer'):
        fit_time_map(*pair(1, seconds=3.0))
    first, second = pair(1, seconds=20.0)
    unheard = masked(second, np.ones(len(second.time), bool))
    with pytest.raises(SyncError, match='record longer'):
        fit_time_map(first, unheard)


def resting_first(seed, delay):
    """Return two tracks that rest for 3 s and then turn about x like a motor."""
    rng = np.random.default_rng(seed)
    time = np.arange(0.0, 6.0, 1 / RATE)
    tracks = []
    for late in (0.0, 0.004):
        rate = np.zeros((len(time), 3))
        rate[:, 0] = 8.0 * (time + late - 3.0).clip(0.0)
        rate += NOISE * rng.standard_normal(rate.shape) + 0.02 * rng.standard_normal(3)
        tracks.append(RateTrack(time + late - (delay if late else 0.0), rate))
    return tracks


@pytest.mark.parametrize('delay', [0.0, 0.037, -1.2])
def test_onsets_agree_within_two_samples(delay):
    found = [onset_delay(*resting_first(seed, delay)) for seed in range(10)]
    assert np.abs(np.array(found) - delay).max() < 2 / RATE


def test_without_a_rest_or_a_motion_there_is_no_onset():
    first, second = resting_first(0, 0.0)
    still = RateTrack(first.time[:250], first.rate[:250])
    with pytest.raises(SyncError, match='must rest for a second and then be turned'):
        onset_delay(still, second)


@pytest.mark.realdata
def test_a_phone_and_a_microcontroller_agree_with_the_published_offset():
    phone, mcu = (
        RateTrack(values[:, 0], values[:, 1:])
        for values in (
            np.loadtxt(data_set('twistnsync') / f'{name}_gyro_data.csv', delimiter=',', skiprows=1)
            for name in ('smartphone', 'mcu')
        )
    )
    found = fit_time_map(phone, mcu)
    # The authors' offset, and that of an affine least-squares fit; see the recordings' README.
    for published in (947848.6384083, 947848.6382536):
        assert abs(found.delay - published) < 0.5e-3


@pytest.mark.realdata
@pytest.mark.parametrize('name', ['exp_3', 'exp_4'])
def test_eight_imus_read_at_once_show_no_delay_and_injected_ones_are_found(name):
    samples = kth.load(name)
    tracks = [
        RateTrack(
            (track.stamp_ns - track.stamp_ns[0]) / NANOSECONDS,
            np.where((np.abs(track.angular_rate) < LIMIT).all(axis=1)[:, None],
                     track.angular_rate, np.nan),
        )
        for track in samples
    ]  # fmt: skip
    for k in (1, 4, 7):
        found = fit_time_map(tracks[0], tracks[k])
        assert found.skew == 0.0
        assert abs(found.delay) < 30e-6
        time = tracks[k].time
        moved = time + 0.001 * (k + 1) + 50e-6 * time
        injected = fit_time_map(tracks[0], RateTrack(moved, tracks[k].rate))
        assert np.abs(injected.apply(moved) - time).max() < 100e-6
