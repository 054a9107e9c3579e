"""What a recording says in its static poses, and between them, as few numbers.

A pose is a span of rest: mean reading, and how well that mean is known.  The white noise comes
from differences of neighbouring short means within poses, pooled over all of them, so that neither
slow drift nor a coloured sensor noise is mistaken for it.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Flags, NANOSECONDS, Scalars, Stamps, Vector, Vectors
from multiimu_ros.calibration.static_intervals import GAP_PERIODS, StaticIntervals
from multiimu_ros.samples import ImuSamples

BLOCK_S = 0.2  # [s] long against the memory of a sensor's filter, short against its drift
LEAST_SHARE = 0.6  # of the samples that a span should hold
LEAST_DENSITY = 1e-12  # a noiseless simulation still has a weight


@dataclass(frozen=True)
class PoseReadings:
    """Raw readings of one IMU in P poses; NaN where it said too little.

    Parameters
    ----------
    time : (P,) array
        Middle of each pose since the first sample [s].
    duration : (P,) array
        Length of each pose [s].
    angular_rate, specific_force : (P, 3) arrays
        Means of the raw readings.
    rate_density, force_density : (3,) arrays
        White noise density of a raw reading [reading/sqrt(Hz)].
    """

    time: Scalars
    duration: Scalars
    angular_rate: Vectors
    specific_force: Vectors
    rate_density: Vector
    force_density: Vector

    def __len__(self) -> int:
        return len(self.time)

    @property
    def known(self) -> Flags:
        """Where the IMU was heard in the pose, (P,)."""
        return np.asarray(np.isfinite(self.specific_force).all(axis=1))

    def select(self, index: Flags) -> 'PoseReadings':
        """Return the poses under a mask."""
        return PoseReadings(
            self.time[index],
            self.duration[index],
            self.angular_rate[index],
            self.specific_force[index],
            self.rate_density,
            self.force_density,
        )


def read_poses(samples: ImuSamples, intervals: StaticIntervals) -> PoseReadings:
    """Average the samples (all finite) of one IMU over each interval."""
    first = np.searchsorted(samples.stamp_ns, intervals.begin_ns, side='left')
    last = np.searchsorted(samples.stamp_ns, intervals.end_ns, side='right')
    readings = np.hstack([samples.angular_rate, samples.specific_force])
    period = 1 / samples.rate_hz
    means = np.full((len(intervals), 6), np.nan)
    for k, (begin, end) in enumerate(zip(first, last, strict=True)):
        if (end - begin) * period > LEAST_SHARE * intervals.duration_s[k]:
            means[k] = readings[begin:end].mean(axis=0)
    density = np.sqrt(_pooled_density_square(readings, first, last, period))
    middle = (intervals.begin_ns - samples.stamp_ns[0]) / NANOSECONDS + intervals.duration_s / 2
    return PoseReadings(
        middle,
        np.asarray((last - first) * period),
        means[:, :3],
        means[:, 3:],
        density[:3],
        density[3:],
    )


def _pooled_density_square(
    readings: Vectors, first: Stamps, last: Stamps, period: float
) -> Vector:
    """Return N^2 (6,): half the mean square of steps between neighbouring block means, per Hz.

    NaN where no span holds two blocks.
    """
    size = max(round(BLOCK_S / period), 1)
    steps = []
    for begin, end in zip(first, last, strict=True):
        count = (end - begin) // size
        if count > 1:
            blocks = readings[begin : begin + count * size].reshape(count, size, -1).mean(axis=1)
            steps.append(np.diff(blocks, axis=0))
    if not steps:
        return np.full(readings.shape[1], np.nan)
    square = np.square(np.concatenate(steps)).mean(axis=0) / 2 * size * period
    return np.asarray(np.maximum(square, LEAST_DENSITY**2))


@dataclass(frozen=True)
class Transition:
    """Samples of one IMU from the end of one pose to the beginning of a later one.

    Parameters
    ----------
    start, stop : int
        Indices of the two poses.
    begin, end : int
        First sample, and one past the last.
    """

    start: int
    stop: int
    begin: int
    end: int


def find_transitions(
    samples: ImuSamples, intervals: StaticIntervals, usable: Flags, known: Flags
) -> tuple[Transition, ...]:
    """Return the moves from pose to next known pose that the samples tell without a break.

    Parameters
    ----------
    usable : (N,) bool array
        False for samples that must not be integrated (saturated).
    known : (P,) bool array
        Poses in which the IMU was heard.
    """
    broken = np.zeros(len(samples), bool)
    steps = np.diff(samples.stamp_ns)
    broken[1:] = steps > GAP_PERIODS * np.median(steps)
    poses = np.flatnonzero(known)
    found = []
    for start, stop in zip(poses[:-1].tolist(), poses[1:].tolist(), strict=True):
        begin = int(np.searchsorted(samples.stamp_ns, intervals.end_ns[start], side='right')) - 1
        end = int(np.searchsorted(samples.stamp_ns, intervals.begin_ns[stop], side='left')) + 1
        if usable[begin:end].all() and not broken[begin + 1 : end].any():
            found.append(Transition(start, stop, begin, end))
    return tuple(found)
