"""Filters by frequency before the fusion, thesis 5.2: options, each with its lag stated.

With tau = 1 / (2 pi cutoff), alpha = tau / (tau + dt), readings z and their mean m over the IMUs:

    low_pass        w = alpha w + (1 - alpha) z                          (5.53-5.55)
    high_pass       h = alpha (h + z - z_last)                           (5.57)
    complementary   y = alpha (y + m - m_last) + (1 - alpha) z           (5.58-5.59)
    wavelet         soft threshold on the details above the cutoff       (5.60-5.61)

A low pass takes noise at the price of lag: at 2 Hz it is 80 ms, in which a hand at 3 rad/s turns
14 degrees.  A high pass of a constant is 0: it removes a drift, and with it gravity and every
steady turn, so what it lets through is no input of odometry.

The complementary filter is the low pass of an IMU's own reading plus the high pass of the mean of
all.  What all feel passes unchanged, without lag; only what an IMU reads by itself is slowed.  It
is for the rates; forces differ by lever arms and pass as they are.  It makes the noises of the
IMUs alike, so that fusing them afterwards gains nothing more above the cutoff.
"""

from importlib import import_module
import math
from types import ModuleType
from typing import Literal

import numpy as np
from scipy.signal import lfilter

from multiimu_ros.arrays import Vectors
from multiimu_ros.errors import ConfigError

Prefilter = Literal['none', 'low_pass', 'high_pass', 'complementary', 'wavelet']
KINDS = ('none', 'low_pass', 'high_pass', 'complementary', 'wavelet')

WAVELET = 'sym4'  # nearly symmetric: it does not shift what it keeps
SPAN = 8  # of the coarsest wavelet's period, in the sliding window: more than its filter's 7
LAG = 2  # of its periods that the answer is behind the newest reading, off the window's edge
MEDIAN_TO_SIGMA = 0.6745  # of the modulus of a standard Gaussian


class ScanPrefilter:
    """One filter per IMU and axis, on a live stream of scans.

    Parameters
    ----------
    kind : str
        Which filter.
    count : int
        IMUs K.
    cutoff_hz : float
        Where the filter parts low from high; the wavelets' goes by octaves.
    rate_hz : float
        Rate of the scans.

    Attributes
    ----------
    lag_s : float
        How late slow changes pass [s]; of the high pass, changes well above the cutoff.
    """

    def __init__(self, kind: Prefilter, count: int, *, cutoff_hz: float, rate_hz: float) -> None:
        self._kind, self._alpha = kind, smoothing(kind, cutoff_hz, rate_hz)
        self._levels = wavelet_levels(cutoff_hz, rate_hz)
        self.lag_s = 0.0
        if kind == 'low_pass':
            self.lag_s = 0.5 / (math.pi * cutoff_hz)
        if kind == 'wavelet':
            load_wavelets()
            self.lag_s = LAG * 2**self._levels / rate_hz
        self._last = np.full((count, 6), np.nan)
        self._filtered = np.full((count, 6), np.nan)
        self._window = np.zeros((SPAN * 2**self._levels, count, 6))
        self._age = np.zeros((count, 6), np.int64)

    def push(self, values: Vectors) -> Vectors:
        """Filter one scan.

        Parameters
        ----------
        values : (K, 6) array
            Angular rates [rad/s], then specific forces [m/s^2]; NaN where there is none.

        Returns
        -------
        (K, 6) array
            The same, filtered.  Where an IMU lacks it is NaN, and its filter begins anew when it
            is back; the wavelets' answer is NaN until the lag has passed, too.
        """
        last, self._last = self._last, values.copy()
        if self._kind == 'low_pass':
            slow = self._alpha * self._filtered + (1.0 - self._alpha) * values
            self._filtered = np.where(np.isnan(slow), values, slow)
        elif self._kind == 'high_pass':
            fast = self._alpha * (self._filtered + values - last)
            self._filtered = np.where(np.isnan(fast), 0.0 * values, fast)
        elif self._kind == 'complementary':
            self._filtered = self._complemented(values, last)
        elif self._kind == 'wavelet':
            self._filtered = self._denoised(values)
        else:
            return values.copy()
        return self._filtered.copy()

    def _complemented(self, values: Vectors, last: Vectors) -> Vectors:
        """Mean changes are of the IMUs that are in both scans: nobody's leaving is one."""
        changes = values - last
        both = np.isfinite(changes)
        change = np.where(both, changes, 0.0).sum(axis=0) / np.maximum(both.sum(axis=0), 1)
        complemented = self._alpha * (self._filtered + change) + (1.0 - self._alpha) * values
        complemented[:, 3:] = values[:, 3:]
        return np.where(np.isnan(complemented), values, complemented)

    def _denoised(self, values: Vectors) -> Vectors:
        """Shift the scan into the window; a new reading is taken to have been there always."""
        present = np.isfinite(values)
        fresh = present & (self._age == 0)
        self._age = np.where(present, self._age + 1, 0)
        self._window[:-1] = self._window[1:]
        self._window[-1] = np.where(present, values, 0.0)
        self._window[:, fresh] = values[fresh]
        delay = LAG * 2**self._levels
        cleaned = denoise(self._window, self._levels)[-1 - delay]
        return np.where(self._age > delay, cleaned, np.nan)


def prefilter_series(
    kind: Prefilter, values: Vectors, *, cutoff_hz: float, rate_hz: float
) -> Vectors:
    """Filter N scans (N, K, 6): the numbers of the stream, but of the wavelets.

    Those see a run of readings whole, with what comes after, and have no lag.
    """
    alpha = smoothing(kind, cutoff_hz, rate_hz)
    if kind in {'none', 'complementary'}:
        stream = ScanPrefilter(kind, values.shape[1], cutoff_hz=cutoff_hz, rate_hz=rate_hz)
        return np.array([stream.push(scan) for scan in values]).reshape(values.shape)
    filtered = np.full_like(values, np.nan)
    for k, axis in np.ndindex(values.shape[1:]):
        column = values[:, k, axis]
        for run in _runs(column):
            if kind == 'low_pass':
                filtered[run, k, axis] = low_pass(column[run], alpha)
            elif kind == 'high_pass':
                filtered[run, k, axis] = high_pass(column[run], alpha)
            else:
                levels = wavelet_levels(cutoff_hz, rate_hz)
                filtered[run, k, axis] = denoise(column[run], levels)
    return filtered


def smoothing(kind: Prefilter, cutoff_hz: float, rate_hz: float) -> float:
    """Return alpha (5.55) [-], or raise a ConfigError."""
    if kind not in KINDS:
        msg = f'`prefilter` must be one of {", ".join(KINDS)}, got {kind!r}.'
        raise ConfigError(msg)
    if not 0.0 < cutoff_hz < 0.5 * rate_hz:
        msg = f'`cutoff_hz` must be between 0 and {0.5 * rate_hz:g}, half the rate of the scans, '
        raise ConfigError(msg + f'got {cutoff_hz:g}.')
    tau = 0.5 / (math.pi * cutoff_hz)
    return tau / (tau + 1.0 / rate_hz)


def low_pass(series: Vectors, alpha: float) -> Vectors:
    """Filter (N, ...) by (5.53), from a state that is the first reading."""
    state = alpha * series[:1]
    return np.asarray(lfilter([1.0 - alpha], [1.0, -alpha], series, axis=0, zi=state)[0])


def high_pass(series: Vectors, alpha: float) -> Vectors:
    """Filter (N, ...) by (5.57), from 0."""
    state = -alpha * series[:1]
    return np.asarray(lfilter([alpha, -alpha], [1.0, -alpha], series, axis=0, zi=state)[0])


def wavelet_levels(cutoff_hz: float, rate_hz: float) -> int:
    """Return how many octaves of details lie above the cutoff, at least one."""
    return max(1, round(math.log2(0.5 * rate_hz / cutoff_hz)))


def denoise(series: Vectors, levels: int) -> Vectors:
    """Shrink the details of a series (N, ...) by sigma sqrt(2 ln N), the universal threshold.

    sigma is the noise of each column as its finest details show it, by their median.
    """
    pywt = load_wavelets()
    if len(series) < 2:
        return series.copy()
    most = min(levels, pywt.dwt_max_level(len(series), WAVELET)) or 1
    smooth, *details = pywt.wavedec(series, WAVELET, mode='smooth', level=most, axis=0)
    sigma = np.median(np.abs(details[-1]), axis=0) / MEDIAN_TO_SIGMA
    threshold = sigma * math.sqrt(2.0 * math.log(len(series)))
    shrunk = [np.sign(d) * np.maximum(np.abs(d) - threshold, 0.0) for d in details]
    cleaned = pywt.waverec([smooth, *shrunk], WAVELET, mode='smooth', axis=0)
    return np.asarray(cleaned[: len(series)])


def load_wavelets() -> ModuleType:
    """Return PyWavelets, or raise a ConfigError that says how to get it."""
    try:
        return import_module('pywt')  # an extra that few need
    except ImportError:
        msg = '`prefilter` wavelet needs PyWavelets, which is missing: `pip install PyWavelets`.'
        raise ConfigError(msg) from None


def _runs(column: Vectors) -> list[slice]:
    """Return the slices of (N,) without NaN."""
    edges = np.flatnonzero(np.diff(np.r_[False, np.isfinite(column), False].astype(np.int8)))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
