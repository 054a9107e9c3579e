"""How old a bias is, and what its age makes of its sigma."""

from datetime import date, datetime, timedelta, timezone

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.fusion.age import bias_ages, is_dated, utc_text
from multiimu_ros.fusion.rig_model import rig_model
from multiimu_ros.rig import (
    GyroscopeTriad,
    Imu,
    Intrinsics,
    Noise,
    NOMINAL_BIAS_SIGMA,
    PerTriad,
    Rig,
    RigFrame,
    Triad,
)

SAVED_S = 1_700_000_000  # 2023-11-14T22:13:20Z
DAY_S = 86_400
WALK = 1e-6  # [rad/s^2/sqrt(Hz)]: 2.9e-4 rad/s in a day
SIGMA = 5e-5  # [rad/s]


def imu_of(bias_sigma=SIGMA, **provenance):
    figures = {'noise_density': 1e-4, 'bias_instability': 3e-5, 'bias_random_walk': WALK}
    noise = Noise(**{
        key: PerTriad(accelerometer=(value,) * 3, gyroscope=(value,) * 3)
        for key, value in figures.items()
    })  # fmt: skip
    intrinsics = Intrinsics(
        gyroscope=GyroscopeTriad(bias_sigma=(bias_sigma,) * 3),
        accelerometer=Triad(bias_sigma=(bias_sigma,) * 3),
    )
    return Imu(name='a', frame_id='a', noise=noise, intrinsics=intrinsics, provenance=provenance)


def rig_of(imu):
    return Rig(version=1, rig=RigFrame(name='test'), imus=(imu,))


def variances(imu, seconds):
    """Return the bias variance of rate and force, so long after `SAVED_S`."""
    now_ns = None if seconds is None else (SAVED_S + seconds) * NANOSECONDS
    return rig_model(rig_of(imu), now_ns).bias_variance[0, [0, 3]]


def test_a_saved_rate_bias_walks_away_with_its_age():
    imu = imu_of(biases_saved=utc_text(SAVED_S * NANOSECONDS))
    fresh, old = variances(imu, 0), variances(imu, DAY_S)
    assert_allclose(fresh, SIGMA**2 + 9e-10, rtol=1e-12)
    # A rest teaches nothing about the accelerometer's bias, so saving did not date it.
    assert_allclose(old - fresh, [WALK**2 * DAY_S, 0.0], rtol=1e-9, atol=1e-18)


def test_a_calibration_dates_both_biases_and_a_later_rest_only_the_rate():
    calibrated = utc_text((SAVED_S - DAY_S) * NANOSECONDS)
    imu = imu_of(date=calibrated, biases_last_rest=utc_text(SAVED_S * NANOSECONDS))
    assert_allclose(bias_ages(imu, (SAVED_S + 60) * NANOSECONDS), [60.0, DAY_S + 60.0])
    imu = imu_of(date=calibrated)
    assert_allclose(bias_ages(imu, SAVED_S * NANOSECONDS), [DAY_S, DAY_S])


def test_no_age_makes_a_bias_worse_than_one_that_nobody_calibrated():
    imu = imu_of(biases_saved='1970-01-01', date='1970-01-01')
    nominal = [NOMINAL_BIAS_SIGMA.gyroscope[0], NOMINAL_BIAS_SIGMA.accelerometer[0]]
    century_s = 100 * 365 * DAY_S
    # The walk of a century is 0.056: beyond the gyroscope's 0.05, not the accelerometer's 0.4.
    walked = WALK**2 * (SAVED_S + century_s)
    expected = np.array([nominal[0] ** 2, SIGMA**2 + walked]) + 9e-10
    assert_allclose(variances(imu, century_s), expected, rtol=1e-9)


def test_a_sigma_above_the_nominal_one_stays_as_it_is():
    imu = imu_of(bias_sigma=1.0, biases_saved=utc_text(SAVED_S * NANOSECONDS))
    assert_allclose(variances(imu, DAY_S), variances(imu, None), rtol=1e-15)


@pytest.mark.parametrize('provenance', [{}, {'date': 'last summer'}, {'date': 7}, {'bag': 'x'}])
def test_without_a_date_nothing_changes(provenance):
    imu = imu_of(**provenance)
    assert not is_dated(rig_of(imu))
    assert (variances(imu, 10 * DAY_S) == variances(imu, None)).all()


def test_stamps_before_the_date_make_no_bias_younger():
    imu = imu_of(biases_saved=utc_text(SAVED_S * NANOSECONDS))
    assert (variances(imu, -DAY_S) == variances(imu, 0)).all()
    assert (bias_ages(imu, 0) == 0.0).all()  # a board that counts from zero


@pytest.mark.parametrize(
    'value',
    [
        '2023-11-14T22:13:20+00:00',
        '2023-11-14T22:13:20Z',
        '2023-11-14T22:13:20',
        datetime(2023, 11, 14, 23, 13, 20, tzinfo=timezone(timedelta(hours=1))),
        datetime(2023, 11, 14, 22, 13, 20),  # what YAML makes of a bare one
    ],
)
def test_dates_are_read_however_yaml_hands_them_over(value):
    assert is_dated(rig_of(imu_of(date=value)))
    assert_allclose(bias_ages(imu_of(date=value), (SAVED_S + 5) * NANOSECONDS), 5.0)


def test_a_day_begins_at_midnight_utc():
    midnight_s = 1_699_920_000
    for value in (date(2023, 11, 14), '2023-11-14'):
        assert_allclose(bias_ages(imu_of(date=value), midnight_s * NANOSECONDS + 10**9), 1.0)


def test_an_instant_is_written_as_it_is_read():
    assert utc_text(86_400 * NANOSECONDS + 999_999_999) == '1970-01-02T00:00:00+00:00'
