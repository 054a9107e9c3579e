"""Attitude of a moving rig: an error-state Kalman filter with gyro bias.

The gyroscope carries the attitude.  A tilt that is wrong turns gravity into an acceleration, which
integrates to a velocity that a hand, a foot or a vehicle cannot have: that the velocity stays
bounded corrects roll and pitch.  At rest the rate is known to be zero, which corrects the gyro
bias, and the attitude is held.  Yaw has no reference, so its variance grows as the gyroscope's
noise and bias say, and stops only at rest.  Equations: docs/derivations/attitude.md.

The error is (attitude, gyro bias, velocity, force bias), `R_nb = R_nb_hat @ exp(theta)`, 12
states; the force bias is only considered (Schmidt), for gravity alone cannot tell it from tilt:
without it the filter would believe the tilt that a biased accelerometer shows.

At rest, for `R_nb` the identity, `specific_force` reads [0, 0, +9.81].
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import as_vector, Matrix, Vector
from multiimu_ros.odometry.attitude_steps import (
    align,
    FORCE,
    GAP,
    level,
    MEMORY,
    OUTAGE,
    RADIAL,
    RATE,
    step_attitude,
    told_covariance,
    VELOCITY,
)
from multiimu_ros.odometry.rest import RestBuffer, Sample

__all__ = ['GAP', 'OUTAGE', 'AttitudeConfig', 'AttitudeFilter', 'level', 'step_attitude']


@dataclass(frozen=True, kw_only=True)
class AttitudeConfig:
    """Settings of the attitude filter; what depends on the rig has no default.

    Parameters
    ----------
    rate_bias_sigma, force_bias_sigma : (3,) arrays
        Biases that the calibration leaves [rad/s], [m/s^2].
    rate_bias_walk : (3,) array
        Random walk of the gyro bias [rad/s^2/sqrt(Hz)].
    motion_sigma : float
        Least acceleration of a moving rig, one axis [m/s^2].
    motion_reach : float
        How far a moving rig gets from its place, rms of one axis [m].
    still_sigma : float
        Acceleration of a still rig [m/s^2].
    still_velocity_sigma, still_velocity_time : float
        Velocity of a still rig, one axis [m/s], and how long it stays correlated [s].
    rolling_arm : float
        Distance to the point about which a still rig may roll [m].
    rate_scale_sigma : float
        Errors in proportion to the rate that the calibration leaves [-].
    motion_rate_sigma : float
        How much the rate may change unseen in a gap [rad/s].
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
    motion_sigma: float
    motion_reach: float
    still_sigma: float
    still_velocity_sigma: float
    still_velocity_time: float
    rolling_arm: float = 0.0
    rate_scale_sigma: float = 0.0
    motion_rate_sigma: float = 1.0
    resting_walk: float = 1e-5
    resting_lag: float = 0.25
    gravity: float = 9.80665

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.all(np.asarray(value) >= 0):  # also catches NaN
                msg = f'`{name}` must not be negative, got {value}.'
                raise ValueError(msg)


class AttitudeEstimator(ABC):
    """Orientation and gyro bias of one (virtual) IMU, with covariance."""

    def __init__(self, config: AttitudeConfig, P: Matrix, lag: float) -> None:
        self._config = config
        self._R = np.eye(3)
        self._bias = np.zeros(3)
        self._P = P
        self._aligned = False
        self._rest = RestBuffer(lag)

    @property
    @abstractmethod
    def arrays(self) -> tuple[Matrix, Vector, Matrix, Vector, Vector]:
        """What `step_attitude` changes in place, and its settings."""

    @property
    @abstractmethod
    def started(self) -> bool:
        """Whether there is a sample to step on from."""

    @property
    def aligned(self) -> bool:
        """Whether the attitude has been set by `align` or a first `push`."""
        return self._aligned

    @property
    def R_nb(self) -> Matrix:
        """Attitude (3, 3): rotates body into local level vectors; yaw is zero at the start."""
        return self._R.copy()

    @property
    def gyro_bias(self) -> Vector:
        """Gyro bias (3,) [rad/s]."""
        return self._bias.copy()

    @property
    def P(self) -> Matrix:
        """Covariance (6, 6) of attitude (body axes) and gyro bias [rad^2], [rad^2/s^2]."""
        return self._P.copy()

    def restore_gyro_bias(self, bias: Vector, sigma: Vector) -> None:
        """Start from a saved bias (3,) [rad/s] that is good to `sigma` (3,)."""
        self._bias[:] = as_vector(bias, 'bias')
        self._P[3:6, :] = 0.0
        self._P[:, 3:6] = 0.0
        self._P[3:6, 3:6] = np.diag(np.square(as_vector(sigma, 'sigma')))

    @abstractmethod
    def align(self, specific_force: Vector, force_sigma: float) -> None:
        """Set roll and pitch from a force, and yaw to zero.

        Parameters
        ----------
        specific_force : (3,) array
            Reading, or the mean over a still start [m/s^2].
        force_sigma : float
            Its noise and the rig's acceleration, apart from the bias [m/s^2].
        """

    def push(self, sample: Sample) -> None:
        """Move on by one sample; rest is learnt from late, as `RestBuffer` says."""
        for ready in self._rest.push(sample):
            self.step(ready)

    def step(self, sample: Sample) -> None:
        """Move on by one finite sample at once; the first one aligns."""
        if not self._aligned:
            sigma = self._config.still_sigma if sample.still else self._config.motion_sigma
            self.align(sample.specific_force, sigma)
        self._step(sample)

    @abstractmethod
    def _step(self, sample: Sample) -> None: ...


class AttitudeFilter(AttitudeEstimator):
    """The error-state filter."""

    def __init__(self, config: AttitudeConfig) -> None:
        self._settings = np.array(
            [
                config.motion_sigma, config.still_velocity_sigma, config.still_velocity_time,
                config.motion_rate_sigma, config.resting_walk, config.gravity,
                *as_vector(config.rate_bias_walk, 'rate_bias_walk'),
                config.motion_reach, config.rate_scale_sigma, config.rolling_arm,
            ]
        )  # fmt: skip
        speed = np.full(3, np.sqrt(config.motion_sigma * config.motion_reach))
        sigmas = (np.ones(3), config.rate_bias_sigma, speed, config.force_bias_sigma)
        super().__init__(config, np.diag(np.square(np.concatenate(sigmas))), config.resting_lag)
        self._memory = np.zeros(MEMORY)
        self._started = False

    @property
    def arrays(self) -> tuple[Matrix, Vector, Matrix, Vector, Vector]:
        """What `step_attitude` changes in place, and its settings."""
        return self._R, self._bias, self._P, self._memory, self._settings

    @property
    def started(self) -> bool:
        """Whether there is a sample to step on from."""
        return self._started

    @property
    def P(self) -> Matrix:
        """Covariance (6, 6) of attitude (body axes) and gyro bias [rad^2], [rad^2/s^2]."""
        return told_covariance(self._R, self._P, self._memory)

    def align(self, specific_force: Vector, force_sigma: float) -> None:
        """Set roll and pitch from a force, and yaw to zero; see `AttitudeEstimator`."""
        force = as_vector(specific_force, 'specific_force')
        align(self._R, self._P, force, np.full(3, force_sigma**2), self._config.gravity)
        self._aligned = True

    def _step(self, sample: Sample) -> None:
        if not self._started:
            self._memory[RATE:RADIAL] = sample.angular_rate
            self._memory[FORCE:VELOCITY] = sample.specific_force
            self._started = True
            return
        step_attitude(self._R, self._bias, self._P, self._memory, self._settings, *sample)
