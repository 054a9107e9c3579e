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
    """One sample of an IMU, as the filters take it.

    Parameters
    ----------
    dt : float
        Time since the previous sample, above zero [s].
    angular_rate, specific_force : (3,) arrays
        Readings [rad/s], [m/s^2]; where they are not finite the sample is bridged.
    rate_density, force_density : (3,) arrays
        White noise of these readings [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    still, resting : bool
        What the zero-velocity detector says.
    """

    dt: float
    angular_rate: Vector
    specific_force: Vector
    rate_density: Vector
    force_density: Vector
    still: bool
    resting: bool


class RestBuffer:
    """A queue that passes motion through and delays rest by `lag` [s]."""

    def __init__(self, lag: float) -> None:
        self._lag = lag
        self._withheld: deque[Sample] = deque()
        self._span = 0.0
        self._skipped = 0.0  # [s] time of readings that were not finite

    def push(self, sample: Sample) -> list[Sample]:
        """Add the newest sample; return those that a filter is to process now, oldest first."""
        rate, force = sample.angular_rate, sample.specific_force
        if not math.isfinite(rate.dot(rate) + force.dot(force)):  # the quickest way to ask
            self._skipped += sample.dt
            return []
        if self._skipped:
            sample = sample._replace(dt=sample.dt + self._skipped)
            self._skipped = 0.0
        if not sample.resting:
            if not self._withheld:
                return [sample]
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
        self._span = self._skipped = 0.0
