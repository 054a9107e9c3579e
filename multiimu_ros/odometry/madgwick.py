"""Madgwick's filter without magnetometer [1]_: the thesis, (8.14) to (8.21).

A quaternion follows the rate and goes down the gradient of the misfit between the measured
direction of the force and the vertical, at a speed of `beta`:

    q' = q (0, w) / 2 - beta grad / |grad|

As printed, (8.19) divides the gradient by the length of the misfit instead of its own, and (8.21)
halves the correction once and the whole step once more; here they are as in [1]_.  The rate is the
mean of two neighbours, as in `rk4_attitude`.

.. [1] S. O. H. Madgwick, A. J. L. Harrison, R. Vaidyanathan, "Estimation of IMU and MARG
   orientation using a gradient descent algorithm", IEEE Int. Conf. Rehabilitation Robotics, 2011.
"""

import numpy as np

from multiimu_ros.arrays import as_vectors, Matrix, Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude import AttitudeConfig
from multiimu_ros.odometry.attitude_baseline import BaselineAttitude
from multiimu_ros.rotations import as_quaternion

BETA = 0.033  # [1/s] of [1]_ without magnetometer


@compiled
def as_matrix(q: Vector) -> Matrix:
    """Return the rotation (3, 3) of the unit quaternion [x, y, z, w] (4,)."""
    x, y, z, w = q
    return np.array(
        [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ]
    )


@compiled
def madgwick_step(q: Vector, rate: Vector, force: Vector, dt: float, beta: float) -> Vector:
    """Return the quaternion [x, y, z, w] (4,) after one step.

    Parameters
    ----------
    q : (4,) array
        Before it; rotates body into local level vectors.
    rate, force : (3,) arrays
        Mean rate over the step, force at its end [rad/s], [m/s^2].
    dt, beta : float
        Length of the step [s], speed of the correction [1/s].
    """
    x, y, z, w = q
    a, b, c = rate
    slope = 0.5 * np.array(
        [
            w * a + y * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y * a,
            -x * a - y * b - z * c,
        ]
    )
    length = np.sqrt(np.sum(force**2))
    if length > 0.0:
        e = np.array([2.0 * (x * z - w * y), 2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y)])
        e -= force / length
        gradient = np.array(
            [
                2.0 * z * e[0] + 2.0 * w * e[1] - 4.0 * x * e[2],
                -2.0 * w * e[0] + 2.0 * z * e[1] - 4.0 * y * e[2],
                2.0 * x * e[0] + 2.0 * y * e[1],
                -2.0 * y * e[0] + 2.0 * x * e[1],
            ]
        )
        steepness = np.sqrt(np.sum(gradient**2))
        if steepness > 0.0:
            slope = slope - beta / steepness * gradient
    q = q + slope * dt
    unit: Vector = q / np.sqrt(np.sum(q**2))
    return unit


def attitude_madgwick(
    R_nb: Matrix,
    angular_rate: Vectors,
    specific_force: Vectors,
    dt: Scalars,
    beta: float = BETA,
) -> Matrix:
    """Filter N samples.

    Parameters
    ----------
    R_nb : (3, 3) array
        Attitude at the first sample.
    angular_rate, specific_force : (N, 3) arrays
        Readings; rates without bias [rad/s], [m/s^2].
    dt : (N - 1,) array
        Time between the samples [s].
    beta : float
        Speed of the correction [1/s].

    Returns
    -------
    (N, 3, 3) array
        Attitude at every sample.
    """
    rate = as_vectors(angular_rate, 'angular_rate')
    force = as_vectors(specific_force, 'specific_force')
    attitude = np.empty((len(rate), 3, 3))
    attitude[0] = R_nb
    q = as_quaternion(attitude[0])
    for k in range(1, len(rate)):
        q = madgwick_step(q, 0.5 * (rate[k - 1] + rate[k]), force[k], dt[k - 1], beta)
        attitude[k] = as_matrix(q)
    return attitude


class MadgwickAttitude(BaselineAttitude):
    """`attitude_madgwick` on a live stream.

    Its covariance is a rough figure: yaw grows as with the gyroscope left alone; tilt is what the
    correction runs after the acceleration of the motion while that keeps its sign, 2 beta times
    sqrt(`motion_reach` / `motion_sigma`), and what the bias of the force shows.
    """

    def __init__(self, config: AttitudeConfig, beta: float = BETA) -> None:
        if not beta >= 0.0:
            msg = f'`beta` must not be negative, got {beta}.'
            raise ValueError(msg)
        super().__init__(config)
        self._beta = beta
        self._q = as_quaternion(self._R)
        chase = 2.0 * beta * np.sqrt(config.motion_reach / config.motion_sigma)
        bias_variance = np.mean(np.square(config.force_bias_sigma))
        self._tilt_variance = chase**2 + bias_variance / config.gravity**2

    @property
    def P(self) -> Matrix:
        """Covariance (6, 6) of attitude (body axes) and gyro bias; see the class for tilt."""
        keep = np.eye(6)
        keep[:3, :3] = np.outer(self._R[2], self._R[2])
        P: Matrix = keep @ self._P @ keep.T
        P[:3, :3] += self._tilt_variance * (np.eye(3) - keep[:3, :3])
        return P

    def align(self, specific_force: Vector, force_sigma: float) -> None:
        """Set roll and pitch from a force [m/s^2] whose noise and motion is `force_sigma`."""
        super().align(specific_force, force_sigma)
        self._q = as_quaternion(self._R)

    def _move(self, rate: Vector, force: Vector, dt: float) -> None:
        self._q = madgwick_step(self._q, rate, force, dt, self._beta)
        self._R[:] = as_matrix(self._q)
