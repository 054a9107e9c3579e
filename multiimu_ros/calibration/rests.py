"""Where one IMU rested and how it was turned in between, from sums over tenths of a second.

Samples are summed up in bins of a tenth of a second.  A window of one second is still where

    (var(w) / quiet(w) + var(f) / quiet(f)) / 2 < 40,

`quiet` being the variance of the quietest second so far: no figure of the sensor enters, and no
unit.  Two more conditions keep the least restless second of a restless recording from passing
for rest: the force scatters by less than 2 % of its mean, as a hand's sway of 1 degree does; and
the mean rate is that of the slowest still second, which a turntable at constant rate is not.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, NANOSECONDS, Scalars, Stamps, Vector, Vectors
from multiimu_ros.calibration.coverage import lever_arm_information

BIN_NS = NANOSECONDS // 10  # holds a sample or two of a sensor of 20 Hz
WINDOW = 10  # bins, the shortest rest that is a pose
RESTLESS = 40.0  # times the quietest variance: a pose that is held by hand
SWAY = 0.02  # scatter of the force over its mean
DRIFT = 30.0  # [noises of one sample] by which the rate at rest may differ within a recording
NEW_POSE = np.cos(np.deg2rad(10.0))  # two poses that point up closer than this count once
SOON_NS = 20 * NANOSECONDS  # a longer turn is waving about, or has drifted
HOLE = 3  # bins without samples after which nobody knows how far the board was turned

COUNT, SPAN = 0, 1  # columns of a bin: samples, and the time that they stand for [s]
RATE, FORCE, RATE_SQUARE, FORCE_SQUARE, TURN = (slice(k, k + 3) for k in range(2, 17, 3))
COLUMNS = 17


@dataclass(frozen=True)
class Rests:
    """P still poses of one IMU, in order of time, in the units in which its readings came.

    Parameters
    ----------
    begin_ns, end_ns : (P,) int arrays
        When each begins and ends [ns].
    mean_rate, mean_force : (P, 3) arrays
        Mean readings of each [rad/s], [m/s^2].
    turned : (P, 3) array
        Integral of the rate from the pose before, without what it reads at rest [rad]; NaN for
        the first, and where samples are missing in between.
    """

    begin_ns: Stamps
    end_ns: Stamps
    mean_rate: Vectors
    mean_force: Vectors
    turned: Vectors

    def __len__(self) -> int:
        return len(self.begin_ns)

    @property
    def duration_s(self) -> Scalars:
        """Length of each (P,) [s]."""
        return np.asarray((self.end_ns - self.begin_ns) / NANOSECONDS)

    @property
    def up_s(self) -> Vectors:
        """Direction of the mean force of each (P, 3) in the sensor frame [-]."""
        return np.asarray(self.mean_force / np.linalg.norm(self.mean_force, axis=1, keepdims=True))

    @property
    def turned_soon(self) -> Flags:
        """Say of each (P,) whether how it was turned there is known, and took but 20 s."""
        before_ns = np.r_[self.begin_ns[:1], self.end_ns[:-1]]
        soon = self.begin_ns - before_ns < SOON_NS
        return np.asarray(np.isfinite(self.turned).all(axis=1) & soon)

    @property
    def is_new(self) -> Flags:
        """Say of each (P,) whether it points up at least 10 deg off all new ones before it."""
        up, new = self.up_s, np.zeros(len(self), bool)
        for k in range(len(up)):
            new[k] = not (up[:k][new[:k]] @ up[k] > NEW_POSE).any()
        return new


class Motion:
    """How one IMU rested and moved; made by `PoseTracker.view`.

    Attributes
    ----------
    still : (M,) array
        Whether each bin lies in a still second.
    rests : Rests
        The still poses.
    quiet : (2,) array
        Standard deviation of one axis of rate and force in the quietest second; NaN without one.
    """

    def __init__(self, first_ns: int, numbers: Stamps, rows: Matrix, step: Vector) -> None:
        self._first_ns, self._numbers, self._rows = first_ns, numbers, rows
        self.quiet = np.full(2, np.nan)
        self.still = self._find_still(step)
        self.rests = self._find_rests()

    @property
    def resting(self) -> bool:
        """Whether the last second was still."""
        return bool(len(self.still) and self.still[-1])

    @property
    def rate_hz(self) -> float:
        """Samples per second of the bins that hold any [Hz]."""
        time = self._rows[:, SPAN].sum()
        return float(self._rows[:, COUNT].sum() / time) if time > 0 else float('nan')

    @property
    def noise_density(self) -> Vector:
        """White noise (2,) of rate and force in the quietest second [rad/s, m/s^2 /sqrt(Hz)]."""
        return np.asarray(self.quiet / np.sqrt(self.rate_hz))

    @property
    def mean_rate(self) -> Vectors:
        """Mean angular rate of each bin (M, 3) [rad/s]."""
        return np.asarray(self._rows[:, RATE] / self._rows[:, [COUNT]])

    @property
    def middle_ns(self) -> Stamps:
        """Middle of each bin (M,) [ns]."""
        return self._first_ns + self._numbers * BIN_NS + BIN_NS // 2

    def _find_still(self, step: Vector) -> Flags:
        still = np.zeros(len(self._numbers), bool)
        sums, begins = _windows(self._numbers, self._rows)
        if not len(begins):
            return still
        count = sums[:, [COUNT]]
        rate, force = sums[:, RATE] / count, sums[:, FORCE] / count
        variances = np.stack(
            [
                (sums[:, RATE_SQUARE] / count - rate**2).sum(axis=1),
                (sums[:, FORCE_SQUARE] / count - force**2).sum(axis=1),
            ]
        )
        floors = np.array([_least(v) for v in variances])
        floors = np.maximum(floors, 3 * step**2)[:, np.newaxis]
        self.quiet = np.sqrt(floors[:, 0] / 3)
        with np.errstate(divide='ignore', invalid='ignore'):
            ratio = np.where(variances > floors, variances / floors, 1.0).mean(axis=0)
        sway = np.sqrt(np.maximum(variances[1], 0.0)) < SWAY * np.linalg.norm(force, axis=1)
        quiet = (ratio < RESTLESS) & sway
        if quiet.any():
            speeds = np.where(quiet, np.linalg.norm(rate, axis=1), np.inf)
            drift = np.linalg.norm(rate - rate[np.argmin(speeds)], axis=1)
            quiet &= drift <= DRIFT * np.sqrt(floors[0])
        for offset in range(WINDOW):
            still[begins[quiet] + offset] = True
        return still

    def _find_rests(self) -> Rests:
        numbers, rows = self._numbers, self._rows
        changes = np.diff(np.r_[0, self.still.astype(np.int8), 0])
        begin, end = np.flatnonzero(changes > 0), np.flatnonzero(changes < 0)
        cuts = 1 + np.flatnonzero((np.diff(numbers) > 1) & self.still[:-1] & self.still[1:])
        begin, end = np.sort(np.r_[begin, cuts]), np.sort(np.r_[end, cuts])
        totals = np.vstack([np.zeros(COLUMNS), np.cumsum(rows, axis=0)])
        sums = totals[end] - totals[begin]
        means = sums / sums[:, [COUNT]]
        return Rests(
            self._first_ns + numbers[begin] * BIN_NS,
            self._first_ns + (numbers[end - 1] + 1) * BIN_NS,
            means[:, RATE],
            means[:, FORCE],
            self._turned(begin, end, totals, means[:, RATE]),
        )

    def _turned(self, begin: Stamps, end: Stamps, totals: Matrix, at_rest: Vectors) -> Vectors:
        turned = np.full((len(begin), 3), np.nan)
        holes = np.r_[0, np.cumsum(np.diff(self._numbers) > HOLE)]
        for k in range(1, len(begin)):
            if holes[begin[k]] == holes[end[k - 1] - 1]:
                between = totals[begin[k]] - totals[end[k - 1]]
                bias = (at_rest[k - 1] + at_rest[k]) / 2
                turned[k] = between[TURN] - bias * between[SPAN]
        return turned

    def carried_up(self, unit: float = 1.0, wanted: Flags | None = None) -> Vectors:
        """Return where the up direction of the rest before must lie at each rest (P, 3) [-].

        Parameters
        ----------
        unit : float
            What a reading of 1 is [rad/s].  With the wrong one the directions do not agree with
            `rests.up_s`.
        wanted : (P,) array, optional
            At which rests; the others stay NaN, as does what lies across missing samples.
        """
        rests, up = self.rests, np.full((len(self.rests), 3), np.nan)
        middle = self.middle_ns
        known = np.isfinite(rests.turned).all(axis=1)
        for k in np.flatnonzero(known if wanted is None else known & wanted):
            inside = (middle > rests.end_ns[k - 1]) & (middle < rests.begin_ns[k])
            bias = (rests.mean_rate[k - 1] + rests.mean_rate[k]) / 2
            turns = self._rows[inside, TURN] - self._rows[inside, SPAN][:, np.newaxis] * bias
            up[k] = _product(unit * turns).inv().apply(rests.up_s[k - 1])
        return up

    def waving_s(self, slow: float = 0.5) -> float:
        """Return for how long it turned faster than `slow` [rad/s] [s]."""
        fast = np.linalg.norm(self.mean_rate, axis=1) > slow
        return float(self._rows[fast & ~self.still, SPAN].sum())

    def accelerations(self, unit: float = 1.0) -> tuple[Vectors, Vectors, Scalars]:
        """Return angular rate, angular acceleration and time of the bins in motion.

        From central differences of bins: what is faster than some 2 Hz comes out too small.

        Returns
        -------
        rate, acceleration : (Q, 3) arrays
            In the sensor frame [rad/s], [rad/s^2].
        dt : (Q,) array
            Time that each stands for [s].
        """
        rate, dt = unit * self.mean_rate, self._rows[:, SPAN]
        inner = np.arange(1, max(len(rate) - 1, 1))
        inner = inner[
            (self._numbers[inner + 1] - self._numbers[inner - 1] == 2) & ~self.still[inner]
        ]
        slope = (rate[inner + 1] - rate[inner - 1]) / (2 * BIN_NS / NANOSECONDS)
        return rate[inner], slope, dt[inner]

    def lever_arm_information(self, unit: float = 1.0) -> Matrix:
        """Return the integral of L'L over the motion (3, 3) [1/s^3]; see `coverage`."""
        return lever_arm_information(*self.accelerations(unit))


def _windows(numbers: Stamps, rows: Matrix) -> tuple[Matrix, Stamps]:
    """Return the sums over each full second (W, COLUMNS), and its first bin (W,)."""
    if len(numbers) < WINDOW:
        return np.zeros((0, COLUMNS)), np.zeros(0, np.int64)
    full = np.flatnonzero(numbers[WINDOW - 1 :] - numbers[: 1 - WINDOW] == WINDOW - 1)
    sums = np.lib.stride_tricks.sliding_window_view(rows, WINDOW, axis=0).sum(axis=-1)
    return sums[full], full


def _least(variances: Scalars) -> float:
    """Return the least variance; one of exactly 0 is a sensor that hangs, if another is not."""
    some = variances[variances > 0.0]
    return float(some.min()) if len(some) else 0.0


def _product(turns: Vectors) -> Rotation:
    """Return the rotation that small body turns (M, 3) make up, one after the other [rad]."""
    steps = Rotation.from_rotvec(np.vstack([turns, np.zeros((1, 3))]))
    while len(steps) > 1:
        if len(steps) % 2:
            steps = Rotation.concatenate([steps, Rotation.identity(1)])
        steps = steps[0::2] * steps[1::2]
    return steps[0]
