"""Samples of a resting rig, withheld until later samples confirm the rest.

A detector needs some samples to notice that a rest has ended; the first samples of the motion
would be taken for bias and the first of the turn would be lost.  So a filter holds its state
through a rest and learns from each sample only when it is `lag` old; when the rest ends, it
makes up for what is younger, as motion; but what rested up to a hole in the data has rested.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude_steps import OUTAGE

CAPACITY = 1024  # samples withheld at most: a quarter of a second at 4 kHz
# Columns of a row: the fields of `Sample`.
DT, STILL, RESTING, COLUMNS = 0, 13, 14, 15
# Fields of the clock: rows withheld, the oldest of them; their time, that of readings that were
# not finite, and the lag [s].
COUNT, OLDEST, SPAN, SKIPPED, LAG = range(5)


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


@compiled
def withhold(ring: Matrix, clock: Vector, row: Vector, ready: Matrix) -> int:
    """Add the newest sample; put those that a filter is to process now into `ready`.

    Parameters
    ----------
    ring : (CAPACITY, COLUMNS) array
        Samples withheld.
    clock : (5,) array
        See COUNT.
    row : (COLUMNS,) array
        The newest sample; may change.
    ready : (CAPACITY + 1, COLUMNS) array
        Filled with the samples to process, oldest first.

    Returns
    -------
    int
        How many these are.
    """
    if not np.isfinite(np.sum(row[1:7])):
        clock[SKIPPED] += row[DT]
        return 0
    row[DT] += clock[SKIPPED]
    clock[SKIPPED] = 0.0
    made = 0
    if row[RESTING] > 0.0:
        newest = (int(clock[OLDEST]) + int(clock[COUNT])) % CAPACITY
        ring[newest] = row
        clock[COUNT] += 1.0
        clock[SPAN] += row[DT]
        while clock[COUNT] > 0.0 and (clock[SPAN] > clock[LAG] or clock[COUNT] == CAPACITY):
            _release(ring, clock, ready[made])
            made += 1
        return made
    while clock[COUNT] > 0.0:
        _release(ring, clock, ready[made])
        if row[DT] <= OUTAGE:  # what ended in a hole, or beyond it, rested up to the hole
            ready[made, STILL] = ready[made, RESTING] = 0.0
        made += 1
    clock[SPAN] = 0.0  # no rounding from one rest to the next
    ready[made] = row
    return made + 1


@compiled
def _release(ring: Matrix, clock: Vector, out: Vector) -> None:
    """Move the oldest sample out."""
    oldest = int(clock[OLDEST])
    clock[OLDEST] = (oldest + 1) % CAPACITY
    clock[COUNT] -= 1.0
    clock[SPAN] -= ring[oldest, DT]
    out[:] = ring[oldest]


class RestBuffer:
    """A queue that passes motion through and delays rest by `lag` [s].

    Attributes
    ----------
    arrays : tuple of arrays
        `ring`, `clock`, `ready` of `withhold`.
    """

    def __init__(self, lag: float) -> None:
        self.arrays = (
            np.zeros((CAPACITY, COLUMNS)),
            np.array([0.0, 0.0, 0.0, 0.0, lag]),
            np.zeros((CAPACITY + 1, COLUMNS)),
        )

    def push(self, sample: Sample) -> list[Sample]:
        """Add the newest sample; return those that a filter is to process now, oldest first."""
        ring, clock, ready = self.arrays
        row = np.hstack(sample)
        made = withhold(ring, clock, row, ready)
        return [
            Sample(row[0], row[1:4], row[4:7], row[7:10], row[10:13], bool(row[13]), bool(row[14]))
            for row in ready[:made].copy()
        ]

    def clear(self) -> None:
        """Forget what is withheld."""
        self.arrays[1][:LAG] = 0.0
