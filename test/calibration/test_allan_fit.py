"""The five terms: their definition, what their confidences are worth, and what stays unknown."""

from functools import cache

from noise_series import five_terms
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.signal import lfilter

from multiimu_ros.calibration.allan import allan_curve
from multiimu_ros.calibration.allan_fit import deviation_band, fit_allan, shapes, term_of, TERMS
from multiimu_ros.simulation.errors import BMI160, draw_noise

RATE = 200.0
TEN_MINUTES = 120000
TRUTH = {'Q': 20.0, 'N': 1.0, 'B': 0.15, 'K': 0.008, 'R': 3e-4}  # each leads somewhere, or nearly
COUNT, SEEDS = 131072, 40


@cache
def fits(seeds=SEEDS):
    """Return the fits of three axes of each seed's record at 1 Hz."""
    result = []
    for seed in range(seeds):
        values = five_terms(COUNT, 1.0, **TRUTH, rng=np.random.default_rng(seed))
        curve = allan_curve(values, 1.0)
        result += [fit_allan(curve, axis) for axis in range(3)]
    return result


@cache
def bmi160(seeds=20):
    """Return the fits of ten minutes of BMI160 noise, triad by triad."""
    result = {}
    for triad in ('gyroscope', 'accelerometer'):
        result[triad] = []
        for seed in range(seeds):
            rng = np.random.default_rng(seed)
            values = draw_noise(TEN_MINUTES, RATE, getattr(BMI160, triad), rng)
            curve = allan_curve(values, RATE)
            result[triad] += [fit_allan(curve, axis) for axis in range(3)]
    return result


def test_terms_have_the_slopes_and_heights_of_the_standard():
    tau = np.array([0.25, 3.0, 100.0])
    # IEEE Std 952-1997, annex C.
    expected = [np.sqrt(3) / tau, 1 / np.sqrt(tau), 0.664, np.sqrt(tau / 3), tau / np.sqrt(2)]
    for column, deviation in zip(np.sqrt(shapes(tau)).T, expected, strict=True):
        assert_allclose(column, np.broadcast_to(deviation, 3), rtol=1e-3)  # 0.664 has 3 digits


@pytest.mark.long
@pytest.mark.parametrize('letter', TERMS)
def test_nineteen_intervals_of_twenty_hold_the_truth(letter):
    terms = [fit.terms[letter] for fit in fits()]
    inside = np.mean([term.low <= TRUTH[letter] <= term.high for term in terms])
    # 120 independent axes: the sigma of 95 % is 2 %; the weak terms are stated with care.
    assert 0.90 <= inside <= 0.992
    values = np.array([term.value for term in terms if term.determined])
    assert len(values) > 0.95 * len(terms)
    # The mean of 120 is within three of its sigmas, or of a fifth of the stated sigma.
    sigma = np.mean([term.sigma for term in terms if term.determined])
    assert abs(values.mean() - TRUTH[letter]) < 3 * sigma / np.sqrt(len(values)) + 0.05 * sigma
    # The sigma of a sigma from 120 is 6.5 %.
    assert 0.8 < values.std() / sigma < 1.2


def test_points_scatter_about_the_fit_as_stated():
    misfit = np.array([fit.misfit for fit in fits()])
    # Skewed points count a little less than their square; 12 of freedom scatter by 40 % each.
    assert 0.8 < misfit.mean() < 1.1
    assert np.mean([fit.from_s > 1.0 for fit in fits()]) < 0.02  # hardly ever a point left out


@pytest.mark.parametrize('triad', ['gyroscope', 'accelerometer'])
def test_white_noise_is_known_to_one_and_a_half_per_cent_after_ten_minutes(triad):
    truth = getattr(BMI160, triad).noise_density
    terms = [fit.terms['N'] for fit in bmi160()[triad]]
    errors = np.array([term.value / truth - 1 for term in terms])
    # 60 axes of seeds 0 to 19: every one, not only 95 % of them; 0.3 % rms.
    assert np.abs(errors).max() < 0.015
    assert np.sqrt(np.mean(errors**2)) < 0.005
    assert np.mean([term.low <= truth <= term.high for term in terms]) > 0.88


@pytest.mark.parametrize('letter', ['B', 'K', 'R'])
def test_what_ten_minutes_leave_open_is_bounded_rightly(letter):
    for triad, found in bmi160().items():
        errors = getattr(BMI160, triad)
        truth = {'B': errors.bias_instability, 'K': errors.bias_random_walk, 'R': 0.0}[letter]
        terms = [fit.terms[letter] for fit in found]
        assert np.mean([term.low <= truth <= term.high for term in terms]) > 0.88


def test_white_noise_alone_has_no_other_term():
    found = []
    for seed in range(20):
        curve = allan_curve(np.random.default_rng(seed).standard_normal((20000, 3)), RATE)
        found += [fit_allan(curve, axis).terms for axis in range(3)]
    for letter in 'QBKR':
        # Two sigmas of a square are passed by chance in 2.3 % of 60; a bound at zero makes less.
        assert sum(terms[letter].determined for terms in found) <= 4
        assert all(np.isnan(t[letter].value) or t[letter].value > 0 for t in found)
        assert all(t[letter].high > 0 for t in found)
    assert all(terms['N'].determined for terms in found)
    assert all(np.isinf(terms['Q'].needed_s) for terms in found if not terms['Q'].determined)


def test_the_length_that_is_asked_for_tells_the_term():
    truth = {'Q': 0.0, 'N': 1.0, 'B': 0.0, 'K': 0.02, 'R': 0.0}
    short = five_terms(2048, 1.0, **truth, rng=np.random.default_rng(1))
    terms = [fit_allan(allan_curve(short, 1.0), axis).terms['K'] for axis in range(3)]
    assert not any(term.determined for term in terms)
    needed = max(term.needed_s for term in terms)
    assert 2 * 2048 <= needed < np.inf
    # A term as large as the bound is told by a record of that length ...
    largest = truth | {'K': max(term.high for term in terms)}
    told = 0
    for seed in range(3):
        values = five_terms(round(needed), 1.0, **largest, rng=np.random.default_rng(seed))
        curve = allan_curve(values, 1.0)
        told += sum(fit_allan(curve, axis).terms['K'].determined for axis in range(3))
    assert told >= 8  # ... on eight axes of nine


def test_a_length_that_would_hardly_do_is_not_asked_for():
    # The bound is two to three sigmas of ten minutes; twice that length need not show it.
    lengths = [fit.terms['K'].needed_s for fits_ in bmi160().values() for fit in fits_]
    assert np.median(lengths) >= 3.9 * TEN_MINUTES / RATE


@pytest.mark.parametrize('memory', [0.5, 0.8])
def test_a_low_pass_filter_does_not_lower_the_noise_density(memory):
    terms = []
    for seed in range(5):
        white = np.random.default_rng(seed).standard_normal((TEN_MINUTES, 3)) * np.sqrt(RATE)
        filtered = lfilter([1 - memory], [1.0, -memory], white, axis=0)  # corners at 22 and 7 Hz
        curve = allan_curve(filtered, RATE)
        assert curve.deviation[0].max() < 0.8 * np.sqrt(RATE)  # there the filter bites
        terms += [fit_allan(curve, axis).terms for axis in range(3)]
    density = np.array([term['N'].value for term in terms])
    # What the filter spoils is lost to the fit: 1 to 2 % are left of 0.3.
    assert_allclose(density.mean(), 1.0, atol=0.012)
    assert np.std(density) < 0.035
    # 15 axes, of which 95 % are 14; the binomial law has fewer than 12 in one of 180 cases.
    assert sum(term['N'].low <= 1.0 <= term['N'].high for term in terms) >= 12
    assert sum(term['Q'].determined for term in terms) <= 1


def test_what_no_term_explains_widens_the_sigmas():
    rng = np.random.default_rng(4)
    time = np.arange(60000)[:, np.newaxis] / RATE
    hum = rng.standard_normal((60000, 3)) + 0.05 * np.sin(2 * np.pi * 0.2 * time)
    plain = rng.standard_normal((60000, 3))
    spoilt, clean = (fit_allan(allan_curve(v, RATE), 0) for v in (hum, plain))
    assert spoilt.misfit > 3
    assert clean.misfit < 1.9  # 20 of freedom: three sigmas above 1
    assert spoilt.terms['N'].sigma > 1.5 * clean.terms['N'].sigma


def test_scale_of_values_and_of_time_go_through(rng):
    values = five_terms(4096, 1.0, 0.0, 1.0, 0.3, 0.05, 0.0, rng)
    one = fit_allan(allan_curve(values, 1.0), 1)
    two = fit_allan(allan_curve(1e-3 * values, 100.0), 1)
    units = {'Q': 1e-2, 'N': 1e-1, 'B': 1.0, 'K': 1e1, 'R': 1e2}
    for k, letter in enumerate(TERMS):
        if letter == 'Q' or one.from_s != 100 * two.from_s:
            continue
        # The same least squares in other units; condition and rounding leave six digits.
        assert_allclose(two.free[k], one.free[k] * (1e-3 * units[letter]) ** 2, rtol=1e-6, atol=0)


@pytest.mark.long
def test_band_holds_the_deviation_of_the_process():
    rng, inside = np.random.default_rng(6), []
    for _ in range(100):
        curve = allan_curve(rng.standard_normal((2000, 3)), 1.0)
        for axis in range(3):
            low, high = deviation_band(curve.deviation[:, axis], fit_allan(curve, axis).dof)
            truth = 1 / np.sqrt(curve.tau)
            inside.append((low < truth) & (truth < high))
    # 300 series of points that go together: 1.3 % is one sigma of a point's share.
    assert np.all(np.abs(np.mean(inside, axis=0) - 0.95) < 0.05)


def test_a_square_below_two_sigmas_is_unknown():
    assert not term_of(1.9, 1.0).determined
    assert term_of(2.1, 1.0).determined
    unknown = term_of(-1.0, 1.0)
    assert (unknown.low, unknown.high) == (0.0, np.sqrt(2.0))
    known = term_of(100.0, 1.0)
    # Of a well known square the root is normal too: 10 +- 1.96 * 0.05, but for the skew.
    assert_allclose([known.low, known.high], [9.902, 10.098], atol=0.002)
