"""Poses are the means of their samples, with the noise that they really have."""

from dataclasses import replace

from calibration_runs import recorded
from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.poses import find_transitions, read_poses
from multiimu_ros.calibration.static_intervals import board_ratio, find_intervals, StaticIntervals
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.errors import BMI160, draw_noise, TriadErrors

RATE_HZ = 100.0
# Nothing but white noise, of a BMI160's density.
WHITE = {
    name: TriadErrors(noise_density=getattr(BMI160, name).noise_density)
    for name in ('gyroscope', 'accelerometer')
}


def spans(*seconds):
    begin, end = (np.array(seconds) * NANOSECONDS).astype(np.int64).T
    return StaticIntervals(begin, end)


def at_rest(rate, force=None):
    """Return samples at 100 Hz from 0 on."""
    stamp_ns = 10_000_000 * np.arange(len(rate))
    return ImuSamples(stamp_ns, rate, rate if force is None else force)


@pytest.fixture(scope='module')
def samples():
    """Return 9 poses with white noise only."""
    return recorded(8, errors=replace(BMI160, **WHITE)).raw[0]


@pytest.fixture(scope='module')
def intervals(samples):
    return find_intervals(*board_ratio([samples]), 3.0)


def test_a_pose_is_the_mean_of_its_samples(samples, intervals):
    poses = read_poses(samples, intervals)
    assert len(poses) == 9
    for k, (begin, end) in enumerate(zip(intervals.begin_ns, intervals.end_ns, strict=True)):
        inside = samples.select((samples.stamp_ns >= begin) & (samples.stamp_ns <= end))
        # Summed in the same order: rounding only.
        assert_allclose(poses.angular_rate[k], inside.angular_rate.mean(axis=0), rtol=1e-12)
        assert_allclose(poses.specific_force[k], inside.specific_force.mean(axis=0), rtol=1e-12)
        middle = begin - samples.stamp_ns[0] + (end - begin) / 2
        assert poses.time[k] == pytest.approx(middle / NANOSECONDS, rel=1e-12)
        assert poses.duration[k] == pytest.approx(len(inside) / RATE_HZ, rel=1e-9)


def test_the_density_is_that_of_the_white_noise(samples, intervals):
    poses = read_poses(samples, intervals)
    # 9 poses of 15 blocks: 126 steps of correlation -1/2 on three axes, 9 % and 5 % of variance,
    # hence 5 % of an axis' density; and 3 standard errors.
    assert_allclose(poses.rate_density, WHITE['gyroscope'].noise_density, rtol=0.22)
    assert_allclose(poses.force_density, WHITE['accelerometer'].noise_density, rtol=0.22)
    both = np.r_[
        poses.rate_density / WHITE['gyroscope'].noise_density,
        poses.force_density / WHITE['accelerometer'].noise_density,
    ]
    assert both.mean() == pytest.approx(1.0, abs=0.08)


def test_slow_drift_is_not_taken_for_noise(rng):
    noise = draw_noise(20_000, RATE_HZ, TriadErrors(noise_density=1.0), rng)
    drift = np.linspace(0.0, 100.0, 20_000)[:, np.newaxis]  # 1000 sigma of the mean of 100 s
    whole = spans((0.0, 199.99))
    # 1000 blocks: 4 % of the density. The drift adds (0.5 per s 0.2 s)^2 / 2 of 1 / (0.2 s).
    assert_allclose(read_poses(at_rest(noise + drift), whole).rate_density, 1.0, rtol=0.1)


def test_a_filtered_noise_counts_with_its_low_frequencies(rng):
    noise = draw_noise(20_004, RATE_HZ, TriadErrors(noise_density=1.0), rng)
    smooth = np.stack([np.convolve(axis, np.ones(5) / 5, 'valid') for axis in noise.T], axis=1)
    density = read_poses(at_rest(smooth), spans((0.0, 199.99))).rate_density
    # A mean of 5 in blocks of 20 takes off (5^2 - 1) / (2 5 20) = 12 % of the density's square.
    assert_allclose(density, 0.95, rtol=0.1)
    assert smooth.std() / np.sqrt(RATE_HZ) < 0.5  # what the scatter of samples would say


def test_a_pose_that_was_not_heard_is_nan(samples, intervals):
    begin, end = intervals.begin_ns[3], intervals.end_ns[3]
    third = (end - begin) // 3
    lost = (samples.stamp_ns > begin) & (samples.stamp_ns < end)
    assert not read_poses(samples.select(~lost), intervals).known[3]
    # A third is still too little, two thirds are enough.
    little = lost & (samples.stamp_ns > begin + third)
    enough = lost & (samples.stamp_ns > begin + 2 * third)
    assert not read_poses(samples.select(~little), intervals).known[3]
    poses = read_poses(samples.select(~enough), intervals)
    assert poses.known.all()
    unheard = read_poses(samples.select(~lost), intervals)
    assert np.isnan(unheard.angular_rate[3]).all()
    assert unheard.known.sum() == 8
    assert unheard.select(unheard.known).known.all()
    assert np.isfinite(unheard.force_density).all()


def test_poses_too_short_for_a_step_have_a_mean_and_no_density(rng):
    samples = at_rest(rng.standard_normal((500, 3)))
    poses = read_poses(samples, spans((1.0, 1.02), (2.0, 2.1)))
    assert_allclose(poses.angular_rate[0], samples.angular_rate[100:103].mean(axis=0))
    assert np.isnan(poses.rate_density).all()


def test_a_noiseless_pose_has_a_density_above_zero():
    poses = read_poses(at_rest(np.ones((500, 3))), spans((0.0, 4.99)))
    assert (poses.rate_density > 0).all()


@given(st.floats(1e-4, 1e4), st.floats(-100, 100))
def test_means_and_densities_go_with_the_units(scale, offset):
    noise = np.random.default_rng(3).standard_normal((500, 3))
    one = read_poses(at_rest(noise), spans((0.0, 2.0), (3.0, 4.9)))
    other = read_poses(at_rest(scale * (noise + offset)), spans((0.0, 2.0), (3.0, 4.9)))
    # Rounding at an offset of 100.
    assert_allclose(other.angular_rate, scale * (one.angular_rate + offset), atol=1e-10 * scale)
    assert_allclose(other.rate_density, scale * one.rate_density, rtol=1e-9)


def moves(samples, intervals, usable=None, known=None):
    everything = np.ones(len(samples), bool)
    heard = np.ones(len(intervals), bool)
    return find_transitions(
        samples, intervals, everything if usable is None else usable, heard if known is None
        else known
    )  # fmt: skip


def test_a_move_joins_the_rests_at_either_end(samples, intervals):
    found = moves(samples, intervals)
    assert [(m.start, m.stop) for m in found] == [(k, k + 1) for k in range(8)]
    for move in found:
        first, last = samples.stamp_ns[move.begin], samples.stamp_ns[move.end - 1]
        # From the last sample of a rest to the first of the next, which are at most a step off.
        assert 0 <= intervals.end_ns[move.start] - first < NANOSECONDS / RATE_HZ
        assert 0 <= last - intervals.begin_ns[move.stop] < NANOSECONDS / RATE_HZ


def test_no_move_goes_across_a_gap(samples, intervals):
    middle = (intervals.end_ns[2] + intervals.begin_ns[3]) // 2
    lost = np.abs(samples.stamp_ns - middle) < 0.05 * NANOSECONDS
    starts = [move.start for move in moves(samples.select(~lost), intervals)]
    assert starts == [0, 1, 3, 4, 5, 6, 7]


def test_one_lost_sample_is_no_gap(samples, intervals):
    kept = np.ones(len(samples), bool)
    kept[int(moves(samples, intervals)[2].begin) + 100] = False
    assert len(moves(samples.select(kept), intervals)) == 8


@pytest.mark.parametrize('where', ['begin', 'inside', 'end'])
def test_no_move_has_a_saturated_sample(samples, intervals, where):
    move = moves(samples, intervals)[4]
    usable = np.ones(len(samples), bool)
    usable[{'begin': move.begin, 'inside': move.begin + 50, 'end': move.end - 1}[where]] = False
    starts = [m.start for m in moves(samples, intervals, usable)]
    assert starts == [0, 1, 2, 3, 5, 6, 7]


def test_saturation_and_gaps_in_a_rest_break_no_move(samples, intervals):
    begin = np.searchsorted(samples.stamp_ns, intervals.end_ns[4]) - 25  # just before a move
    usable = np.ones(len(samples), bool)
    usable[begin] = False
    assert len(moves(samples, intervals, usable)) == 8
    kept = np.ones(len(samples), bool)
    kept[begin : begin + 20] = False
    assert len(moves(samples.select(kept), intervals)) == 8


def test_a_pose_that_is_left_out_joins_two_moves(samples, intervals):
    known = np.ones(len(intervals), bool)
    known[4] = False
    pairs = [(m.start, m.stop) for m in moves(samples, intervals, known=known)]
    assert (3, 5) in pairs
    assert len(pairs) == 7
