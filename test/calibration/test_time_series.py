"""Correlograms against the thesis' formulas, and hints on series of known kind."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.signal import lfilter

from multiimu_ros.calibration.time_series import (
    autocorrelation,
    lag_points,
    partial_autocorrelation,
    suggest_model,
    white_band,
)

COUNT, SEEDS, RATE = 5000, 40, 100.0


def arma(moving, auto, seed, count=COUNT):
    noise = np.random.default_rng(seed).standard_normal(count + 1000)
    return lfilter(moving, auto, noise)[1000:]


def test_autocorrelation_is_formula_5_4_of_the_thesis(rng):
    series = np.cumsum(rng.standard_normal(300)) + 5.0
    centred = series - series.mean()
    published = [np.sum(centred[: 300 - k] * centred[k:]) / np.sum(centred**2) for k in range(21)]
    assert_allclose(autocorrelation(series, 20), published, rtol=1e-10, atol=1e-12)


def test_partial_autocorrelation_is_the_last_coefficient_of_each_autoregression(rng):
    correlation = autocorrelation(arma([1.0, 0.4], [1.0, -0.8], 1), 8)
    expected = [1.0]
    for order in range(1, 9):
        toeplitz = correlation[np.abs(np.subtract.outer(range(order), range(order)))]
        expected.append(np.linalg.solve(toeplitz, correlation[1 : order + 1])[-1])
    assert_allclose(partial_autocorrelation(correlation), expected, rtol=1e-9)


def test_ninety_five_per_cent_of_white_correlations_lie_in_the_band(rng):
    inside = [
        np.abs(autocorrelation(rng.standard_normal(2000), 20)[1:]) < white_band(2000)
        for _ in range(100)
    ]
    assert abs(np.mean(inside) - 0.95) < 0.02  # 2000 of them: 0.5 %


def test_lag_points_are_neighbours():
    before, now = lag_points(np.arange(10.0), lag=3)
    assert_allclose(now - before, 3.0)
    assert len(before) == 7
    before, now = lag_points(np.arange(100.0), most=20)
    assert_allclose(now - before, 1.0)
    assert len(before) <= 20


@pytest.mark.parametrize(
    ('moving', 'auto', 'kind', 'orders'),
    [
        ([1.0], [1.0], 'white', (0, 0)),
        ([1.0], [1.0, -0.8], 'autoregressive', (1, 0)),
        ([1.0], [1.0, 0.5], 'autoregressive', (1, 0)),
        ([1.0], [1.0, -0.95], 'autoregressive', (1, 0)),
        ([1.0], [1.0, -0.6, -0.3], 'autoregressive', (2, 0)),
        ([1.0, 0.6], [1.0], 'moving average', (0, 1)),
        ([1.0, 0.5, 0.4], [1.0], 'moving average', (0, 2)),
        ([1.0, 0.4], [1.0, -0.8], 'mixed', (1, 1)),
        ([1.0], [1.0, -1.0], 'not stationary', (0, 0)),
    ],
)
def test_the_kind_of_a_known_series_is_named(moving, auto, kind, orders):
    hints = [suggest_model(arma(moving, auto, seed), RATE) for seed in range(SEEDS)]
    right = np.mean([(hint.kind, hint.p, hint.q) == (kind, *orders) for hint in hints])
    # Seen over 100 seeds: 97 to 100 %, orders included.
    assert right >= 0.92
    assert all(hint.reason.endswith('.') for hint in hints)


def test_a_random_walk_is_never_taken_for_a_long_memory():
    # Its eighths may happen to agree, three times in a hundred; then its neighbours tell.
    kinds = {suggest_model(arma([1.0], [1.0, -1.0], seed), RATE).kind for seed in range(100)}
    assert kinds == {'not stationary'}


@pytest.mark.parametrize(
    'drift',
    [
        lambda rng: 0.02 * np.cumsum(rng.standard_normal(COUNT)),
        lambda rng: 2e-4 * np.arange(COUNT),
    ],
)
def test_drift_under_white_noise_is_seen(drift):
    kinds = []
    for seed in range(SEEDS):
        rng = np.random.default_rng(seed)
        kinds.append(suggest_model(rng.standard_normal(COUNT) + drift(rng), RATE).kind)
    # The walk is as large as the noise at the end, the ramp too; 10 % of walks turn back.
    assert np.mean([kind == 'not stationary' for kind in kinds]) >= 0.85


def test_a_gauss_markov_process_has_its_correlation_time():
    times = [
        suggest_model(arma([1.0], [1.0, -0.9], seed), RATE).correlation_time for seed in range(10)
    ]
    expected = -1 / (RATE * np.log(0.9))
    # The sigma of 0.9 is sqrt((1 - 0.81) / 5000) = 0.006, which is 6 % of the time; ten of them.
    assert_allclose(np.mean(times), expected, rtol=0.06)
    assert np.isnan(suggest_model(arma([1.0], [1.0, 0.5], 0), RATE).correlation_time)


def test_scale_and_offset_do_not_matter():
    series = arma([1.0, 0.4], [1.0, -0.8], 5)
    one, other = suggest_model(series, RATE), suggest_model(1e-4 * series + 9.81, RATE)
    assert (one.kind, one.p, one.q) == (other.kind, other.p, other.q)


@pytest.mark.parametrize(
    ('series', 'complaint'),
    [
        (np.zeros(499), r'at least 500 finite numbers, got shape \(499,\)'),
        (np.append(np.arange(600.0), np.nan), 'with some that are not finite'),
        (np.zeros((600, 3)), r'got shape \(600, 3\)'),
        (np.ones(600), 'must change'),
    ],
)
def test_bad_input_is_named_in_the_message(series, complaint):
    with pytest.raises(ValueError, match=complaint):
        suggest_model(series, RATE)
