"""The Allan deviation against the published formula, allantools, and its own promises."""

import allantools
from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from multiimu_ros.calibration.allan import allan_curve, averaging_factors

N = 2000


def published(series, m):
    """Half the mean square of differences of neighbouring averages (NIST SP 1065, eq. 11)."""
    average = np.array([series[i : i + m].mean() for i in range(len(series) - m + 1)])
    differences = average[m:] - average[:-m]
    return np.sqrt(0.5 * np.mean(differences**2)), len(differences)


def test_deviation_is_the_published_formula_with_its_half(rng):
    values = rng.standard_normal((N, 3)) + np.array([0.0, 0.0, 9.81])
    curve = allan_curve(values, 50.0)
    for row, m in enumerate(curve.factor):
        for axis in range(3):
            deviation, count = published(values[:, axis], m)
            # Two ways of summing 2000 numbers: only rounding may differ.
            assert_allclose(curve.deviation[row, axis], deviation, rtol=1e-11)
            assert curve.averages[row] == count


def test_white_noise_of_one_sample_has_its_own_deviation(rng):
    # Without the factor 1/2 it would be sqrt(2); its sigma is 0.5 % (edf 2/3 of 40 000 a axis).
    assert_allclose(allan_curve(rng.standard_normal((40000, 3)), 1.0).deviation[0], 1, rtol=0.02)


@pytest.mark.parametrize('rate_hz', [1.0, 200.0, 62.5])
def test_deviation_agrees_with_allantools(rng, rate_hz):
    walk = np.cumsum(rng.standard_normal((5000, 3)), axis=0) + 3 * rng.standard_normal((5000, 3))
    curve = allan_curve(walk, rate_hz)
    for axis in range(3):
        tau, deviation, _, count = allantools.oadev(
            walk[:, axis], rate_hz, 'freq', curve.factor / rate_hz
        )
        assert_allclose(curve.deviation[:, axis], deviation, rtol=1e-12)
        assert_allclose(curve.tau, tau, rtol=1e-12)
        assert_array_equal(curve.averages, count)


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(0.01, 100), offset=st.floats(-50, 50))
def test_scale_goes_through_and_offset_drops_out(seed, scale, offset):
    values = np.random.default_rng(seed).standard_normal((200, 3))
    expected = scale * allan_curve(values, 1.0).deviation[:, ::-1]
    got = allan_curve(scale * values[:, ::-1] + offset, 1.0).deviation
    # The offset, up to 5000 times the noise, takes four digits of sixteen; long means two more.
    assert_allclose(got, expected, rtol=1e-9)


def test_averaging_times_are_two_an_octave_up_to_an_eighth():
    assert averaging_factors(128).tolist() == [1, 2, 3, 4, 6, 8, 11, 16]
    factors = averaging_factors(120000)
    assert 120000 / 8 / np.sqrt(2) < factors[-1] <= 120000 / 8
    # 2, 3 and 4 are rounded; from there on each is within 7 % of sqrt(2) times the last.
    assert_allclose(factors[5:] / factors[4:-1], np.sqrt(2), rtol=0.07)


@pytest.mark.parametrize(
    ('spoil', 'complaint'),
    [
        (lambda v: v[:63], 'at least 64 samples, got 63'),
        (lambda v: np.where(v == v[7, 1], np.nan, v), 'must be finite, got 1 samples'),
        (lambda v: v * [1, 0, 1], 'constant y axis'),
        (lambda v: v[:, :2], r'shape \(N, 3\)'),
    ],
)
def test_bad_input_is_named_in_the_message(rng, spoil, complaint):
    with pytest.raises(ValueError, match=complaint):
        allan_curve(spoil(rng.standard_normal((200, 3))), 1.0)
