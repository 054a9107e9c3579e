"""The measured benefit: what the noises are at rest, and nothing of the motion."""

from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from multiimu_ros.fusion import benefit as bf
from multiimu_ros.fusion.federated import information_shares

SIGMA = np.repeat([1.7e-3, 0.025], 3)
UNIT = np.array([1.7e-3, 0.025])  # of the two triads
SCANS = 1500
# Of a standard deviation from three axes whose squares repeat themselves by 35/18.
ERROR = np.sqrt(35 / 18 / (2 * 3 * SCANS))


def readings_of(rng, factors, scans=SCANS):
    """Noises (N, K, 6) of IMUs `factors` (K,) times as noisy as a good one, at rest."""
    noise = np.array(factors)[:, None] * SIGMA * rng.standard_normal((scans, len(factors), 6))
    return noise + np.array([0.01, 0.0, -0.02, 0.0, 0.0, 9.81])


def meter_of(readings, weights, still=None):
    """Push readings and their weighted means (N, 6) through a meter."""
    meter = bf.BenefitMeter(readings.shape[1])
    fused = np.einsum('nka,ka->na', np.nan_to_num(readings), weights)
    for n, z in enumerate(readings):
        meter.push(z, fused[n], still=True if still is None else bool(still[n]))
    return meter


def variances(factors):
    return np.square(np.outer(factors, SIGMA))


def test_four_like_imus_are_twice_as_quiet_as_one(rng):
    R = variances([1.0] * 4)
    found = meter_of(readings_of(rng, [1.0] * 4), np.full((4, 6), 0.25)).benefit(R)
    assert_allclose(found.fused_noise / UNIT, 0.5, rtol=4 * ERROR)
    assert_allclose(found.mean_single / UNIT, 1.0, rtol=4 * ERROR / 2)
    assert_allclose(found.best_single / UNIT, 1.0, rtol=4 * ERROR)
    assert_allclose(found.ideal / UNIT, 0.5, rtol=1e-12)


def test_weights_reach_the_ideal_of_unlike_imus_and_averaging_does_not(rng):
    factors = [1.0, 1.0, 2.45]
    readings, R = readings_of(rng, factors), variances(factors)
    weighted = meter_of(readings, information_shares(R)).benefit(R)
    averaged = meter_of(readings, np.full((3, 6), 1 / 3)).benefit(R)
    assert_allclose(weighted.ideal / UNIT, np.sqrt(1 / (2 + 1 / 2.45**2)), rtol=1e-12)
    assert_allclose(weighted.fused_noise / weighted.ideal, 1.0, rtol=4 * ERROR)
    assert_allclose(averaged.fused_noise / UNIT, np.sqrt(2 + 2.45**2) / 3, rtol=4 * ERROR)
    assert_allclose(weighted.best_single / UNIT, 1.0, rtol=4 * ERROR)
    assert_allclose(weighted.mean_single / UNIT, (2 + 2.45) / 3, rtol=4 * ERROR)


@pytest.mark.compiled
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_motion_is_not_measured(seed):
    rng = np.random.default_rng(seed)
    readings, weights = readings_of(rng, [1.0] * 3, 900), np.full((3, 6), 1 / 3)
    begin, end = np.sort(rng.integers(250, 650, 2))
    still = np.ones(900, dtype=bool)
    still[begin:end] = False
    moved = readings.copy()
    moved[begin:end] += rng.normal(0.0, 10.0, (end - begin, 1, 6))
    R = variances([1.0] * 3)
    # Not a bit of what was read in motion may be left, also in the scans next to it.
    assert_array_equal(
        meter_of(moved, weights, still).benefit(R), meter_of(readings, weights, still).benefit(R)
    )


def test_what_was_found_keeps_in_motion(rng):
    readings, weights = readings_of(rng, [1.0] * 3, 600), np.full((3, 6), 1 / 3)
    R, rest = variances([1.0] * 3), np.arange(600) < 400
    assert_array_equal(
        meter_of(readings, weights, rest).benefit(R),
        meter_of(readings[:400], weights).benefit(R),
    )


def test_nothing_is_said_before_it_is_known(rng):
    # 6 scans fill the ring, 200 are the least; a fading memory counts 206 as 200.8.
    readings, weights = readings_of(rng, [1.0] * 3, 212), np.full((3, 6), 1 / 3)
    known = np.full((3, 6), np.nan)
    early = meter_of(readings[:205], weights).benefit(known)
    assert np.isnan(early).all()
    late = meter_of(readings, weights).benefit(known)
    assert np.isfinite(late[:3]).all()
    assert np.isnan(late.ideal).all()


def test_an_imu_that_is_silent_does_not_count(rng):
    readings, R = readings_of(rng, [1.0, 1.0, 0.1], 600), variances([1.0, 1.0, np.nan])
    readings[:, 2] = np.nan
    found = meter_of(readings, np.array([[0.5], [0.5], [0.0]]) * np.ones(6)).benefit(R)
    assert_allclose(found.ideal / UNIT, np.sqrt(0.5), rtol=1e-12)
    # ERROR is of 1500 scans, these are 600, and two IMUs are averaged.
    assert_allclose(found.mean_single / UNIT, 1.0, rtol=4 * ERROR * np.sqrt(2.5 / 2))


def test_a_noise_that_the_imus_share_is_no_benefit(rng):
    readings = readings_of(rng, [1.0] * 4) + SIGMA * rng.standard_normal((SCANS, 1, 6))
    found = meter_of(readings, np.full((4, 6), 0.25)).benefit(variances([np.sqrt(2.0)] * 4))
    # 1 + 1/4 is left of 1 + 1; independent noises of that size would leave half a unit.
    assert_allclose(found.fused_noise / UNIT, np.sqrt(1.25), rtol=4 * ERROR)
    assert_allclose(found.ideal / UNIT, np.sqrt(0.5), rtol=1e-12)


def test_spikes_are_no_noise(rng):
    readings = readings_of(rng, [1.0] * 4)
    readings[300::500, 0] += 1.0  # three
    found = meter_of(readings, np.full((4, 6), 0.25)).benefit(variances([1.0] * 4))
    # Each counts 3 x 15 squares more of 1500: 9 % of the variance; uncut it were 200 %, and more.
    assert_allclose(found.fused_noise / UNIT, 0.5 * np.sqrt(1.09), rtol=4 * ERROR)


def test_a_rest_that_has_no_noise_is_measured_as_such():
    readings = np.ones((300, 3, 6))
    found = meter_of(readings, np.full((3, 6), 1 / 3)).benefit(variances([1.0] * 3))
    # Three thirds are 1 but for rounding.
    assert_allclose(found[:3], 0.0, atol=1e-15)
    assert found.ideal == pytest.approx(UNIT / np.sqrt(3))
