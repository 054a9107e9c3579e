"""How fast an IMU turns, and by how much its stamps are off those of another, coarsely.

|w| does not depend on how a gyroscope is mounted, so its correlation over lags peaks where the
clocks agree.  It is normalised by the overlap of each lag (Pearson); without that the peak leans
towards the greater overlap, by 0.2 ms in half a minute.  A parabola gives the fraction.

Also the alignment of [1]_: the instants at which each stream first leaves its rest.

.. [1] IJAMCE, "Multi-IMU data fusion for indoor navigation", 3.2.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Flags, Matrix, Scalars, Vectors
from multiimu_ros.errors import SyncError
from multiimu_ros.registration.correlation import correlate_speeds, Correlation
from multiimu_ros.synchronization.resampling import Grid, make_grid, resample, smooth

LEAST_OVERLAP_S = 5.0
LEAST_SHARE = 1 / 3  # of the shorter track
ONSET = 8.0  # times the scatter of the first second, smoothed


@dataclass(frozen=True)
class RateTrack:
    """Angular rates of one IMU.

    Parameters
    ----------
    time : (N,) array
        On its own clock [s].
    rate : (N, 3) array
        In any unit and frame; NaN where unusable.
    force : (N, 3) array, optional
        Specific force [m/s^2], to say what an unknown g-sensitivity may do.
    leak_sigma : (3, 3) array, optional
        Standard deviation of the g-sensitivity that is left [rad/s per m/s^2].
    """

    time: Scalars
    rate: Vectors
    force: Vectors | None = None
    leak_sigma: Matrix | None = None

    @property
    def step(self) -> float:
        """Median spacing [s]."""
        return float(np.median(np.diff(self.time)))

    @property
    def speed(self) -> Scalars:
        """How fast it turns (N,), NaN where unusable; the median of a track that rests is bias."""
        known = usable(self.rate)
        if not known.any():
            return np.full(len(self.time), np.nan)
        return np.asarray(np.linalg.norm(self.rate - np.median(self.rate[known], axis=0), axis=1))

    def smoothed(self, step: float, sigma: float) -> tuple[Grid, Matrix]:
        """Return an even grid of `step` and there the rates (N, 3), smoothed by `sigma` [s]."""
        grid = make_grid(float(self.time[0]), float(self.time[-1]), step, sigma)
        return grid, smooth(resample(self.time, self.rate, usable(self.rate), grid), grid)


def usable(vectors: Vectors) -> Flags:
    """Flag the rows (N,) that are finite."""
    return np.asarray(np.isfinite(vectors).all(axis=1))


def correlate_tracks(first: RateTrack, second: RateTrack) -> Correlation:
    """Correlate how fast two IMUs turn, over all delays.

    Raises
    ------
    SyncError
        If the tracks are too short.
    """
    heard = [track.time[usable(track.rate)] for track in (first, second)]
    if min(np.ptp(times) if len(times) else 0.0 for times in heard) < LEAST_OVERLAP_S:
        msg = f'Two tracks must overlap by {LEAST_OVERLAP_S:g} s to be aligned; record longer.'
        raise SyncError(msg)
    speeds = first.time, first.speed, second.time, second.speed
    return correlate_speeds(*speeds, LEAST_SHARE)


def onset_delay(first: RateTrack, second: RateTrack) -> float:
    """Return the delay [s] that makes both tracks leave their first rest at once (IJAMCE 3.2).

    Raises
    ------
    SyncError
        If a track does not begin with a second of rest and then move.
    """
    return _onset(first) - _onset(second)


def _onset(track: RateTrack) -> float:
    grid, rate = track.smoothed(track.step, 2 * track.step)
    first = grid.time < grid.start + 1.0
    rest = rate[first & np.isfinite(rate).all(axis=1)]
    level = ONSET * np.linalg.norm(rest.std(axis=0)) if len(rest) else np.nan
    away = np.linalg.norm(rate - rest.mean(axis=0), axis=1)
    moving = np.flatnonzero(away > level)
    if not len(moving):
        msg = 'A track must rest for a second and then be turned, to be aligned by its onset.'
        raise SyncError(msg)
    k = int(moving[0])
    before, here = away[k - 1], away[k]
    return float(grid.time[k] - grid.step * (here - level) / max(here - before, 1e-300))
