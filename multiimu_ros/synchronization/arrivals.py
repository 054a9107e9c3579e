"""Samples as they came, one after the other, for filters that need no common instant.

The synchroniser decides which samples are sound and when an instant is due; from its rings the
cursors here take all that happened up to that instant, in the order of their stamps.  At one stamp
the lower stream goes first.  So the order is that of the stamps, whatever the topics did.

A sample that comes in after the scan of its instant, as from a stream that was given up and is
back, is dropped and counted: the filter has been there, and time does not go backwards.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Stamps, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.synchronization.streams import NEVER, RING, WRITTEN

CURSOR_COLUMNS = 3
TAKEN, LATE, OVERRUN = range(CURSOR_COLUMNS)  # samples passed; of them dropped, for which reason


class Arrivals(NamedTuple):
    """Samples of several streams in the order of their stamps.

    Parameters
    ----------
    stamps : (M,) int array
        Their instants [ns].
    streams : (M,) int array
        Which stream each is of.
    values : (M, 6) array
        Angular rate [rad/s] and specific force [m/s^2], calibrated and mounted.
    """

    stamps: Stamps
    streams: Stamps
    values: Vectors


class ArrivalCursors:
    """How far each of `count` rings has been read."""

    def __init__(self, count: int) -> None:
        self._cursors = np.zeros((count, CURSOR_COLUMNS), np.int64)
        self._frontier = NEVER  # up to where samples have been handed out

    @property
    def late(self) -> Stamps:
        """How many samples (K,) were dropped, for their instant was over."""
        return self._cursors[:, LATE].copy()

    @property
    def overrun(self) -> Stamps:
        """How many samples (K,) nobody asked for before the ring went over them."""
        return self._cursors[:, OVERRUN].copy()

    def restart(self) -> None:
        """Go back to the start of rings that have been emptied; keep the counters."""
        self._cursors[:, TAKEN] = 0
        self._frontier = NEVER

    def take(self, stamps: Stamps, values: Vectors, table: Stamps, until_ns: int) -> Arrivals:
        """Return what the rings hold up to `until_ns` and nobody has taken.

        Parameters
        ----------
        stamps, values, table : (K, RING), (K, RING, 6), (K, COLUMNS) arrays
            Those of `streams.Streams`.
        until_ns : int
            The last scan, or an earlier one [ns].
        """
        taken = take_arrivals(stamps, values, table, self._cursors, self._frontier, until_ns)
        self._frontier = max(self._frontier, until_ns)
        return Arrivals(*taken)


@compiled
def take_arrivals(
    stamps: Stamps,
    values: Vectors,
    table: Stamps,
    cursors: Stamps,
    frontier: int,
    until: int,
) -> tuple[Stamps, Stamps, Vectors]:
    """Move the cursors to the first samples after `until`, and merge what they pass."""
    count = len(table)
    ends = np.empty(count, np.int64)
    total = 0
    for k in range(count):
        ends[k] = _pass_over(stamps[k], table[k], cursors[k], frontier, until)
        total += ends[k] - cursors[k, TAKEN]
    instants, streams = np.empty(total, np.int64), np.empty(total, np.int64)
    readings = np.empty((total, 6))
    for m in range(total):
        first, earliest = -1, 0
        for k in range(count):
            if cursors[k, TAKEN] < ends[k]:
                stamp = stamps[k, cursors[k, TAKEN] % RING]
                if first < 0 or stamp < earliest:
                    first, earliest = k, stamp
        instants[m], streams[m] = earliest, first
        slot = cursors[first, TAKEN] % RING
        for axis in range(6):
            readings[m, axis] = values[first, slot, axis]
        cursors[first, TAKEN] += 1
    return instants, streams, readings


@compiled
def _pass_over(stamps: Stamps, row: Stamps, cursor: Stamps, frontier: int, until: int) -> int:
    """Drop what was overwritten or is late; return where the samples up to `until` end."""
    oldest = row[WRITTEN] - RING
    if cursor[TAKEN] < oldest:
        cursor[OVERRUN] += oldest - cursor[TAKEN]
        cursor[TAKEN] = oldest
    while cursor[TAKEN] < row[WRITTEN] and stamps[cursor[TAKEN] % RING] <= frontier:
        cursor[LATE] += 1
        cursor[TAKEN] += 1
    end = cursor[TAKEN]
    while end < row[WRITTEN] and stamps[end % RING] <= until:
        end += 1
    return int(end)
