"""What kind of random process a series is: the tools of thesis 5.1.1 and a hint at the model.

Autocorrelation (5.4), partial autocorrelation by the recursion of Levinson and Durbin [1]_, lag
plot, and the choice of 5.1.1.2: white, autoregressive (of order 1: Gauss-Markov), moving average,
both, or not stationary.  The correlogram alone leaves that choice to the eye; here

* a series is not stationary if the means of its eighths differ more than the scatter within them
  explains (analysis of variance), or if neighbours are so alike that it hardly forgets anything
  in a twentieth of the record;
* it is white if its first autocorrelations are as small as those of white noise (Ljung and Box);
* else the smallest of all ARMA(p, q) models up to order 3 that explains it (Bayesian information
  criterion) names the kind, each model fitted as Hannan and Rissanen do: residuals of a long
  autoregression stand in for the unseen noise.

.. [1] P. J. Brockwell, R. A. Davis, "Introduction to Time Series and Forecasting", 3rd ed., 2016,
   sections 1.6, 2.5, 5.1.4.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import next_fast_len
from scipy.stats import chi2, f as fisher

from multiimu_ros.arrays import Matrix, Scalars

Kind = Literal['white', 'autoregressive', 'moving average', 'mixed', 'not stationary']

LEAST = 500  # samples
GROUPS = 8  # eighths of the record, each again in eighths
DRIFT_P = 1e-4  # small, for the means of neighbouring pieces are a little correlated
FORGOTTEN = 0.05  # of the record
WHITE_P = 0.01
WHITE_LAGS = 20
ORDER = 3  # the largest p and q
LONG = 30  # lags of the autoregression that gives the residuals
NEEDLESS = 2.0  # criterion: what a smaller model may lose against the best


@dataclass(frozen=True)
class ModelHint:
    """A model of a series, and why.

    Parameters
    ----------
    kind : str
        `white`, `autoregressive`, `moving average`, `mixed` or `not stationary`.
    p, q : int
        Orders of the autoregression and of the moving average.
    correlation_time : float
        Of a Gauss-Markov process, p = 1 and q = 0 [s]; else NaN.
    reason : str
        One sentence.
    """

    kind: Kind
    p: int
    q: int
    correlation_time: float
    reason: str


def autocorrelation(series: Scalars, lags: int) -> Scalars:
    """Return the sample autocorrelation (lags + 1,) from lag 0 on, thesis (5.4) [-]."""
    series = _as_series(series, lags + 1)
    centred = series - series.mean()
    spectrum = np.fft.rfft(centred, next_fast_len(len(centred) + lags, real=True))
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: lags + 1]
    if not covariance[0] > 0:
        msg = '`series` must change, got a constant; is the sensor stuck?'
        raise ValueError(msg)
    return np.asarray(covariance / covariance[0])


def partial_autocorrelation(correlation: Scalars) -> Scalars:
    """Return the partial autocorrelation (lags + 1,) that belongs to an autocorrelation [-].

    Its value at lag k is the last coefficient of the best autoregression of order k.
    """
    partial = np.ones_like(correlation)
    coefficients = np.empty(0)
    for lag in range(1, len(correlation)):
        before = correlation[lag - 1 : 0 : -1]
        left = 1 - coefficients @ correlation[1:lag]
        last = (correlation[lag] - coefficients @ before) / left
        coefficients = np.append(coefficients - last * coefficients[::-1], last)
        partial[lag] = last
    return partial


def white_band(count: int) -> float:
    """Return what 95 % of the autocorrelations of `count` white samples stay below [-]."""
    return float(1.96 / np.sqrt(count))


def lag_points(series: Scalars, lag: int = 1, most: int = 5000) -> tuple[Scalars, Scalars]:
    """Return the lag plot: samples x[k - lag] and x[k], at most `most` of them, evenly picked."""
    series = _as_series(series, lag + 1)
    stride = max(1, -(-(len(series) - lag) // most))
    return series[:-lag:stride], series[lag::stride]


def suggest_model(series: Scalars, rate_hz: float) -> ModelHint:
    """Name a model for an evenly spaced series (N,), and say why.

    Raises
    ------
    ValueError
        If the series has fewer than 500 samples, a NaN, or never changes.
    """
    series = _as_series(series, LEAST)
    correlation = autocorrelation(series, WHITE_LAGS)
    drift = _drift_p_value(series)
    if drift < DRIFT_P:
        reason = (
            'The means of its eighths differ more than its own scatter explains '
            f'(p = {drift:.1g}): it drifts, or its correlation outlasts the record.'
        )
        return ModelHint('not stationary', 0, 0, float('nan'), reason)
    white = _white_p_value(correlation, len(series))
    if white > WHITE_P:
        reason = (
            f'Its first {WHITE_LAGS} autocorrelations are as small as those of white noise '
            f'(p = {white:.2g}).'
        )
        return ModelHint('white', 0, 0, float('nan'), reason)
    memory = -1 / np.log(abs(correlation[1])) / len(series) if 0 < abs(correlation[1]) < 1 else 0.0
    if memory > FORGOTTEN:
        reason = f'Its neighbours are so alike (r = {correlation[1]:.5f}) that it walks at random.'
        return ModelHint('not stationary', 0, 0, float('nan'), reason)
    p, q = _orders(series)
    return _coloured(p, q, float(correlation[1]), rate_hz)


def _coloured(p: int, q: int, first: float, rate_hz: float) -> ModelHint:
    if q == 0:
        reason = f'Its partial autocorrelation ends after lag {p}, its autocorrelation fades.'
        gauss_markov = p == 1 and 0 < first < 1
        time = -1 / (rate_hz * np.log(first)) if gauss_markov else float('nan')
        if gauss_markov:
            reason += f' It is a Gauss-Markov process of correlation time {time:.3g} s.'
        return ModelHint('autoregressive', p, 0, float(time), reason)
    if p == 0:
        reason = f'Its autocorrelation ends after lag {q}, its partial autocorrelation fades.'
        return ModelHint('moving average', 0, q, float('nan'), reason)
    reason = (
        f'Neither autocorrelation nor partial autocorrelation ends; ARMA({p}, {q}) explains it '
        'with the fewest coefficients.'
    )
    return ModelHint('mixed', p, q, float('nan'), reason)


def _drift_p_value(series: Scalars) -> float:
    """Return how probable the differences of the means of eighths are in a stationary series."""
    size = len(series) // GROUPS**2
    means = series[: size * GROUPS**2].reshape(GROUPS, GROUPS, size).mean(axis=2)
    between = GROUPS * means.mean(axis=1).var(ddof=1)
    within = means.var(axis=1, ddof=1).mean()
    return float(fisher(GROUPS - 1, GROUPS * (GROUPS - 1)).sf(between / within))


def _white_p_value(correlation: Scalars, count: int) -> float:
    """Return the p-value of Ljung and Box's test that a series is white."""
    lag = np.arange(1, len(correlation))
    statistic = count * (count + 2) * np.sum(correlation[1:] ** 2 / (count - lag))
    return float(chi2(len(lag)).sf(statistic))


def _orders(series: Scalars) -> tuple[int, int]:
    """Return p and q of the smallest model that is hardly worse than the best."""
    centred = series - series.mean()
    residual = _unexplained(centred[LONG:], _lags(centred, LONG, LONG))
    target = centred[LONG + ORDER :]
    past = _lags(centred[LONG:], ORDER, ORDER)
    noise = _lags(residual, ORDER, ORDER)
    penalty = np.log(len(target)) / len(target)
    scores = {}
    for p in range(ORDER + 1):
        for q in range(ORDER + 1):
            regressors = np.hstack([past[:, :p], noise[:, :q]])
            variance = _unexplained(target, regressors).var() if p + q else target.var()
            scores[p, q] = float(np.log(variance) + (p + q) * penalty)
    best = min(scores.values())
    near = [o for o, score in scores.items() if score < best + NEEDLESS * penalty and sum(o)]
    return min(near, key=lambda o: (sum(o), scores[o]))


def _lags(series: Scalars, count: int, begin: int) -> Matrix:
    """Return the `count` values before each sample from `begin` on, the newest first."""
    return sliding_window_view(series, count)[begin - count : -1, ::-1]


def _unexplained(target: Scalars, regressors: Matrix) -> Scalars:
    """Return the residuals of a least-squares regression."""
    gram = regressors.T @ regressors
    return np.asarray(target - regressors @ np.linalg.solve(gram, regressors.T @ target))


def _as_series(series: Scalars, least: int) -> Scalars:
    array = np.asarray(series, dtype=np.float64)
    if array.ndim != 1 or len(array) < least or not np.isfinite(array).all():
        msg = f'`series` must be at least {least} finite numbers, got shape {array.shape}'
        msg += '.' if np.isfinite(array).all() else ' with some that are not finite.'
        raise ValueError(msg)
    return array
