"""What the attitude schemes of the sources share: a gyro bias that stays as it was calibrated.

Their covariance grows as the gyroscope's noise and bias
say (docs/derivations/attitude.md (3), (4)); nothing in these schemes makes it shrink.
"""

from abc import abstractmethod

import numpy as np

from multiimu_ros.arrays import as_vector, Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude import AttitudeConfig, AttitudeEstimator, level
from multiimu_ros.odometry.kalman import propagate
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.rotations import exp_so3, right_jacobian


@compiled
def _grow(P: Matrix, phi: Vector, rate_psd: Vector, walk: Vector, dt: float) -> None:
    """Let P (6, 6) of attitude and gyro bias grow while the body turns by `phi`."""
    F = np.eye(6)
    F[:3, :3] = exp_so3(-phi)
    F[:3, 3:] = -dt * right_jacobian(phi)
    propagate(P, F)
    for i in range(3):
        P[i, i] += rate_psd[i] * dt
        P[3 + i, 3 + i] += walk[i] * dt


class BaselineAttitude(AttitudeEstimator):
    """Orientation by a scheme without a covariance of its own; it never learns a bias."""

    def __init__(self, config: AttitudeConfig) -> None:
        sigmas = np.array([1.0, 1.0, 1.0, *config.rate_bias_sigma])
        super().__init__(config, np.diag(np.square(sigmas)), lag=0.0)
        self._last_rate: Vector | None = None

    @property
    def arrays(self) -> tuple[Matrix, Vector, Matrix, Vector, Vector]:
        """In the places of those of `AttitudeFilter`, which its kernel alone would need."""
        return self._R, self._bias, self._P, np.zeros(0), np.zeros(0)

    @property
    def started(self) -> bool:
        """Whether there is a sample to step on from."""
        return self._last_rate is not None

    def align(self, specific_force: Vector, force_sigma: float) -> None:
        """Set roll and pitch from a force [m/s^2] whose noise and motion is `force_sigma`."""
        self._R[:] = level(as_vector(specific_force, 'specific_force'))
        up = self._R[2]
        bias_variance = np.mean(np.square(self._config.force_bias_sigma))
        tilt = (force_sigma**2 + bias_variance) / self._config.gravity**2
        self._P[:3, :] = 0.0
        self._P[:, :3] = 0.0
        self._P[:3, :3] = tilt * (np.eye(3) - np.outer(up, up))
        self._aligned = True

    def _step(self, sample: Sample) -> None:
        config = self._config
        if self._last_rate is not None:
            # Half a sample of lag is what the newest rate alone would cost.
            rate = 0.5 * (self._last_rate + sample.angular_rate) - self._bias
            walk = np.square(config.rate_bias_walk)
            _grow(self._P, sample.dt * rate, sample.rate_density**2, walk, sample.dt)
            self._move(rate, sample.specific_force, sample.dt)
        self._last_rate = sample.angular_rate.copy()

    @abstractmethod
    def _move(self, rate: Vector, force: Vector, dt: float) -> None:
        """Set `_R` after a step of length `dt` at the mean `rate`, with `force` at its end."""
