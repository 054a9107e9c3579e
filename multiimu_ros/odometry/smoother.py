"""Offline odometry: a Rauch-Tung-Striebel smoother over the error-state filter.

A filter knows the past; a recording also has a future.  The forward pass is the filter of
`error_state.py`, with its own kernels; the backward pass takes what later samples told about the
error back through each step [1]_.  Between two stances, where the filter drifts and then jumps,
the smoothed path is smooth; at the last sample the two agree.  Equations:
docs/derivations/smoother.md.

Nobody looks on offline, so two things that the live filter does for an onlooker fall away: a
rest may correct the position, and the end of a rest is known.

The forward pass of an hour would fill gigabytes.  It is therefore run once to place a mark every
`SEGMENT` samples, and run again from mark to mark, with the same numbers, wherever its details
are needed.

.. [1] H. E. Rauch, F. Tung, C. T. Striebel, "Maximum likelihood estimates of linear dynamic
   systems", AIAA Journal 3(8), 1965.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import as_vectors, Flags, Matrix, Scalars, Stamps, Vector, Vectors
from multiimu_ros.odometry.attitude import GAP, OUTAGE
from multiimu_ros.odometry.error_state import ErrorStateConfig, ErrorStateFilter
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.smoother_kernels import run_backward, run_forward, see_position

LOSS = 1.5  # of the median step: a longer one lacks a sample
SEGMENT = 512  # samples between two marks: 4 MB of details

Mark = tuple[Vector, Matrix, Matrix, Vector]  # filtered x, R, P, memory where a segment begins
End = tuple[Vector, Matrix, Matrix]  # smoothed x, R, P where a segment ends
Tape = tuple[Matrix, Matrix, Matrix]  # what `run_forward` notes, or `run_backward` fills


@dataclass(frozen=True, kw_only=True)
class Recording:
    """N samples of one (virtual) IMU and what the zero-velocity detector said of them.

    Parameters
    ----------
    dt : (N,) array
        Time since the previous sample, above zero [s]; the first one does not matter.
    angular_rate, specific_force : (N, 3) arrays
        Readings [rad/s], [m/s^2]; rows that are not finite are bridged.
    rate_density, force_density : (N, 3) arrays
        White noise of these readings [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    still, resting : (N,) bool arrays
        What the detector said.
    """

    dt: Scalars
    angular_rate: Vectors
    specific_force: Vectors
    rate_density: Vectors
    force_density: Vectors
    still: Flags
    resting: Flags

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if len(value) != len(self.dt) or not len(value):
                msg = f'`{name}` must have {max(1, len(self.dt))} rows as `dt`, got {len(value)}.'
                raise ValueError(msg)
        for name in ('angular_rate', 'specific_force', 'rate_density', 'force_density'):
            as_vectors(getattr(self, name), name)
        if not np.all(np.asarray(self.dt[1:]) > 0):  # also catches NaN
            msg = f'`dt` must be positive, got {np.min(self.dt[1:])}.'
            raise ValueError(msg)


@dataclass(frozen=True)
class Smoothed:
    """The smoothed odometry at M consecutive samples.

    Parameters
    ----------
    rows : (M,) int array
        Index of each in the recording; samples that were not finite are left out.
    state : (M, 15) array
        Position [m], velocity [m/s], (unused), gyro bias [rad/s], accel bias [m/s^2]; origin and
        yaw are those of the first sample.
    R_nb : (M, 3, 3) array
        Attitude: rotates body into local level vectors.
    P : (M, 15, 15) array
        Covariance of position, velocity, attitude (body axes), gyro bias, accel bias.
    """

    rows: Stamps
    state: Vectors
    R_nb: Matrix
    P: Matrix

    @property
    def position_n(self) -> Vectors:
        """Position (M, 3), local level frame [m]."""
        return self.state[:, 0:3]

    @property
    def velocity_n(self) -> Vectors:
        """Velocity (M, 3), local level frame [m/s]."""
        return self.state[:, 3:6]

    @property
    def gyro_bias(self) -> Vectors:
        """Gyro bias (M, 3) [rad/s]."""
        return self.state[:, 9:12]

    @property
    def accel_bias(self) -> Vectors:
        """Accelerometer bias (M, 3) [m/s^2]."""
        return self.state[:, 12:15]


def believe_rest(dt: Scalars, still: Flags, resting: Flags, lag: float) -> Flags:
    """Return (N, 2) flags still, resting, without the last `lag` [s] of each rest.

    A detector needs some samples to notice that a rest has ended; they are motion, as
    `RestBuffer` has it.  What rested up to a hole in the data has rested.
    """
    flags = np.column_stack((still, resting))
    elapsed = np.concatenate(([0.0], np.cumsum(dt)))
    for end in np.flatnonzero(resting[:-1] & ~resting[1:] & (dt[1:] <= OUTAGE)):
        late = slice(int(np.searchsorted(elapsed, elapsed[end + 1] - lag)), int(end) + 1)
        flags[late][resting[late]] = False
    return flags


def admit_losses(
    dt: Scalars, rate_density: Vectors, force_density: Vectors, config: ErrorStateConfig
) -> tuple[Vectors, Vectors]:
    """Return the densities, larger where samples are missing (smoother.md (8)).

    The live filter admits to gaps above `GAP`, as it does not know when a sample was due.  In a
    recording the median step tells: lost in mid-swing, even one sample hides a heel strike.
    """
    due = float(np.median(dt))
    hidden = np.where(dt > LOSS * due, np.minimum(dt, GAP) - due, 0.0)
    spread = (np.square(np.maximum(hidden, 0.0)) / dt)[:, np.newaxis]
    return (
        np.sqrt(rate_density**2 + config.motion_rate_sigma**2 * spread),
        np.sqrt(force_density**2 + config.motion_sigma**2 * spread),
    )


class Closure(NamedTuple):
    """How far from its start a recording ended that is said to be closed.

    Parameters
    ----------
    gap : float
        Distance, before that was used [m].
    surprise : float
        Its rms over the three axes in standard deviations, those of the filter and of what was
        said together; about 1 if both are right.
    """

    gap: float
    surprise: float


class Smoother:
    """The two passes over one recording without jumps in time.

    Parameters
    ----------
    config : ErrorStateConfig
        That of the live filter.
    recording : Recording
        What to smooth.
    closed_sigma : float, optional
        The rig ended where it began, to this distance along each axis [m].

    Attributes
    ----------
    closure : Closure or None
        Whether that may be true; None where it was not said, or not solved yet.
    """

    def __init__(
        self, config: ErrorStateConfig, recording: Recording, closed_sigma: float | None = None
    ) -> None:
        columns = list(vars(recording).values())
        readings = np.hstack(columns[1:5])
        self._rows = np.flatnonzero(np.isfinite(readings).all(axis=1))
        if not len(self._rows):
            msg = 'No sample of the recording is finite.'
            raise ValueError(msg)
        elapsed = np.cumsum(recording.dt)[self._rows]
        self._steps = np.concatenate((recording.dt[:1], np.diff(elapsed)))
        self._readings = readings[self._rows]
        densities = self._readings[:, 6:9], self._readings[:, 9:12]
        self._readings[:, 6:] = np.hstack(admit_losses(self._steps, *densities, config))
        still, resting = recording.still[self._rows], recording.resting[self._rows]
        self._flags = believe_rest(self._steps, still, resting, config.resting_lag)
        self._closed_sigma = closed_sigma
        self.closure: Closure | None = None
        self._settings, first = _start(config, self._sample(0))
        self._marks = [first]
        self._ends: list[End] = []

    @property
    def segments(self) -> int:
        """How many steps each pass has."""
        return max(1, -(-(len(self._rows) - 1) // SEGMENT))

    def _sample(self, k: int) -> Sample:
        parts = self._readings[k].reshape(4, 3)
        return Sample(float(self._steps[k]), *parts, *map(bool, self._flags[k]))

    def solve(self) -> Iterator[None]:
        """Run forward and back once; yields after each of 2 * `segments` pieces of work."""
        self._marks[1:] = []
        for segment in range(self.segments):
            self._marks.append(self._forward(segment)[0])
            yield
        x, R, P = (array.copy() for array in self._marks[-1][:3])
        if self._closed_sigma is not None:
            variance = self._closed_sigma**2
            self.closure = _closure(x[:3], P[:3, :3] + variance * np.eye(3))
            see_position(x, R, P, np.zeros(3), variance)
        ends: list[End] = []
        for segment in reversed(range(self.segments)):
            ends.append((x.copy(), R.copy(), P.copy()))
            self._backward(segment, x, R, P)
            yield
        self._ends = ends[::-1]

    def blocks(self) -> Iterator[Smoothed]:
        """Yield the smoothed samples in order, one block per segment; solves where still due."""
        if not self._ends:
            for _ in self.solve():
                pass
        for segment, end in enumerate(self._ends):
            x, R, P = (array.copy() for array in end)
            out = self._backward(segment, x, R, P)
            first = segment * SEGMENT
            last = len(out[0]) if segment == self.segments - 1 else SEGMENT
            rows = self._rows[first : first + last]
            yield Smoothed(rows, *(array[:last] for array in out))

    def _forward(self, segment: int) -> tuple[Mark, Tape]:
        """Filter one segment; return the state after it, and the tape."""
        x, R, P, memory = (array.copy() for array in self._marks[segment])
        part = slice(segment * SEGMENT + 1, (segment + 1) * SEGMENT + 1)
        steps, readings, flags = self._steps[part], self._readings[part], self._flags[part]
        n = len(steps)
        tape = np.empty((n, 2, 15)), np.empty((n, 2, 3, 3)), np.empty((n, 4, 15, 15))
        run_forward(x, R, P, memory, self._settings, steps, readings, flags, *tape)
        return (x, R, P, memory), tape

    def _backward(self, segment: int, x: Vector, R: Matrix, P: Matrix) -> Tape:
        """Smooth one segment; x, R and P come from its end and are taken to its start."""
        _, tape = self._forward(segment)
        n = len(tape[0]) + 1
        out = np.empty((n, 15)), np.empty((n, 3, 3)), np.empty((n, 15, 15))
        run_backward(x, R, P, *tape, *out)
        return out


def _closure(gap: Vector, covariance: Matrix) -> Closure:
    square = float(gap @ np.linalg.solve(covariance, gap))
    return Closure(float(np.linalg.norm(gap)), float(np.sqrt(square / 3)))


def _start(config: ErrorStateConfig, sample: Sample) -> tuple[Vector, Mark]:
    """Return the filter's settings, and its x, R, P and memory after the first sample."""
    filter_ = ErrorStateFilter(config)
    filter_.step(sample)
    x, R, P, memory, settings = filter_.arrays
    return settings, (x, R, P, memory)


def smooth(
    config: ErrorStateConfig, recording: Recording, closed_sigma: float | None = None
) -> Smoothed:
    """Smooth a recording that is short enough for all covariances to be kept (2 kB a sample)."""
    blocks = list(Smoother(config, recording, closed_sigma).blocks())
    columns = zip(*((b.rows, b.state, b.R_nb, b.P) for b in blocks), strict=True)
    return Smoothed(*map(np.concatenate, columns))
