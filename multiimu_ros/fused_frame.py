"""What the chain knows at one instant, in one record.

A frame is 143 numbers in one array, written by one compiled call; the properties are views of it,
so that a frame nobody reads costs next to nothing.
"""

from math import prod

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.error_state import pose_covariance, twist_covariance
from multiimu_ros.rotations import as_quaternion, product

RATE, FORCE, ORIENTATION, POSITION, ODOM_ORIENTATION, VELOCITY = 0, 3, 6, 10, 13, 17
RATE_P, FORCE_P, ORIENTATION_P, POSE_P, TWIST_P = 20, 29, 38, 47, 83
BIAS, BIAS_SIGMA, READING, DENSITY, SIZE = 119, 125, 131, 137, 143


# First number and shape of what `columns` returns, under the names of the properties.
FIELDS = {
    'angular_rate': (RATE, (3,)),
    'specific_force': (FORCE, (3,)),
    'orientation': (ORIENTATION, (4,)),
    'position_n': (POSITION, (3,)),
    'odom_orientation': (ODOM_ORIENTATION, (4,)),
    'velocity_b': (VELOCITY, (3,)),
    'angular_rate_covariance': (RATE_P, (3, 3)),
    'specific_force_covariance': (FORCE_P, (3, 3)),
    'orientation_covariance': (ORIENTATION_P, (3, 3)),
    'pose_covariance': (POSE_P, (6, 6)),
    'twist_covariance': (TWIST_P, (6, 6)),
    'gyro_bias': (BIAS, (3,)),
    'accel_bias': (BIAS + 3, (3,)),
    'gyro_bias_sigma': (BIAS_SIGMA, (3,)),
    'accel_bias_sigma': (BIAS_SIGMA + 3, (3,)),
    'reading': (READING, (6,)),
    'density': (DENSITY, (6,)),
}


def columns(records: Vectors) -> dict[str, Matrix]:
    """Return each property of N frames as an array (N, ...), from their records (N, 143)."""
    return {
        name: records[:, first : first + prod(shape)].reshape(-1, *shape)
        for name, (first, shape) in FIELDS.items()
    }


class FusedFrame:
    """The fused IMU and the odometry at one instant; pose rotations are about fixed axes.

    Parameters
    ----------
    stamp_ns : int
        Instant of the measurement [ns].
    still, resting : bool
        Whether the rig has no velocity; whether it has not turned for a while either.
    weights : (K,) array
        Share of each IMU in the fused rate [-].
    record : (143,) array
        The numbers behind the properties.
    """

    __slots__ = ('record', 'resting', 'stamp_ns', 'still', 'weights')

    def __init__(
        self, stamp_ns: int, still: bool, resting: bool, weights: Scalars, record: Vector
    ) -> None:
        self.stamp_ns = stamp_ns
        self.still, self.resting = still, resting
        self.weights = weights
        self.record = record

    @property
    def angular_rate(self) -> Vector:
        """Fused rate (3,) without its estimated bias, in the base frame [rad/s]."""
        return self.record[RATE:FORCE]

    @property
    def specific_force(self) -> Vector:
        """Fused specific force (3,) at the base origin [m/s^2]."""
        return self.record[FORCE:ORIENTATION]

    @property
    def orientation(self) -> Vector:
        """Attitude [x, y, z, w] of the attitude filter."""
        return self.record[ORIENTATION:POSITION]

    @property
    def position_n(self) -> Vector:
        """Position (3,) in the odometry frame [m]."""
        return self.record[POSITION:ODOM_ORIENTATION]

    @property
    def odom_orientation(self) -> Vector:
        """Attitude [x, y, z, w] of the odometry filter."""
        return self.record[ODOM_ORIENTATION:VELOCITY]

    @property
    def velocity_b(self) -> Vector:
        """Velocity (3,) in the base frame [m/s]."""
        return self.record[VELOCITY:RATE_P]

    @property
    def angular_rate_covariance(self) -> Matrix:
        """Covariance (3, 3) of the rate, its bias included [(rad/s)^2]."""
        return self.record[RATE_P:FORCE_P].reshape(3, 3)

    @property
    def specific_force_covariance(self) -> Matrix:
        """Covariance (3, 3) of the force, its bias included [(m/s^2)^2]."""
        return self.record[FORCE_P:ORIENTATION_P].reshape(3, 3)

    @property
    def orientation_covariance(self) -> Matrix:
        """Covariance (3, 3) of the attitude filter, about fixed axes [rad^2]."""
        return self.record[ORIENTATION_P:POSE_P].reshape(3, 3)

    @property
    def pose_covariance(self) -> Matrix:
        """Covariance (6, 6) of position and rotation of the odometry."""
        return self.record[POSE_P:TWIST_P].reshape(6, 6)

    @property
    def twist_covariance(self) -> Matrix:
        """Covariance (6, 6) of velocity and rate, in the base frame."""
        return self.record[TWIST_P:BIAS].reshape(6, 6)

    @property
    def gyro_bias(self) -> Vector:
        """Bias (3,) that the odometry takes out of the rate [rad/s]."""
        return self.record[BIAS : BIAS + 3]

    @property
    def accel_bias(self) -> Vector:
        """Bias (3,) that the odometry takes out of the force [m/s^2]."""
        return self.record[BIAS + 3 : BIAS_SIGMA]

    @property
    def gyro_bias_sigma(self) -> Vector:
        """Standard deviation (3,) of the gyro bias [rad/s]."""
        return self.record[BIAS_SIGMA : BIAS_SIGMA + 3]

    @property
    def accel_bias_sigma(self) -> Vector:
        """Standard deviation (3,) of the accelerometer bias [m/s^2]."""
        return self.record[BIAS_SIGMA + 3 : READING]

    @property
    def reading(self) -> Vector:
        """What the filters were given: rate [rad/s], bias included, and force [m/s^2], (6,)."""
        return self.record[READING:DENSITY]

    @property
    def density(self) -> Vector:
        """White noise (6,) of the reading [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)]."""
        return self.record[DENSITY:SIZE]


@compiled
def write_record(
    record: Vector,
    fused: Vectors,
    R: Matrix,
    bias: Vector,
    P: Matrix,
    x: Vector,
    R_odom: Matrix,
    P_odom: Matrix,
) -> None:
    """Fill the record of a frame.

    Parameters
    ----------
    record : (143,) array
        Filled.
    fused : (4, 6) array
        Fused readings, their variance, that of their common bias, and their noise density.
    R, bias, P : (3, 3), (3,), (M, M) arrays
        Attitude, gyro bias and covariance (attitude, gyro bias, ...) of the attitude filter.
    x, R_odom, P_odom : (15,), (3, 3), (15, 15) arrays
        State, attitude and covariance of the odometry filter.
    """
    record[RATE:FORCE] = fused[0, :3] - bias
    record[FORCE:ORIENTATION] = fused[0, 3:]
    record[ORIENTATION:POSITION] = as_quaternion(R)
    record[POSITION:ODOM_ORIENTATION] = x[:3]
    record[ODOM_ORIENTATION:VELOCITY] = as_quaternion(R_odom)
    velocity = np.zeros(3)
    for i in range(3):
        for j in range(3):
            velocity[i] += R_odom[j, i] * x[3 + j]
            record[RATE_P + 3 * i + j] = P[3 + i, 3 + j]
            record[FORCE_P + 3 * i + j] = 0.0
        record[RATE_P + 4 * i] += fused[1, i]
        record[FORCE_P + 4 * i] = fused[1, 3 + i] + fused[2, 3 + i]
    record[VELOCITY:RATE_P] = velocity
    record[ORIENTATION_P:POSE_P] = product(product(R, P[:3, :3]), R.T).ravel()
    record[POSE_P:TWIST_P] = pose_covariance(R_odom, P_odom).ravel()
    record[TWIST_P:BIAS] = twist_covariance(R_odom, x[3:6], P_odom, fused[1, :3]).ravel()
    record[BIAS:BIAS_SIGMA] = x[9:15]
    for i in range(6):
        record[BIAS_SIGMA + i] = np.sqrt(P_odom[9 + i, 9 + i])
    record[READING:DENSITY], record[DENSITY:SIZE] = fused[0], fused[3]
