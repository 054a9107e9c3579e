"""Samples of a resting rig, withheld until later samples confirm the rest.

A detector needs some samples to notice that a rest has ended; the first samples of the motion
would be taken for bias and the first of the turn would be lost.  So a filter holds its state
through a rest and learns from each sample only when it is `lag` old; when the rest ends, it
makes up for what is younger, as motion.
"""

from collections import deque
import math
from typing import NamedTuple

from multiimu_ros.arrays import Vector


class Sample(NamedTuple):
    """One push of a filter: step [s], readings, their noise densities, and two verdicts."""

    dt: float
    angular_rate: Vector
    specific_force: Vector
    rate_density: Vector
    force_density: Vector
    still: bool
    resting: bool


def finite(angular_rate: Vector, specific_force: Vector) -> bool:
    """Say whether all of a reading is finite; one dot product is the quickest way to ask."""
    return math.isfinite(angular_rate.dot(angular_rate) + specific_force.dot(specific_force))


class RestBuffer:
    """A queue that passes motion through and delays rest by `lag` [s]."""

    def __init__(self, lag: float) -> None:
        self._lag = lag
        self._withheld: deque[Sample] = deque()
        self._span = 0.0

    def push(self, sample: Sample) -> list[Sample]:
        """Add the newest sample; return those that a filter is to process now, oldest first."""
        if not sample.resting:
            moving = [late._replace(still=False, resting=False) for late in self._withheld]
            self.clear()
            return [*moving, sample]
        kept = sample._replace(  # the caller may reuse its arrays
            angular_rate=sample.angular_rate.copy(),
            specific_force=sample.specific_force.copy(),
            rate_density=sample.rate_density.copy(),
            force_density=sample.force_density.copy(),
        )
        self._withheld.append(kept)
        self._span += sample.dt
        confirmed = []
        while self._span > self._lag:
            confirmed.append(self._withheld.popleft())
            self._span -= confirmed[-1].dt
        return confirmed

    def clear(self) -> None:
        """Forget what is withheld."""
        self._withheld.clear()
        self._span = 0.0
