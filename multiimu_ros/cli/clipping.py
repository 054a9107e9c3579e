"""Readings that pile up at the end of a range, at the desk and live."""

import numpy as np

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.samples import ImuSamples

SATURATED = 5  # samples at the very same extreme: noise never does that


def saturated(vectors: Vectors) -> int:
    """Return how many samples pile up at an extreme: more than there are one step inside."""
    clipping = Clipping(vectors.shape[1])
    clipping.push(vectors)
    return clipping.hits


class Clipping:
    """Counts, for each end of each axis, the two outermost values.

    Parameters
    ----------
    axes : int
        Number of axes.
    """

    def __init__(self, axes: int) -> None:
        self._values: list[Scalars] = [np.zeros(0)] * 2 * axes  # outermost last
        self._counts: list[Scalars] = [np.zeros(0)] * 2 * axes

    def push(self, vectors: Vectors) -> None:
        """Take readings (N, axes)."""
        for k, axis in enumerate((*vectors.T, *-vectors.T)):
            finite = axis[np.isfinite(axis)]
            if len(finite):
                self._merge(k, finite)

    def _merge(self, k: int, finite: Scalars) -> None:
        extreme = finite.max()
        inside = finite[finite < extreme].max(initial=-np.inf)
        counts = [(finite == inside).sum(), (finite == extreme).sum()]
        values = np.r_[self._values[k], inside, extreme]
        distinct, where = np.unique(values, return_inverse=True)
        sums = np.bincount(where, np.r_[self._counts[k], counts])
        self._values[k], self._counts[k] = distinct[-2:], np.asarray(sums[-2:], np.float64)

    @property
    def hits(self) -> int:
        """How many readings lie at an end of the range: more than there are one step inside."""
        piled = 0.0
        for values, counts in zip(self._values, self._counts, strict=True):
            inside = counts[-2] if len(counts) > 1 else 0
            if len(values) and values[-1] > 0.0 and counts[-1] >= max(SATURATED, inside + 1):
                piled += counts[-1]
        return int(piled)


class ImuClipping:
    """The same of one IMU; which of rate and force clips more."""

    def __init__(self) -> None:
        self._count = 0
        self._parts = Clipping(3), Clipping(3)

    def push(self, samples: ImuSamples) -> None:
        """Take the next samples."""
        self._count += len(samples)
        for part, vectors in zip(
            self._parts, (samples.angular_rate, samples.specific_force), strict=True
        ):
            part.push(vectors)

    @property
    def share(self) -> float:
        """Share of the readings of rate or force that end the range [-]."""
        return clipped_share(max(part.hits for part in self._parts), self._count)


def clipped_share(hits: int, count: int) -> float:
    """Return the share of the readings of three axes that end the range [-]."""
    return hits / (3 * count) if count else 0.0
