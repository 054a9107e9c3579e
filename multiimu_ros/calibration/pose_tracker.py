"""Follow one IMU through a recording: at the desk in blocks, live in handfuls of samples.

Samples are only summed up, in bins of a tenth of a second; what they say (`rests`) follows from
all bins so far, so that it does not depend on how the samples came.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, NANOSECONDS, Stamps, Vector
from multiimu_ros.calibration.rests import BIN_NS, COLUMNS, HOLE, Motion
from multiimu_ros.samples import ImuSamples


class PoseTracker:
    """Take samples of one IMU; tell where it rested and how it was turned.

    Attributes
    ----------
    count : int
        Samples so far whose stamps went forward and whose readings were finite.
    """

    def __init__(self) -> None:
        self.count = 0
        self._first_ns = 0
        self._last: Vector | None = None  # stamp [s], rate, force of the last sample
        self._step = np.full(2, np.inf)  # smallest change seen: of a rate, of a force
        self._numbers: list[Stamps] = []
        self._rows: list[Matrix] = []
        self._open = (-1, np.zeros(COLUMNS))  # the bin that may still grow

    def push(self, samples: ImuSamples) -> None:
        """Take the next N samples; those that go back in time or are not finite are left out."""
        readings = np.hstack([samples.angular_rate, samples.specific_force])
        newest = np.maximum.accumulate(np.r_[self._newest_ns(), samples.stamp_ns])[:-1]
        good = (samples.stamp_ns > newest) & np.isfinite(readings).all(axis=1)
        if not good.any():
            return
        stamp_ns = samples.stamp_ns[good]
        if self._last is None:
            self._first_ns = int(stamp_ns[0])
        since_ns = stamp_ns - self._first_ns
        self._add(since_ns, np.column_stack([since_ns / NANOSECONDS, readings[good]]))

    def _newest_ns(self) -> int:
        if self._last is None:
            return -1
        return self._first_ns + round(float(self._last[0]) * NANOSECONDS)

    def _add(self, since_ns: Stamps, lines: Matrix) -> None:
        """Sum lines of time [s], rate and force (N, 7) up into bins."""
        first = lines[0] if self._last is None else self._last
        steps = np.diff(np.vstack([first, lines]), axis=0)
        self._last = lines[-1]
        self.count += len(lines)
        self._note_steps(steps)
        # A bin's worth of time without a sample is a hole, which nobody can integrate across.
        dt = np.where(steps[:, 0] < HOLE * BIN_NS / NANOSECONDS, steps[:, 0], 0.0)
        readings = lines[:, 1:]
        middle = readings[:, :3] - 0.5 * steps[:, 1:4]  # trapezoid rule
        turn = dt[:, np.newaxis] * middle
        rows = np.column_stack([np.ones(len(dt)), dt, readings, readings**2, turn])
        numbers = since_ns // BIN_NS
        begins = np.flatnonzero(np.r_[True, np.diff(numbers) > 0])
        bins, sums = numbers[begins], np.add.reduceat(rows, begins, axis=0)
        open_number, open_row = self._open
        if open_number == bins[0]:
            sums[0] += open_row
        elif open_number >= 0:
            bins, sums = np.r_[open_number, bins], np.vstack([open_row, sums])
        self._open = int(bins[-1]), sums[-1]
        self._numbers.append(bins[:-1])
        self._rows.append(sums[:-1])

    def _note_steps(self, steps: Matrix) -> None:
        """Learn the quantisation: a sensor that rests within one step still has noise."""
        for k, part in enumerate((steps[:, 1:4], steps[:, 4:])):
            changes = np.abs(part[part != 0.0])
            self._step[k] = min(self._step[k], changes.min(initial=np.inf))

    def view(self) -> Motion:
        """Return what all samples so far say; the newest tenth of a second is not yet in it."""
        self._numbers = [np.concatenate([np.zeros(0, np.int64), *self._numbers])]
        self._rows = [np.vstack([np.zeros((0, COLUMNS)), *self._rows])]
        step = np.where(np.isfinite(self._step), self._step, 0.0)
        return Motion(self._first_ns, self._numbers[0], self._rows[0], step)
