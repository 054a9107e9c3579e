"""How far estimates are from the truth, and the table that sets them side by side.

Rate and force are scored per axis, attitude as the angle and position as the distance between
estimate and truth, all as root mean squares over the same instants.  No IMU can see north or its
own place, so yaw and origin are aligned to the truth over the first second of a track.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, NANOSECONDS, Stamps, Vectors
from multiimu_ros.report.tracks import Track
from multiimu_ros.report.truth import Truth
from multiimu_ros.rig import NOMINAL_NOISE, Rig

ALIGNED_OVER = NANOSECONDS  # [ns] from the first stamp


@dataclass(frozen=True)
class Errors:
    """Estimate minus truth at N instants.

    Parameters
    ----------
    stamp_ns : (N,) int array
        Instants [ns].
    angular_rate, specific_force : (N, 3) arrays
        [rad/s], [m/s^2].
    attitude_n : (N, 3) array
        Rotation vector about the fixed axes, after the yaw is aligned [rad].
    position_n : (N, 3) array
        After yaw and origin are aligned [m].
    """

    stamp_ns: Stamps
    angular_rate: Vectors
    specific_force: Vectors
    attitude_n: Vectors
    position_n: Vectors

    def after(self, stamp_ns: int) -> 'Errors':
        """Return the part from an instant on."""
        kept = self.stamp_ns >= stamp_ns
        return Errors(*(column[kept] for column in vars(self).values()))


@dataclass(frozen=True)
class Quantity:
    """One row of the table: how its errors are named, and shown to people."""

    key: str
    name: str
    unit: str
    per_si: float
    per_axis: bool

    def rms(self, errors: Errors) -> float:
        """Return the root mean square in SI, of one axis or of the vector's length."""
        square = np.square(getattr(errors, self.key))
        return float(np.sqrt(square.mean() if self.per_axis else square.sum(axis=1).mean()))


QUANTITIES = (
    Quantity('angular_rate', 'angular rate', 'mdeg/s', 1e3 * 180 / np.pi, per_axis=True),
    Quantity('specific_force', 'specific force', 'mm/s²', 1e3, per_axis=True),
    Quantity('attitude_n', 'attitude', 'mdeg', 1e3 * 180 / np.pi, per_axis=False),
    Quantity('position_n', 'position', 'mm', 1e3, per_axis=False),
)
MUST_WIN = ('angular_rate', 'specific_force', 'attitude_n')


def _yaw_between(R_true: Matrix, R_estimated: Matrix) -> Matrix:
    """Return the rotation (3, 3) about the vertical that best maps estimate to truth."""
    C = np.einsum('nij,nkj->ik', R_true, R_estimated)
    yaw = np.arctan2(C[1, 0] - C[0, 1], C[0, 0] + C[1, 1])
    return np.asarray(Rotation.from_euler('z', yaw).as_matrix())


def aligned_position(track: Track, truth: Truth) -> Vectors:
    """Return the positions (N, 3) of `track` in the truth's frame [m]."""
    start = track.stamp_ns < track.stamp_ns[0] + ALIGNED_OVER
    turn = _yaw_between(truth.R_nb[start], track.odom_R_nb[start])
    moved = (track.position_n - track.position_n[start].mean(axis=0)) @ turn.T
    return np.asarray(moved + truth.position_n[start].mean(axis=0))


def errors_of(track: Track, truth: Truth) -> Errors:
    """Compare a track with the truth at its own stamps (see `Truth.at`)."""
    start = track.stamp_ns < track.stamp_ns[0] + ALIGNED_OVER
    R_nb = _yaw_between(truth.R_nb[start], track.R_nb[start]) @ track.R_nb
    return Errors(
        track.stamp_ns,
        track.angular_rate - truth.angular_rate,
        track.specific_force - truth.specific_force,
        Rotation.from_matrix(R_nb @ np.swapaxes(truth.R_nb, 1, 2)).as_rotvec(),
        aligned_position(track, truth) - truth.position_n,
    )


@dataclass(frozen=True)
class Row:
    """One quantity, root mean square errors in SI; `best` is chosen with hindsight.

    Parameters
    ----------
    quantity : Quantity
        What, and how to show it.
    best, best_imu : float, str
        Least error among the single IMUs, and whose.
    mean, fused : float
        Plain mean and fused array.
    ideal : float
        1/sqrt(K) of one IMU's: of its noise in the rig file for rate and force, of the single
        IMUs' rms for attitude and position.
    """

    quantity: Quantity
    best: float
    best_imu: str
    mean: float
    fused: float
    ideal: float

    @property
    def gain(self) -> float:
        """How many times the fused error fits into the best single one."""
        return self.best / self.fused


def compare(
    singles: Mapping[str, Errors], mean: Errors, fused: Errors, noise: Mapping[str, float]
) -> tuple[Row, ...]:
    """Set single IMUs, plain mean and fused array side by side, one row per quantity.

    Parameters
    ----------
    singles : mapping
        Errors of each IMU alone, by name.
    mean, fused : Errors
        Of the plain mean and the array.
    noise : mapping
        White noise of one sample of one IMU by key of quantity, where there is such a thing.
    """
    rows = []
    for quantity in QUANTITIES:
        each = {name: quantity.rms(errors) for name, errors in singles.items()}
        best = min(each, key=lambda name: each[name])
        typical = noise.get(quantity.key, float(np.sqrt(np.mean(np.square(list(each.values()))))))
        ideal = typical / float(np.sqrt(len(each)))
        rows.append(
            Row(quantity, each[best], best, quantity.rms(mean), quantity.rms(fused), ideal)
        )
    return tuple(rows)


def noise_of_one_sample(rig: Rig, rate_hz: float) -> dict[str, float]:
    """Return the white noise of one reading of one IMU, rms over the rig, in SI."""
    noises = [imu.noise or NOMINAL_NOISE for imu in rig.imus]
    return {
        key: float(
            np.sqrt(rate_hz * np.mean(np.square([getattr(n.noise_density, t) for n in noises])))
        )
        for key, t in (('angular_rate', 'gyroscope'), ('specific_force', 'accelerometer'))
    }


def not_won(rows: Sequence[Row]) -> tuple[str, ...]:
    """Name the quantities in which the array must beat the best single IMU, and does not."""
    return tuple(
        row.quantity.name
        for row in rows
        if row.quantity.key in MUST_WIN and not row.fused < row.best  # NaN loses, too
    )


def as_json(rows: Sequence[Row]) -> dict[str, dict[str, float | str]]:
    """Return the table in SI, for machines."""
    return {
        row.quantity.key: {
            'best_single': row.best,
            'best_imu': row.best_imu,
            'mean': row.mean,
            'fused': row.fused,
            'ideal': row.ideal,
        }
        for row in rows
    }
