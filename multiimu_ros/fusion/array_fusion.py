"""Scans of K registered IMUs to one angular rate and one specific force, with honest variances.

Per scan: the federated filter fuses the rates; their slope is the angular acceleration; the lever
arms are taken out of the forces; the federated filter fuses those.

Alignment keeps the fused values where they are when an IMU leaves or returns; see `fuse_scan`.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Scalars, Vector, Vectors
from multiimu_ros.fusion.fuse_scan import fuse_scan_door, FusionState, SUMS
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.rigid_body import HISTORY
from multiimu_ros.synchronization.synchronizer import Scan


@dataclass(frozen=True, kw_only=True)
class ArrayFusionConfig:
    """How the rig may move between two scans: the process noise of the common state.

    Parameters
    ----------
    angular_acceleration_sigma : float
        Typical angular acceleration [rad/s^2].
    jerk_sigma : float
        Typical change of specific force [m/s^3].
    """

    angular_acceleration_sigma: float
    jerk_sigma: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:  # also catches NaN
                msg = f'`{name}` must be positive, got {value}.'
                raise ValueError(msg)


@dataclass(frozen=True)
class FusedImu:
    """One reading of the virtual IMU at the base origin.

    Parameters
    ----------
    stamp_ns : int
        Instant of the measurement [ns].
    table : (4, 6) array
        Columns are angular rate, then specific force; the rows are the properties below.
    weights : (K,) array
        Mean share of each IMU in the fused rate, 0 for those left out [-].
    """

    stamp_ns: int
    table: Vectors
    weights: Scalars

    @property
    def values(self) -> Vector:
        """Angular rate [rad/s] and specific force [m/s^2], (6,)."""
        row: Vector = self.table[0]
        return row

    @property
    def variance(self) -> Vector:
        """Variance (6,) of the values, without that of the common bias."""
        row: Vector = self.table[1]
        return row

    @property
    def bias_variance(self) -> Vector:
        """Prior variance (6,) of the common bias."""
        row: Vector = self.table[2]
        return row

    @property
    def density(self) -> Vector:
        """White noise density (6,) [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)]."""
        row: Vector = self.table[3]
        return row


class ArrayFusion:
    """The fusion stage on a live stream of scans.

    Parameters
    ----------
    model : RigModel
        Noise, uncertainty and lever arm of every IMU, in the base frame.
    config : ArrayFusionConfig
        Process noise.
    """

    def __init__(self, model: RigModel, config: ArrayFusionConfig) -> None:
        self._motion = np.repeat([config.angular_acceleration_sigma, config.jerk_sigma], 3)
        count = len(model.density)
        self._state = FusionState(
            np.zeros((2, 6)), np.zeros((count, 6)), np.zeros((count + 1, 9)),
            np.zeros(HISTORY, np.int64), np.zeros((HISTORY, 3)), np.zeros(1, np.int64),
            np.zeros(1),
        )  # fmt: skip
        self._memory = (*model, *self._state)
        self.restart()

    def restart(self) -> None:
        """Forget the motion (time jumped); keep the alignment of the IMUs."""
        self._state.fused[0] = 0.0
        self._state.fused[1] = np.inf
        self._state.scans[0] = 0
        self._state.period[0] = 0.0
        self.block[:] = 0.0

    @property
    def offsets(self) -> Vectors:
        """Bias of each IMU (K, 6) relative to the fused one [rad/s], [m/s^2]."""
        return self._state.offsets.copy()

    @property
    def block(self) -> Vectors:
        """Sums (K + 1, 7) over the scans since somebody emptied it, for `DriftMonitor`.

        Row i: the readings of IMU i without their lever arm, and the scans in which it was fully
        trusted; last row: the fused values, and all scans.
        """
        return self._state.tally[:, SUMS:]

    def push(self, scan: Scan) -> FusedImu | None:
        """Fuse one scan; None if no IMU can be trusted in it."""
        out, weights = fuse_scan_door(
            *self._memory, self._motion, scan.stamp_ns,
            scan.values, scan.share, scan.noise_gain,
        )  # fmt: skip
        if np.isnan(out[0, 0]):
            return None
        return FusedImu(scan.stamp_ns, out, weights)
