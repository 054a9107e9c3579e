"""Grades at their limits, remedies by name, and figures that people can read."""

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.cleaning import clean
from multiimu_ros.rig_calibration import verdicts
from multiimu_ros.rig_calibration.recording_faults import fault_shares, looks_like_degrees
from multiimu_ros.rig_calibration.verdicts import (
    GOOD,
    LIMITS,
    REDO,
    USABLE,
    Verdict,
    why_it_failed,
    worst,
)
from multiimu_ros.rig_calibration.wording import as_text, roll_pitch_yaw
from multiimu_ros.samples import ImuSamples

IMU = SimpleNamespace(name='imu1')
PERIOD_NS = NANOSECONDS // 100


def swinging(rng, count=4000, tilt=1.0):
    """Return an IMU that swings by `tilt` [rad] about its x axis every 6 s, at 100 Hz."""
    time = np.arange(count) / 100
    omega = 2 * np.pi / 6
    angle, rate = tilt * np.sin(omega * time), tilt * omega * np.cos(omega * time)
    zero = np.zeros(count)
    force = 9.81 * np.column_stack([zero, np.sin(angle), np.cos(angle)])
    rates = np.column_stack([rate, zero, zero]) + 1e-3 * rng.standard_normal((count, 3))
    force += 0.02 * rng.standard_normal((count, 3))
    return ImuSamples(PERIOD_NS * np.arange(count), rates, force)


@pytest.mark.parametrize('quantity', LIMITS)
def test_a_grade_holds_up_to_its_limit_and_the_remedy_is_named(quantity):
    good, usable = LIMITS[quantity]
    assert good < usable
    for size, grade in (
        (good, GOOD),
        (np.nextafter(good, np.inf), USABLE),
        (usable, USABLE),
        (np.nextafter(usable, np.inf), REDO),
        (np.nan, REDO),
    ):
        judged = verdicts._graded(IMU, quantity, [0.0], [0.0, size], 'u')
        assert (judged.grade, judged.why == '') == (grade, grade == GOOD)
    assert judged.why.endswith(tuple(verdicts.REMEDIES.values()))
    assert f'good is up to {good:g}' in judged.why


@pytest.mark.parametrize(
    ('quantity', 'words'),
    [
        ('gyroscope bias', 'longer poses'),
        ('gyroscope scale', 'more smoothly'),
        ('accelerometer scale', 'longer poses'),
        ('lever arm', 'all three axes'),
        (verdicts.ROTATION, 'longer poses'),
    ],
)
def test_each_kind_of_figure_has_the_remedy_that_helps(quantity, words):
    assert words in verdicts._graded(IMU, quantity, 0.0, 1e9, 'u').why


def test_the_worst_of_no_verdicts_is_good():
    found = [Verdict('a', 'q', '', '', '', grade, '') for grade in (USABLE, REDO, GOOD)]
    assert worst(()) == GOOD
    assert worst((found[2], found[0])) == USABLE
    assert worst(tuple(found)) == REDO


@pytest.mark.parametrize(
    ('value', 'text'),
    [
        (0.001, '0.001000'),
        (0.02345678, '0.02346'),
        (-1.5, '-1.500'),
        (2584.4, '2584'),
        (99999.0, '99999'),
        (0.0, '0'),
        (3.4e-6, '3.4e-06'),
        (np.nan, 'unknown'),
    ],
)
def test_figures_have_four_digits_and_no_exponent(value, text):
    assert as_text(value) == text


def test_three_digits_are_enough_in_a_sentence():
    assert as_text([2584.4, 0.0123456], 3) == '2584 0.0123'


@pytest.mark.parametrize('angles', [(10.0, -20.0, 170.0), (0.0, 0.0, 90.0), (25.0, 90.0, 0.0)])
def test_roll_pitch_and_yaw_make_the_rotation(angles):
    R = Rotation.from_euler('ZYX', angles[::-1], degrees=True).as_matrix()
    # At 90 deg the cosine is known to some 1e-16, so the angle to 1e-8 rad.
    assert_allclose(roll_pitch_yaw(R), angles, atol=1e-6)


def test_samples_that_were_lost_one_by_one_are_missing(rng):
    samples = swinging(rng)
    kept = rng.random(len(samples)) > 0.2
    end = int(samples.stamp_ns[-1])
    share = fault_shares(clean(samples.select(kept)), 0, end)['missing samples']
    # One sample in 4000, and one at either end, are in doubt.
    assert_allclose(share, 100 * np.mean(~kept), atol=0.1)


def test_an_imu_that_fell_silent_lacks_the_rest(rng):
    samples = swinging(rng)
    early = clean(samples.select(np.arange(len(samples)) < 1000))
    share = fault_shares(early, 0, int(samples.stamp_ns[-1]))['missing samples']
    assert_allclose(share, 75.0, atol=0.1)


def test_jitter_of_the_stamps_loses_nothing(rng):
    samples = swinging(rng)
    late = samples.stamp_ns + (0.2 * PERIOD_NS * rng.standard_normal(len(samples))).astype(int)
    jittered = ImuSamples(np.sort(late), samples.angular_rate, samples.specific_force)
    shares = fault_shares(clean(jittered), int(late.min()), int(late.max()))
    good, _ = LIMITS['missing samples']
    assert shares.get('missing samples', 0.0) <= good


def test_degrees_are_told_by_gravity(rng):
    right = swinging(rng)
    degrees = ImuSamples(right.stamp_ns, np.rad2deg(right.angular_rate), right.specific_force)
    assert not looks_like_degrees(right)
    assert looks_like_degrees(degrees)
    assert not looks_like_degrees(right.select(np.arange(len(right)) < 1))


def test_turning_about_the_vertical_does_not_look_like_degrees(rng):
    flat = swinging(rng, tilt=0.0)
    fast = flat.angular_rate + np.array([0.0, 0.0, 10.0])
    assert not looks_like_degrees(ImuSamples(flat.stamp_ns, fast, flat.specific_force))


def test_a_failure_names_what_is_wrong_with_the_recording(rng):
    samples = swinging(rng)
    late = samples.select(np.arange(len(samples)) % 400 < 200)
    failed = why_it_failed('It fails; do so.', ['a', 'b'], [samples, late])
    assert failed.startswith('It fails; do so; the reason may be that `b` has 50.0 % missing')
    assert failed.endswith(f'{verdicts.REMEDIES["missing samples"]}.')
    assert why_it_failed('It fails.', ['a', 'b'], [samples, samples]) == 'It fails.'


def test_a_clock_that_runs_away_is_reported():
    fine = SimpleNamespace(jitter=1e-5, skew=5e-6, skew_sigma=1e-7)
    imu = SimpleNamespace(name='imu1', time_offset=0.001, time_offset_sigma=1e-5)
    offset, jitter, skew = verdicts._clock(imu, fine)
    assert (offset.value, offset.sigma, offset.grade) == ('1000', '10.00', GOOD)
    assert (jitter.value, jitter.grade) == ('10.00', GOOD)
    # 5 ppm of a minute are 0.3 ms.
    assert (skew.value, skew.grade, '0.30 ms a minute' in skew.why) == ('5.000', USABLE, True)


def test_faces_that_were_never_on_top_are_named(rng):
    up = rng.standard_normal((200, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    up = up[up[:, 2] > -0.5]  # the lower face stays 60 deg away
    known = np.ones(len(up), bool)
    fit = SimpleNamespace(poses=SimpleNamespace(specific_force=9.81 * up, known=known))
    fine = Verdict('imu1', verdicts.AT_REST, '1', '', 'mm/s^2', GOOD, '')
    judged = verdicts._with_missing_poses(fine, fit)
    assert (judged.grade, judged.why) == (USABLE, 'it never lay with -z up: record that, too')
