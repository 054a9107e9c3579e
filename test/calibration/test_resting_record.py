"""The longest rest of a recording: what is cut out, what is joined, what is refused."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from multiimu_ros.calibration.resting_record import gap_free, longest_run, resting_record
from multiimu_ros.errors import CalibrationError
from multiimu_ros.samples import ImuSamples

RATE = 100
PERIOD_NS = 10_000_000


def at_rest(rng, seconds, up=(0.0, 0.0, 9.81)):
    """Return samples of a quiet IMU with a bias of 0.02 rad/s."""
    count = seconds * RATE
    rate = 0.02 + 0.002 * rng.standard_normal((count, 3))
    force = np.array(up) + 0.02 * rng.standard_normal((count, 3))
    return ImuSamples(10**18 + PERIOD_NS * np.arange(count), rate, force)


def spoilt(samples, key, rows, change):
    values = {name: getattr(samples, name).copy() for name in ('angular_rate', 'specific_force')}
    values[key][rows] += change
    return ImuSamples(samples.stamp_ns, **values)


def test_a_quiet_recording_is_kept_whole(rng):
    samples = at_rest(rng, 70)
    record = resting_record(samples, 'imu0')
    assert_array_equal(record.samples.stamp_ns, samples.stamp_ns)
    assert (record.lost, round(record.duration)) == (0, 70)
    assert_allclose(record.rate_hz, RATE, rtol=1e-9)  # stamps are exact


@pytest.mark.parametrize(
    ('key', 'change'),
    [
        ('angular_rate', lambda n, rng: 0.05 * rng.standard_normal((n, 3))),  # shaken
        ('specific_force', lambda n, rng: 0.3 * rng.standard_normal((n, 3))),
        ('angular_rate', lambda n, rng: 0.05),  # turned evenly, which does not scatter
    ],
)
def test_the_rest_ends_where_motion_begins(rng, key, change):
    moving = slice(20 * RATE, 30 * RATE)
    samples = spoilt(at_rest(rng, 120), key, moving, change(10 * RATE, rng))
    record = resting_record(samples, 'imu0')
    kept = (record.samples.stamp_ns[[0, -1]] - 10**18) / 1e9
    assert_allclose(kept[0], 31.0)  # a window of a second is given away beside motion
    assert_allclose(kept[1], 120 - 1 / RATE)


def test_a_board_that_was_put_down_anew_rests_twice(rng):
    first, second = at_rest(rng, 65), at_rest(rng, 75, up=(9.81, 0.0, 0.0))
    stamps = 10**18 + PERIOD_NS * np.arange(len(first) + len(second))
    joined = ImuSamples(
        stamps,
        np.vstack([first.angular_rate, second.angular_rate]),
        np.vstack([first.specific_force, second.specific_force]),
    )
    record = resting_record(joined, 'imu0')
    assert 72.9 < record.duration < 75.1
    assert (record.samples.specific_force[:, 0] > 9).all()


def test_single_losses_are_joined_and_counted(rng):
    samples = at_rest(rng, 70)
    kept = np.ones(len(samples), bool)
    kept[100::50] = False
    record = resting_record(samples.select(kept), 'imu0')
    assert len(record.samples) == kept.sum()
    assert record.lost == (~kept).sum() - (not kept[-1])
    assert_allclose(record.rate_hz, RATE, rtol=1e-9)  # of the samples, not of what is left


def test_gaps_and_stamps_that_go_back_cut_the_record(rng):
    samples = at_rest(rng, 10)
    stamps = samples.stamp_ns.copy()
    stamps[300:] += 3 * PERIOD_NS
    stamps[800:] -= 10 * PERIOD_NS
    piece, rate_hz = gap_free(ImuSamples(stamps, samples.angular_rate, samples.specific_force))
    assert_array_equal(piece.stamp_ns, stamps[300:800])
    assert_allclose(rate_hz, RATE, rtol=1e-9)


def test_readings_that_were_sent_twice_count_once(rng):
    samples = at_rest(rng, 10)
    twice = samples.select(np.repeat(np.arange(len(samples)), 2))
    piece, rate_hz = gap_free(twice)
    assert_array_equal(piece.angular_rate, samples.angular_rate)
    assert_allclose(rate_hz, RATE, rtol=1e-9)


def test_runs():
    assert longest_run(np.array([1, 0, 1, 1, 0, 1], bool)) == (2, 4)
    assert longest_run(np.zeros(3, bool)) == (0, 0)


def shaken(rng):
    return spoilt(at_rest(rng, 90), 'angular_rate', slice(None), rng.standard_normal((9000, 3)))


def vibrating(rng):
    return spoilt(at_rest(rng, 90), 'specific_force', slice(None), rng.standard_normal((9000, 3)))


@pytest.mark.parametrize(
    ('recording', 'complaint'),
    [
        (lambda rng: at_rest(rng, 30), '`imu7` must lie still .* 60 s, but rests for 30 s'),
        (shaken, 'but never rests; record 10 min'),
        (vibrating, 'but never rests'),
        (lambda rng: at_rest(rng, 2), 'but never rests'),
        (lambda rng: at_rest(rng, 70).select(slice(1)), 'must have samples, got 1'),
        (
            lambda rng: spoilt(at_rest(rng, 70), 'specific_force', slice(5, 8), np.nan),
            'must have finite readings, got 3 that are not',
        ),
        (
            lambda rng: ImuSamples(np.full(200, 5), *rng.standard_normal((2, 200, 3))),
            'but never rests',
        ),
    ],
)
def test_what_cannot_tell_noise_is_refused_in_a_sentence(rng, recording, complaint):
    with pytest.raises(CalibrationError, match=complaint):
        resting_record(recording(rng), 'imu7')
