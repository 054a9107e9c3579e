"""Odometry from one IMU: a 15-state error-state Kalman filter with zero-velocity updates.

Strapdown integration carries position, velocity and attitude; each stance of a foot, each stop
of a vehicle, each time the rig is laid down tells that the velocity is zero, and through the
correlations that corrects position, tilt and the biases [1]_.  A resting rig is held: rather than
integrating noise, the filter knows that nothing moves, so the position stays where it is while
gyro bias (the rate is zero) and tilt (the force is gravity) improve.  Equations:
docs/derivations/error_state.md.

The error is (position, velocity, attitude, gyro bias, accel bias), truth minus estimate; the
attitude error is in the body frame, `R_nb = R_nb_hat @ exp(theta)`.

.. [1] E. Foxlin, "Pedestrian tracking with shoe-mounted inertial sensors", IEEE Computer
   Graphics and Applications 25(6), 2005.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import as_vector, Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry import error_fields as fields
from multiimu_ros.odometry.error_dynamics import step
from multiimu_ros.odometry.error_updates import align
from multiimu_ros.odometry.rest import RestBuffer, Sample
from multiimu_ros.rotations import product, skew


@dataclass(frozen=True, kw_only=True)
class ErrorStateConfig:
    """Settings of the odometry filter; what depends on the rig has no default.

    Parameters
    ----------
    rate_bias_sigma, force_bias_sigma : (3,) arrays
        Biases that the calibration leaves [rad/s], [m/s^2].
    rate_bias_walk, force_bias_walk : (3,) arrays
        Their random walks [rad/s^2/sqrt(Hz)], [m/s^3/sqrt(Hz)].
    zero_velocity_sigma : float
        Velocity of a still rig, one axis [m/s].
    zero_velocity_time : float
        How long that velocity stays correlated [s].
    rolling_arm : float
        Distance to the point about which a still rig may roll [m], as far as it is not known.
    rolling_height : float
        How high above that point the rig is in any case [m].
    settling_time : float
        How long the rate at which a stance began counts against it [s].
    stances_teach : bool
        Whether being still tells of gyro bias and yaw, or only of position, velocity and tilt.
    motion_sigma : float
        Acceleration of a moving rig, for a start in motion and for gaps [m/s^2].
    motion_velocity_sigma : float
        Velocity of a moving rig, for a start in motion [m/s].
    motion_rate_sigma : float
        How much the rate may change unseen in a gap [rad/s].
    rate_scale_sigma, force_scale_sigma : float
        Errors in proportion to the reading (scale, g-sensitivity, saturation) that a stride
        leaves [-], before the first stances have told how large they are.
    learning_strides : float
        Over how many strides that is learnt [-]; 0 for never.
    resting_velocity_sigma : float
        Velocity of a resting rig [m/s].
    resting_walk : float
        How a resting rig may turn [rad/sqrt(s)].
    resting_lag : float
        How late the end of a rest may be noticed [s].
    gravity : float
        Local gravity [m/s^2].
    """

    rate_bias_sigma: Vector
    force_bias_sigma: Vector
    rate_bias_walk: Vector
    force_bias_walk: Vector
    zero_velocity_sigma: float
    zero_velocity_time: float
    motion_sigma: float
    motion_velocity_sigma: float
    motion_rate_sigma: float = 1.0
    rolling_arm: float = 0.0
    rolling_height: float = 0.0
    settling_time: float = 0.0
    stances_teach: bool = True
    rate_scale_sigma: float = 0.0
    force_scale_sigma: float = 0.0
    learning_strides: float = 0.0
    resting_velocity_sigma: float = 3e-4
    resting_walk: float = 1e-5
    resting_lag: float = 0.25
    gravity: float = 9.80665

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.all(np.asarray(value) >= 0):  # also catches NaN
                msg = f'`{name}` must not be negative, got {value}.'
                raise ValueError(msg)


def settings_of(config: ErrorStateConfig) -> Vector:
    """Return the settings (SETTINGS,) as the kernels take them."""
    settings = np.empty(fields.SETTINGS)
    settings[fields.GRAVITY] = config.gravity
    settings[fields.STANCE_SIGMA] = config.zero_velocity_sigma
    settings[fields.STANCE_TIME] = config.zero_velocity_time
    settings[fields.RESTING_SIGMA] = config.resting_velocity_sigma
    settings[fields.RESTING_WALK] = config.resting_walk
    settings[fields.MOTION_RATE] = config.motion_rate_sigma
    settings[fields.MOTION_FORCE] = config.motion_sigma
    settings[fields.RATE_SCALE] = config.rate_scale_sigma
    settings[fields.FORCE_SCALE] = config.force_scale_sigma
    walks = (
        as_vector(config.rate_bias_walk, 'rate_bias_walk'),
        as_vector(config.force_bias_walk, 'force_bias_walk'),
    )
    settings[fields.WALKS : fields.ROLLING_ARM] = np.concatenate(walks)
    settings[fields.ROLLING_ARM] = config.rolling_arm
    settings[fields.LEARNING_STRIDES] = config.learning_strides
    settings[fields.ROLLING_HEIGHT] = config.rolling_height
    settings[fields.SETTLING_TIME] = config.settling_time
    settings[fields.STANCES_TEACH] = config.stances_teach
    return settings


class ErrorStateFilter:
    """Position, velocity, attitude and biases of one (virtual) IMU, with covariance."""

    def __init__(self, config: ErrorStateConfig) -> None:
        self._config = config
        self._settings = settings_of(config)
        self._x = np.zeros(15)
        self._R = np.eye(3)
        sigmas = (np.zeros(6), np.ones(3), config.rate_bias_sigma, config.force_bias_sigma)
        self._P = np.diag(np.square(np.concatenate(sigmas)))
        self._memory = np.zeros(fields.MEMORY)
        self._aligned = self._started = False
        self._rest = RestBuffer(config.resting_lag)

    @property
    def arrays(self) -> tuple[Vector, Matrix, Matrix, Vector, Vector]:
        """What `error_dynamics.step` changes in place, and its settings."""
        return self._x, self._R, self._P, self._memory, self._settings

    @property
    def started(self) -> bool:
        """Whether there is a sample to step on from."""
        return self._started

    @property
    def state(self) -> Vector:
        """Nominal state (15,): position, velocity, (unused), gyro bias, accel bias."""
        return self._x.copy()

    @property
    def position_n(self) -> Vector:
        """Position (3,) from the start, local level frame [m]."""
        return self._x[0:3].copy()

    @property
    def velocity_n(self) -> Vector:
        """Velocity (3,), local level frame [m/s]."""
        return self._x[3:6].copy()

    @property
    def R_nb(self) -> Matrix:
        """Attitude (3, 3): rotates body into local level vectors; yaw is zero at the start."""
        return self._R.copy()

    @property
    def gyro_bias(self) -> Vector:
        """Gyro bias (3,) [rad/s]."""
        return self._x[9:12].copy()

    @property
    def accel_bias(self) -> Vector:
        """Accelerometer bias (3,) [m/s^2]."""
        return self._x[12:15].copy()

    @property
    def P(self) -> Matrix:
        """Covariance (15, 15) of position, velocity, attitude (body axes), gyro, accel bias."""
        return self._P.copy()

    def restore_biases(
        self, gyro_bias: Vector, gyro_sigma: Vector, accel_bias: Vector, accel_sigma: Vector
    ) -> None:
        """Start from saved biases (3,) and their standard deviations [rad/s], [m/s^2]."""
        bias = np.concatenate((as_vector(gyro_bias, 'gyro_bias'), accel_bias))
        sigma = np.concatenate((as_vector(gyro_sigma, 'gyro_sigma'), accel_sigma))
        self._x[9:15] = bias
        self._P[9:15, :] = 0.0
        self._P[:, 9:15] = 0.0
        self._P[9:15, 9:15] = np.diag(np.square(sigma))

    def reset_motion(self) -> None:
        """Put the origin here and forget the velocity, after a jump in time; keep the rest."""
        self._x[:6] = 0.0
        self._P[:6, :] = 0.0
        self._P[:, :6] = 0.0
        self._P[3:6, 3:6] = np.eye(3) * self._config.motion_velocity_sigma**2
        self._started = False
        self._rest.clear()

    def align(self, specific_force: Vector, force_sigma: float, velocity_sigma: float) -> None:
        """Set roll and pitch from a force, yaw and velocity to zero.

        Parameters
        ----------
        specific_force : (3,) array
            Reading, or the mean over a still start [m/s^2].
        force_sigma : float
            Its noise and the rig's acceleration, apart from the bias [m/s^2].
        velocity_sigma : float
            How still the rig is [m/s].
        """
        force = as_vector(specific_force, 'specific_force')
        variance = np.full(3, force_sigma**2)
        align(self._x, self._R, self._P, force, variance, self._config.gravity)
        self._P[3:6, 3:6] += np.eye(3) * velocity_sigma**2
        self._aligned = True

    def push(self, sample: Sample) -> None:
        """Move on by one sample; rest is learnt from late, as `RestBuffer` says."""
        for ready in self._rest.push(sample):
            self.step(ready)

    def step(self, sample: Sample) -> None:
        """Move on by one finite sample at once; the first one aligns, as in motion."""
        if not self._aligned:
            self.align(
                sample.specific_force,
                self._config.motion_sigma,
                self._config.motion_velocity_sigma,
            )
        if not self._started:
            self._memory[:] = 0.0
            self._memory[: fields.RESTED] = (*sample.angular_rate, *sample.specific_force)
            self._started = True
            return
        step(self._x, self._R, self._P, self._memory, self._settings, *sample)


@compiled
def pose_covariance(R_nb: Matrix, P: Matrix) -> Matrix:
    """Return the covariance (6, 6) of position and rotation about fixed axes, as ROS has it.

    Parameters
    ----------
    R_nb : (3, 3) array
        Attitude.
    P : (15, 15) array
        Covariance of the error state; its attitude error is in the body frame.
    """
    covariance = np.empty((6, 6))
    covariance[:3, :3] = P[:3, :3]
    # R exp(theta) = exp(R theta) R: the error about fixed axes is R theta.
    covariance[:3, 3:] = product(P[:3, 6:9], R_nb.T)
    covariance[3:, :3] = covariance[:3, 3:].T
    covariance[3:, 3:] = product(product(R_nb, P[6:9, 6:9]), R_nb.T)
    return covariance


@compiled
def twist_covariance(R_nb: Matrix, velocity_n: Vector, P: Matrix, rate_variance: Vector) -> Matrix:
    """Return the covariance (6, 6) of velocity and angular rate, both in the body frame.

    Parameters
    ----------
    R_nb : (3, 3) array
        Attitude.
    velocity_n : (3,) array
        Velocity in the local level frame [m/s].
    P : (15, 15) array
        Covariance of the error state.
    rate_variance : (3,) array
        White noise of the published rate [rad^2/s^2].
    """
    turned = R_nb.T
    # exp(-theta) v = v + v x theta: velocity error in the body frame is R' dv + [v]x theta.
    tilt = skew(product(turned, velocity_n.reshape(3, 1)).ravel())
    to_velocity = product(turned, P[3:6, 3:6]) + product(tilt, P[6:9, 3:6])
    to_tilt = product(turned, P[3:6, 6:9]) + product(tilt, P[6:9, 6:9])
    covariance = np.empty((6, 6))
    covariance[:3, :3] = product(to_velocity, R_nb) + product(to_tilt, tilt.T)
    covariance[:3, 3:] = -product(turned, P[3:6, 9:12]) - product(tilt, P[6:9, 9:12])
    covariance[3:, :3] = covariance[:3, 3:].T
    covariance[3:, 3:] = P[9:12, 9:12]
    for axis in range(3):
        covariance[3 + axis, 3 + axis] += rate_variance[axis]
    return covariance
