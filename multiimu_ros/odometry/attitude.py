"""Attitude of a moving rig: an error-state Kalman filter with gyro bias.

The gyroscope carries the attitude; the specific force, which on average over a bounded motion is
the reaction to gravity, corrects roll and pitch; at rest the rate is known to be zero, which
corrects the gyro bias, and the attitude is held.  Yaw has no reference, so its variance grows as
the gyroscope's noise and bias say, and stops only at rest.  Equations:
docs/derivations/attitude.md.

The error is (attitude, gyro bias, force bias), `R_nb = R_nb_hat @ exp(theta)`, 9 states; the
force bias is only considered (Schmidt), for gravity alone cannot tell it from tilt: without it
the filter would believe the tilt that a biased accelerometer shows.

At rest, for `R_nb` the identity, `specific_force` reads [0, 0, +9.81].
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import as_vector, Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.kalman import (
    propagate,
    scalar_update,
    transform_block,
    white_equivalent,
)
from multiimu_ros.odometry.rest import RestBuffer, Sample
from multiimu_ros.odometry.strapdown import cross, curvature
from multiimu_ros.rotations import exp_so3, product, renormalise, right_jacobian, skew

OUTAGE = 0.2  # [s] after longer ones the readings at the two ends have nothing in common
GAP = 0.05  # [s] longer steps hide motion: 20 Hz is the slowest IMU that we call one
RADIAL_TIME = 1.0  # [s] memory of how strongly the rig accelerates


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
    still_sigma : float
        Acceleration of a still rig [m/s^2].
    motion_time : float
        Correlation time of these accelerations [s].
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
    still_sigma: float
    motion_time: float
    motion_rate_sigma: float = 1.0
    resting_walk: float = 1e-5
    resting_lag: float = 0.25
    gravity: float = 9.80665

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.all(np.asarray(value) >= 0):  # also catches NaN
                msg = f'`{name}` must not be negative, got {value}.'
                raise ValueError(msg)


@compiled
def level(specific_force: Vector) -> Matrix:
    """Return the (3, 3) attitude of yaw zero in which `specific_force` (3,) points up."""
    up = specific_force / np.sqrt(np.sum(specific_force**2))
    # The body's x axis, made horizontal, is north; looking straight up, its y axis leads instead.
    forward = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < 0.999 else np.array([0.0, 1.0, 0.0])
    forward = forward - np.sum(forward * up) * up
    forward /= np.sqrt(np.sum(forward**2))
    R = np.empty((3, 3))
    R[0], R[2] = forward, up
    R[1] = np.array(
        [
            up[1] * forward[2] - up[2] * forward[1],
            up[2] * forward[0] - up[0] * forward[2],
            up[0] * forward[1] - up[1] * forward[0],
        ]
    )
    return R


@compiled
def _gravity_update(
    R: Matrix, error: Vector, P: Matrix, force: Vector, gravity: float, variance: Vector
) -> None:
    """Correct by force = R' g + force bias + noise of `variance` (3,)."""
    expected = gravity * R[2]
    h = np.zeros((3, 9))
    h[:, :3] = skew(expected)
    for axis in range(3):
        h[axis, 6 + axis] = 1.0
        residual = force[axis] - expected[axis]
        scalar_update(error, P, h[axis], residual, variance[axis], 0, 6)


@compiled
def _inject(R: Matrix, bias: Vector, error: Vector, P: Matrix) -> None:
    """Move the estimated error into the state (attitude.md (8))."""
    R[:] = renormalise(product(R, exp_so3(error[:3])))
    bias += error[3:6]
    transform_block(P, exp_so3(-error[:3]), 0)


@compiled
def _align(R: Matrix, P: Matrix, force: Vector, variance: Vector, gravity: float) -> None:
    R[:] = level(force)
    P[:3, :] = 0.0
    P[:, :3] = 0.0
    # A tilt of 1 rad is no knowledge; yaw is zero by definition.
    for i in range(3):
        for j in range(3):
            P[i, j] = (1.0 if i == j else 0.0) - R[2, i] * R[2, j]
    error = np.zeros(9)
    # The direction is exact to first order, so only the covariance needs the update.
    length = np.sqrt(np.sum(force**2))
    _gravity_update(R, error, P, force * (gravity / length), gravity, variance)


@compiled
def _propagate(
    R: Matrix, P: Matrix, phi: Vector, rate_variance: Vector, walk: Vector, dt: float
) -> None:
    """Turn by `phi` in `dt`; noise enters per axis [rad^2/s], [rad^2/s^3]."""
    F = np.eye(9)
    F[:3, :3] = exp_so3(-phi)
    F[:3, 3:6] = -dt * right_jacobian(phi)
    propagate(P, F)
    for i in range(3):
        P[i, i] += rate_variance[i] * dt + walk[i] * dt**3 / 3.0
        P[i, 3 + i] -= walk[i] * dt**2 / 2.0
        P[3 + i, i] -= walk[i] * dt**2 / 2.0
        P[3 + i, 3 + i] += walk[i] * dt
    R[:] = renormalise(product(R, exp_so3(phi)))


@compiled
def step_attitude(
    R: Matrix,
    bias: Vector,
    P: Matrix,
    memory: Vector,
    settings: Vector,
    dt: float,
    rate: Vector,
    force: Vector,
    rate_density: Vector,
    force_density: Vector,
    still: bool,
    resting: bool,
) -> None:
    """One push; `memory` (8,): last rate, mean square of |f| - g, rate before, last dt."""
    motion_sigma, still_sigma, motion_time, gap_sigma, resting_walk, gravity = settings[:6]
    walk = settings[6:9] ** 2
    error = np.zeros(9)
    white = force_density**2 / dt
    radial = np.sqrt(np.sum(force**2)) - gravity
    memory[3] += dt / (RADIAL_TIME + dt) * (radial * radial - memory[3])
    if resting:
        for axis in range(3):
            P[axis, axis] += resting_walk**2 * dt
            P[3 + axis, 3 + axis] += walk[axis] * dt
            h = np.zeros(9)
            h[3 + axis] = 1.0
            noise = rate_density[axis] ** 2 / dt
            scalar_update(error, P, h, rate[axis] - bias[axis], noise, 0, 6)
    else:
        hidden = gap_sigma**2 * max(0.0, dt - GAP) ** 2 / dt
        bend = curvature(memory[4:7], memory[:3], rate, memory[7], dt) - bias
        if dt > OUTAGE:
            bend = -bias
        start, end = memory[:3] + bend, rate + bend
        phi = 0.5 * dt * (start + end) + dt * dt / 12.0 * cross(start, end)  # coning
        _propagate(R, P, phi, rate_density**2 + hidden, walk, dt)
        sigma = still_sigma if still else max(motion_sigma, np.sqrt(memory[3]))
        white = white + white_equivalent(sigma, motion_time, dt)
    _gravity_update(R, error, P, force, gravity, white)
    _inject(R, bias, error, P)
    memory[4:7], memory[7] = memory[:3], dt
    memory[:3] = rate


class AttitudeFilter:
    """Orientation and gyro bias of one (virtual) IMU, with covariance."""

    def __init__(self, config: AttitudeConfig) -> None:
        self._settings = np.array(
            [
                config.motion_sigma, config.still_sigma, config.motion_time,
                config.motion_rate_sigma, config.resting_walk, config.gravity,
                *as_vector(config.rate_bias_walk, 'rate_bias_walk'),
            ]
        )  # fmt: skip
        self._R = np.eye(3)
        self._bias = np.zeros(3)
        sigmas = (np.ones(3), config.rate_bias_sigma, config.force_bias_sigma)
        self._P = np.diag(np.square(np.concatenate(sigmas)))
        self._memory = np.zeros(8)
        self._aligned = self._started = False
        self._rest = RestBuffer(config.resting_lag)

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
        return self._P[:6, :6].copy()

    def restore_gyro_bias(self, bias: Vector, sigma: Vector) -> None:
        """Start from a saved bias (3,) [rad/s] that is good to `sigma` (3,)."""
        self._bias[:] = as_vector(bias, 'bias')
        self._P[3:6, :] = 0.0
        self._P[:, 3:6] = 0.0
        self._P[3:6, 3:6] = np.diag(np.square(as_vector(sigma, 'sigma')))

    def align(self, specific_force: Vector, force_sigma: float) -> None:
        """Set roll and pitch from a force, and yaw to zero.

        Parameters
        ----------
        specific_force : (3,) array
            Reading, or the mean over a still start [m/s^2].
        force_sigma : float
            Its noise and the rig's acceleration, apart from the bias [m/s^2].
        """
        force = as_vector(specific_force, 'specific_force')
        _align(self._R, self._P, force, np.full(3, force_sigma**2), float(self._settings[5]))
        self._aligned = True

    def push(self, sample: Sample) -> None:
        """Move on by one sample; rest is learnt from late, as `RestBuffer` says."""
        for ready in self._rest.push(sample):
            self.step(ready)

    def step(self, sample: Sample) -> None:
        """Move on by one finite sample at once; the first one aligns."""
        if not self._aligned:
            self.align(sample.specific_force, float(self._settings[1 if sample.still else 0]))
        if not self._started:
            self._memory[:3] = sample.angular_rate
            self._started = True
            return
        step_attitude(self._R, self._bias, self._P, self._memory, self._settings, *sample)
