"""What the joint fit knows of one IMU: its share of the recording, and its 33 unknowns.

The columns, in this order: accelerometer scale (3), shear (3), bias (3); gyroscope E (9, row by
row), bias (3), G (9, row by row); rotation into the first IMU's frame (3, perturbed on the right).
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.calibration.poses import PoseReadings, Transition
from multiimu_ros.calibration.tedaldi import AccelerometerModel, UPPER
from multiimu_ros.calibration.tedaldi_gyroscope import GyroscopeModel

SCALE, SHEAR, FORCE_BIAS = slice(0, 3), slice(3, 6), slice(6, 9)
RATE_E, RATE_BIAS, SENSITIVITY, ROTATION = (
    slice(9, 18),
    slice(18, 21),
    slice(21, 30),
    slice(30, 33),
)
UNKNOWNS = 33


@dataclass(frozen=True)
class ImuView:
    """One IMU's share of a recording.

    Parameters
    ----------
    poses : PoseReadings
        In all P poses, NaN where it was not heard.
    transitions : tuple of T Transition
        Its unbroken moves.
    time, raw_rate, raw_force : (N,), (N, 3), (N, 3) arrays
        All samples [s], raw.
    """

    poses: PoseReadings
    transitions: tuple[Transition, ...]
    time: Scalars
    raw_rate: Vectors
    raw_force: Vectors


@dataclass(frozen=True)
class ImuState:
    """The 33 unknowns of one IMU at their present values; see the module."""

    scale: Vector
    shear: Vector
    force_bias: Vector
    E: Matrix
    rate_bias: Vector
    G: Matrix
    R: Matrix

    @classmethod
    def of(
        cls, accelerometer: AccelerometerModel, gyroscope: GyroscopeModel, R: Matrix
    ) -> 'ImuState':
        """Begin with what the single fits found; `R` (3, 3) maps into the first IMU's frame."""
        a, g = accelerometer, gyroscope
        return cls(a.scale, a.shear, a.bias, g.E, g.bias, g.G, R)

    @property
    def E_a(self) -> Matrix:
        """M S of the accelerometer (3, 3)."""
        return self.M_a * self.scale

    @property
    def M_a(self) -> Matrix:
        """Misalignment of the accelerometer (3, 3)."""
        M = np.eye(3)
        M[UPPER] = self.shear
        return M

    def moved(self, step: Vector) -> 'ImuState':
        """Return the state after a step (33,)."""
        return replace(
            self,
            scale=self.scale + step[SCALE],
            shear=self.shear + step[SHEAR],
            force_bias=self.force_bias + step[FORCE_BIAS],
            E=self.E + step[RATE_E].reshape(3, 3),
            rate_bias=self.rate_bias + step[RATE_BIAS],
            G=self.G + step[SENSITIVITY].reshape(3, 3),
            R=self.R @ Rotation.from_rotvec(step[ROTATION]).as_matrix(),
        )


@dataclass(frozen=True)
class Weights:
    """Variance components of one IMU, in raw readings but for `turn`.

    Parameters
    ----------
    force, rate : (float, float)
        Of each pose on its own, and of the walking bias per second.
    turn : float
        Of the integrated turn, per squared radian of the move [-].
    """

    force: tuple[float, float]
    rate: tuple[float, float]
    turn: float = 0.0
