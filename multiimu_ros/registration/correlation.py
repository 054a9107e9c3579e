"""The offset between two clocks that time the same motion, from |w| as each of them saw it.

Both signals are put on one even grid. For every lag Pearson's correlation is taken over what the
two have in common there, with their means and variances over that part only; without them a long
overlap wins over a good one. A parabola through the peak and its neighbours gives the fraction.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import correlate, correlation_lags

from multiimu_ros.arrays import Flags, Scalars
from multiimu_ros.errors import SyncError

MIN_CORRELATION = 0.8  # of |w|, below which the streams are not of one motion
MAX_GAP = 1.5  # periods of a stream, beyond which nothing is interpolated


@dataclass(frozen=True)
class Correlation:
    """Pearson's correlation of two signals over the offsets of their clocks.

    Parameters
    ----------
    lags, values : (L,) arrays
        Offsets [s], to be added to the second's times, and the correlation at each [-].
    offset, correlation : float
        Where it peaks, between the lags [s], and how high [-].
    """

    lags: Scalars
    values: Scalars
    offset: float
    correlation: float


def correlate_speeds(
    times_a: Scalars, a: Scalars, times_b: Scalars, b: Scalars, min_overlap: float
) -> Correlation:
    """Correlate two signals at every offset of the second one's clock.

    Parameters
    ----------
    times_a, times_b : (N,), (M,) arrays
        Each on its own clock [s].
    a, b : (N,), (M,) arrays
        The same quantity; NaN is a gap.
    min_overlap : float
        What share of the shorter signal must overlap [-]; with less, the value is -1.
    """
    step = float(max(np.median(np.diff(times_a)), np.median(np.diff(times_b))))
    even_a, there_a = _on_grid(times_a, a, step)
    even_b, there_b = _on_grid(times_b, b, step)
    values = _pearson(even_a, there_a, even_b, there_b, min_overlap)
    lags = times_a[0] - times_b[0] + step * correlation_lags(len(even_a), len(even_b))
    k = int(np.argmax(values))
    inside = 0 < k < len(values) - 1
    offset = float(lags[k]) + (step * _vertex(values, k) if inside else 0.0)
    return Correlation(np.asarray(lags, np.float64), values, offset, float(values[k]))


def correlate_rates(
    times_a: Scalars, a: Scalars, times_b: Scalars, b: Scalars, min_overlap: float, name: str
) -> Correlation:
    """Find the offset of the second signal's clock; `name` is what a message calls it.

    Raises
    ------
    SyncError
        If they agree nowhere.
    """
    found = correlate_speeds(times_a, a, times_b, b, min_overlap)
    if not found.correlation > MIN_CORRELATION:
        msg = f'The rates of `{name}` fit those of the target at no offset (correlation '
        msg += f'{found.correlation:.2f} at best); check that both recorded the same motion.'
        raise SyncError(msg)
    return found


def _on_grid(times: Scalars, values: Scalars, step: float) -> tuple[Scalars, Flags]:
    """Return the signal at even steps, 0 where unknown, and where it is known."""
    known = np.isfinite(values)
    if known.sum() < 2:
        return np.zeros(1), np.zeros(1, dtype=np.bool_)
    grid = times[0] + step * np.arange(int((times[-1] - times[0]) / step) + 1)
    after = np.clip(np.searchsorted(times[known], grid), 1, known.sum() - 1)
    gap = times[known][after] - times[known][after - 1]
    inside = (grid >= times[known][0]) & (grid <= times[known][-1])
    there = inside & (gap <= MAX_GAP * max(step, float(np.median(np.diff(times)))))
    return np.where(there, np.interp(grid, times[known], values[known]), 0.0), there


def _pearson(
    a: Scalars, there_a: Flags, b: Scalars, there_b: Flags, min_overlap: float
) -> Scalars:
    """Return the correlation at every lag, -1 where too little overlaps."""
    a, b = (a - a[there_a].mean()) * there_a, (b - b[there_b].mean()) * there_b  # for rounding
    mask_a, mask_b = there_a.astype(np.float64), there_b.astype(np.float64)
    count = correlate(mask_a, mask_b, method='fft').round()
    n = np.maximum(count, 1.0)
    mean_a, mean_b = correlate(a, mask_b, method='fft') / n, correlate(mask_a, b, method='fft') / n
    variance_a = correlate(a**2, mask_b, method='fft') / n - mean_a**2
    variance_b = correlate(mask_a, b**2, method='fft') / n - mean_b**2
    floor = 1e-6 * float(a.var() * b.var())  # a part without motion says nothing
    good = count >= max(min_overlap * min(mask_a.sum(), mask_b.sum()), 3.0)
    good &= variance_a * variance_b > floor
    covariance = correlate(a, b, method='fft') / n - mean_a * mean_b
    spread = np.sqrt(np.where(good, variance_a * variance_b, 1.0))
    return np.where(good, covariance / spread, -1.0)


def _vertex(values: Scalars, k: int) -> float:
    """Return where the parabola through three neighbours peaks, relative to the middle one."""
    left, middle, right = values[k - 1 : k + 2]
    bend = left - 2 * middle + right
    return float(0.5 * (left - right) / bend) if bend < 0 else 0.0
