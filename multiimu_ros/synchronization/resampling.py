"""Streams of whatever spacing on an even time base, smoothed, with holes known.

A cubic spline brings the samples to the grid, a Gaussian takes out what the grid cannot carry.
The same kernel on every stream keeps every linear relation between streams, and the derivative of
the kernel gives that of the smoothed signal: nothing is biased by smoothing, as it would be by a
difference quotient.  What the kernel would take from a hole, from samples that must not be used or
from beyond the ends is NaN.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from multiimu_ros.arrays import Flags, Matrix, Scalars

GAP_PERIODS = 3.0
REACH = 4.0  # sigmas of the kernel that a hole spoils on either side
WIDTH = 1.25  # sigma of the kernel in steps: 5e-4 of a tone at half the rate is left, 1e-4 at 0.55


@dataclass(frozen=True)
class Grid:
    """Even instants.

    Parameters
    ----------
    start : float
        First instant [s].
    step : float
        Spacing [s].
    count : int
        Number of instants N.
    sigma : float
        Of the smoothing kernel [s].
    """

    start: float
    step: float
    count: int
    sigma: float

    @property
    def time(self) -> Scalars:
        """The instants (N,) [s]."""
        return np.asarray(self.start + self.step * np.arange(self.count), np.float64)


def make_grid(start: float, stop: float, step: float, sigma: float | None = None) -> Grid:
    """Return the grid over a span; the kernel has 1.25 steps unless `sigma` [s] is given."""
    count = max(int((stop - start) / step) + 1, 0)
    return Grid(start, step, count, WIDTH * step if sigma is None else sigma)


def resample(time: Scalars, values: Matrix, usable: Flags, grid: Grid) -> Matrix:
    """Bring samples to the grid.

    Parameters
    ----------
    time : (M,) array
        Increasing instants of the samples [s].
    values : (M, C) array
        Any channels, finite where usable.
    usable : (M,) bool array
        False for samples that must not be used.

    Returns
    -------
    (N, C) array
        NaN in holes and outside the samples.
    """
    kept = usable & np.isfinite(values).all(axis=1)
    if kept.sum() < 4:
        return np.full((grid.count, values.shape[1]), np.nan)
    t = time[kept]
    out = np.asarray(CubicSpline(t, values[kept], axis=0)(grid.time))
    right = np.searchsorted(t, grid.time).clip(1, len(t) - 1)
    wide = (t[right] - t[right - 1]) > GAP_PERIODS * np.median(np.diff(t))
    outside = (grid.time < t[0]) | (grid.time > t[-1])
    out[wide | outside] = np.nan
    return out


def smooth(values: Matrix, grid: Grid, order: int = 0) -> Matrix:
    """Smooth a resampled signal (N, ...), or return the derivative of the smoothed one.

    Parameters
    ----------
    order : int
        0 for the signal, 1 for its derivative [1/s].

    Returns
    -------
    (N, ...) array
        NaN as far as the kernel reaches from holes and ends.
    """
    width = grid.sigma / grid.step
    reach = int(np.ceil(REACH * width))
    missing = np.asarray(~np.isfinite(values), np.uint8)
    spoilt = maximum_filter1d(missing, 2 * reach + 1, axis=0, mode='constant', cval=1)
    out = gaussian_filter1d(
        bridge(values), width, axis=0, order=order, truncate=6.0, mode='nearest'
    )
    out = np.asarray(out / grid.step**order)
    out[spoilt > 0] = np.nan
    return out


def bridge(values: Matrix) -> Matrix:
    """Return the signal (N, ...) with straight lines across its holes, for filters and splines.

    What is made up this way is not to be used; but unlike zeros it does not ring beside the hole.
    """
    columns = values.reshape(len(values), -1)
    out = columns.copy()
    for channel in range(columns.shape[1]):
        known = np.isfinite(columns[:, channel])
        if known.any() and not known.all():
            place = np.flatnonzero(known)
            out[:, channel] = np.interp(np.arange(len(out)), place, columns[place, channel])
    return out.reshape(values.shape)
