"""When a board rests: the static detector of [1]_, on all IMUs of a board at once.

The variance of rate and force over a short window is compared with that of the quietest windows
of the same recording, so that nothing needs tuning per sensor:

    ratio = mean over IMUs of (var(w) / var_quiet(w) + var(f) / var_quiet(f)) / 2

At rest it is about 1.  Which multiple of 1 still counts as rest depends on the table and the hand;
the fit that follows tries several (`THRESHOLDS`) and keeps the one that it can use best.

.. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU
   calibration without external equipments", ICRA 2014, section IV.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d

from multiimu_ros.arrays import Flags, NANOSECONDS, Scalars, Stamps, Vectors
from multiimu_ros.samples import ImuSamples

THRESHOLDS = (2.0, 3.0, 4.5, 7.0, 10.0, 20.0, 40.0, 80.0)
QUIET_SHARE = 0.05  # of the windows: somebody who records a calibration rests longer than that
ROUNDING = 1e-12  # of the largest variance: what the running sums leave of a noiseless rest
GAP_PERIODS = 3.0  # a longer hole ends an interval: nobody knows what happened in it


@dataclass(frozen=True, kw_only=True)
class StaticConfig:
    """Settings of the detector.

    Parameters
    ----------
    window_s : float
        Over which the variance is taken [s].
    shortest_s : float
        Shorter rests are not poses [s].
    margin : float
        Share of half a window by which an interval may reach beyond the samples whose window
        is quiet; the rest is kept off the beginning motion [-].
    """

    window_s: float = 0.5
    shortest_s: float = 0.8
    margin: float = 0.5


@dataclass(frozen=True)
class StaticIntervals:
    """P spans of rest, in order of time; `begin_ns` and `end_ns` (P,) are both inside [ns]."""

    begin_ns: Stamps
    end_ns: Stamps

    def __len__(self) -> int:
        return len(self.begin_ns)

    @property
    def duration_s(self) -> Scalars:
        """Length of each span (P,) [s]."""
        return np.asarray((self.end_ns - self.begin_ns) / NANOSECONDS)

    def select(self, index: Flags | slice) -> 'StaticIntervals':
        """Return the spans under a mask or slice."""
        return StaticIntervals(self.begin_ns[index], self.end_ns[index])


def variance_ratio(samples: ImuSamples, config: StaticConfig = StaticConfig()) -> Scalars:
    """Return how restless each sample's window is, (N,): about 1 at rest [-]."""
    window = max(round(config.window_s * samples.rate_hz), 3)
    ratios = []
    for vectors in (samples.angular_rate, samples.specific_force):
        variance = _windowed_variance(vectors, window)
        quiet = max(float(np.quantile(variance, QUIET_SHARE)), _least_variance(vectors, variance))
        ratios.append(variance / quiet)
    return np.asarray(sum(ratios) / len(ratios))


def _least_variance(vectors: Vectors, variance: Scalars) -> float:
    """Return what no rest is quieter than: the variance of rounding to the sensor's steps."""
    steps = np.abs(np.diff(vectors, axis=0))
    least = np.min(steps, axis=0, initial=np.inf, where=steps > 0)
    coarse = float(np.square(least[np.isfinite(least)]).sum()) / 12
    return max(coarse, ROUNDING * float(variance.max()), 1e-300)


def _windowed_variance(vectors: Vectors, window: int) -> Scalars:
    """Return the variance about each sample, summed over the axes, (N,)."""
    centred = vectors - np.median(vectors, axis=0)  # against cancellation
    mean = uniform_filter1d(centred, window, axis=0, mode='nearest')
    square = uniform_filter1d(centred**2, window, axis=0, mode='nearest')
    return np.asarray(np.maximum(square - mean**2, 0.0).sum(axis=1))


def board_ratio(
    tracks: Sequence[ImuSamples], config: StaticConfig = StaticConfig()
) -> tuple[Stamps, Scalars]:
    """Return the stamps (N,) of the first track, and there the mean ratio of all, (N,)."""
    stamp_ns = tracks[0].stamp_ns
    ratios = [variance_ratio(track, config) for track in tracks]
    # Interpolated across a hole, a ratio says nothing; the gaps cut the intervals later.
    at_first = [
        np.interp(stamp_ns, track.stamp_ns, ratio)
        for track, ratio in zip(tracks, ratios, strict=True)
    ]
    return stamp_ns, np.asarray(np.mean(at_first, axis=0))


def find_intervals(
    stamp_ns: Stamps, ratio: Scalars, threshold: float, config: StaticConfig = StaticConfig()
) -> StaticIntervals:
    """Return the spans in which the ratio (N,) stays below a threshold, gaps left out."""
    quiet = (ratio < threshold).astype(np.int8)
    steps = np.diff(stamp_ns)
    hole = steps > GAP_PERIODS * np.median(steps) if len(steps) else np.zeros(0, bool)
    # A hole between i and i + 1 ends the span at i, even where both are quiet.
    edges = np.diff(np.concatenate([[0], quiet, [0]]))
    begins, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    cuts = np.flatnonzero(hole & (quiet[:-1] == 1) & (quiet[1:] == 1))
    begins, ends = np.sort(np.r_[begins, cuts + 1]), np.sort(np.r_[ends, cuts])
    reach = round(config.margin * config.window_s / 2 * NANOSECONDS)
    begin_ns, end_ns = stamp_ns[begins] - reach, stamp_ns[ends] + reach
    begin_ns, end_ns = np.maximum(begin_ns, stamp_ns[0]), np.minimum(end_ns, stamp_ns[-1])
    for cut in cuts:  # no reaching across a hole
        begin_ns[begins == cut + 1], end_ns[ends == cut] = stamp_ns[cut + 1], stamp_ns[cut]
    long_enough = end_ns - begin_ns >= config.shortest_s * NANOSECONDS
    return StaticIntervals(begin_ns[long_enough], end_ns[long_enough])
