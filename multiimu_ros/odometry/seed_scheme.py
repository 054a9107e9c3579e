"""The odometry of the source documents: integrate, remove gravity, reset the velocity.

The thesis (9.1-9.6) turns the fused IMU into a pose without a filter.  A rest of at least 3 s
gives the gyro bias (its mean rate) and gravity (its mean force); then

    dR/dt = R [w]x   by Runge-Kutta of fourth order, w = (w_k + w_(k-1)) / 2        (9.1, 9.2)
    a = R f - g                                                                     (9.3-9.5)
    v, p: the trapezoidal sums of a and v;    v = 0 while |w| is small              (9.6)

As printed, (9.6) also resets where a swing turns round; here |w| must have been small for a
while, in a rig that is still.  A reset corrects the velocity alone: what it tells of tilt, bias
and the way since the last reset is lost.  This is the baseline that `ErrorStateFilter` is
measured against.  The sources state no uncertainty; P is how the errors of this scheme grow to
first order under the noise model of that filter: docs/derivations/seed_scheme.md.
"""

import numpy as np

from multiimu_ros.arrays import as_vectors, Flags, Matrix, Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude import level, OUTAGE
from multiimu_ros.odometry.error_dynamics import predict, remember
from multiimu_ros.odometry.error_fields import FORCE, RATE
from multiimu_ros.odometry.error_state import ErrorStateConfig, ErrorStateFilter
from multiimu_ros.odometry.error_updates import align
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.strapdown import attitude_rk4, Motion, rk4_step
from multiimu_ros.rotations import product

# [s] of samples that are marked `resting`, as a foot is after a second: a rest of 3 s in all
ALIGNMENT_S = 2.0
RESET_RATE = 0.1  # [rad/s] a foot that stands sways at 0.01, one that rolls turns at 0.3 and more
RESET_S = 0.05  # [s] where a swing turns round, at 20 rad/s^2 or more, |w| is small for 10 ms
CALM = 3  # in `own` of `seed_step`


@compiled
def seed_step(
    x: Vector,
    R: Matrix,
    P: Matrix,
    memory: Vector,
    own: Vector,
    settings: Vector,
    law: Vector,
    dt: float,
    rate: Vector,
    force: Vector,
    rate_density: Vector,
    force_density: Vector,
    still: bool,
) -> None:
    """Take one sample.

    `own` (4,) is the acceleration at the last sample, and for how long |w| has been small; `law`
    (4,) gravity, for how long it has to be, and velocity and rolling arm of a still rig.
    """
    gravity, reset_s, slip, arm = law[0], law[1], law[2], law[3]
    spin = np.sum((rate - x[9:12]) ** 2)
    own[CALM] = own[CALM] + dt if still and spin < RESET_RATE**2 else 0.0
    predict(
        x.copy(), R.copy(), P, memory, settings, dt, rate, force, rate_density, force_density,
        False,
    )  # fmt: skip
    R[:] = rk4_step(R, 0.5 * (memory[RATE:FORCE] + rate) - x[9:12], dt)
    before = own[:3].copy()
    own[:3] = R @ (force - x[12:15])
    own[2] -= gravity
    velocity = x[3:6].copy()
    if dt <= OUTAGE:  # the ends of a hole do not tell how the rig sped up in it
        velocity += 0.5 * dt * (before + own[:3])
    if own[CALM] > (1.0 - 1e-6) * reset_s:  # whatever the steps add up to, rounded
        velocity[:] = 0.0
        P[3:6, :] = 0.0
        P[:, 3:6] = 0.0
        for axis in range(3):
            P[3 + axis, 3 + axis] = slip**2 + arm**2 * spin
    x[0:3] += 0.5 * dt * (x[3:6] + velocity)
    x[3:6] = velocity
    remember(memory, dt, rate, force, still, False)


class SeedScheme(ErrorStateFilter):
    """The scheme on a live stream, with the doors of the error-state filter.

    Parameters
    ----------
    config : ErrorStateConfig
        What is known of rig and motion; the estimate uses the gravity alone, P all of it.
    reset_s : float
        How long |w| must have been small for a reset [s]; 0 is the scheme as printed.
    """

    def __init__(self, config: ErrorStateConfig, reset_s: float = RESET_S) -> None:
        super().__init__(config)
        still = (config.zero_velocity_sigma, config.rolling_arm)
        self._law = np.array([config.gravity, reset_s, *still])
        self._own = np.zeros(4)
        self._rested = 0.0  # [s]
        self._settled = False
        self._mean = np.zeros(6)  # of rate and force, over the rest
        self._before = (self._R, self._P)  # as the rest began

    def reset_motion(self) -> None:
        """Put the origin here and stop, after a jump in time; keep the alignment."""
        super().reset_motion()
        self._own[:] = 0.0
        self._rested = 0.0

    def step(self, sample: Sample) -> None:
        """Move on by one finite sample at once; the first long rest aligns."""
        if not self._started:
            super().step(sample)
        else:
            seed_step(
                self._x, self._R, self._P, self._memory, self._own, self._settings,
                self._law, *sample[:6],
            )  # fmt: skip
        if not self._settled:
            self._gather(sample)

    def _gather(self, sample: Sample) -> None:
        """Average over a rest; what it says counts once it is long enough."""
        if not sample.resting:
            self._settled = self._rested >= ALIGNMENT_S
            self._rested = 0.0
            return
        if self._rested == 0.0:
            self._before = (self._R.copy(), self._P.copy())
        self._rested += sample.dt
        reading = np.concatenate((sample.angular_rate, sample.specific_force))
        self._mean += sample.dt / self._rested * (reading - self._mean)
        if self._rested >= ALIGNMENT_S:
            self._settle(sample)

    def _settle(self, sample: Sample) -> None:
        """Take gravity and gyro bias from the rest; P as if that were one measurement of each."""
        R, P = self._before
        bias = self._x[12:15]
        force = self._mean[3:] - bias
        yaw = R[2] @ P[6:9, 6:9] @ R[2]
        self._P[:] = P
        noise = sample.force_density**2 / self._rested
        align(self._x.copy(), self._R, self._P, self._mean[3:], noise, self._config.gravity)
        self._R[:] = levelled(R, force)
        self._P[6:9, 6:9] += yaw * np.outer(self._R[2], self._R[2])
        self._x[9:12] = self._mean[:3]
        self._P[9:12, :] = 0.0
        self._P[:, 9:12] = 0.0
        noise = sample.rate_density**2 + self._config.resting_walk**2
        self._P[9:12, 9:12] = np.diag(noise / self._rested)
        self._law[0] = np.sqrt(force @ force)
        self._own[:3] = self._R @ (sample.specific_force - bias)
        self._own[2] -= self._law[0]


def levelled(R: Matrix, force: Vector) -> Matrix:
    """Return the attitude (3, 3) in which `force` (3,) points up, with the yaw of `R` (3, 3)."""
    flat = level(force)
    turn = R @ flat.T
    sine, cosine = turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]
    length = np.hypot(sine, cosine)
    s, c = sine / length, cosine / length
    return product(np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]), flat)


def reckon_seeds(
    dt: Scalars,
    angular_rate: Vectors,
    specific_force: Vectors,
    still: Flags,
    resting: Flags,
    gravity: float,
    reset_s: float = RESET_S,
) -> Motion:
    """Run the scheme on a recording: the batch door.

    Parameters
    ----------
    dt : (N,) array
        Time since the sample before, at most 0.2 [s]; the first one counts for the rest alone.
    angular_rate, specific_force : (N, 3) arrays
        Readings in the body frame [rad/s], [m/s^2].
    still, resting : (N,) bool arrays
        Where the velocity may be set to zero; the first long run of the other aligns.
    gravity : float
        Used as long as there was no rest [m/s^2].
    reset_s : float
        How long |w| must have been small for a reset [s].

    Returns
    -------
    Motion
        At every sample.
    """
    rate = as_vectors(angular_rate, 'angular_rate')
    force = as_vectors(specific_force, 'specific_force')
    first, enough, end = _first_rest(dt, resting)
    weight = dt[first:end, np.newaxis]
    total = np.cumsum(weight, axis=0)
    mean = np.cumsum(weight * np.hstack((rate, force))[first:end], axis=0) / total
    R = attitude_rk4(level(force[0]), rate[:enough], dt[1:enough])
    g, bias = np.full(len(dt), gravity), np.zeros_like(rate)
    if enough < end:
        up = mean[enough - first :, 3:]
        flat = np.stack([levelled(R[first], each) for each in up])
        moving = attitude_rk4(flat[-1], rate[end - 1 :] - mean[-1, :3], dt[end:])
        R = np.concatenate((R, flat, moving[1:]))
        g[enough:end] = np.linalg.norm(up, axis=1)
        g[end:] = g[end - 1]
        bias[enough + 1 : end] = mean[enough - first : -1, :3]
        bias[end:] = mean[-1, :3]
    acceleration = np.einsum('nij,nj->ni', R, force)
    acceleration[:, 2] -= g
    acceleration[0] = 0.0
    gained = np.cumsum(_trapezoid(dt, acceleration), axis=0)
    calm = still & (np.sum((rate - bias) ** 2, axis=1) < RESET_RATE**2)
    since = np.cumsum(np.where(calm, dt, 0.0))
    lasted = since - np.maximum.accumulate(np.where(calm, 0.0, since))
    reset = lasted > (1.0 - 1e-6) * reset_s
    reset[0] = False
    velocity = gained - gained[np.maximum.accumulate(np.where(reset, np.arange(len(dt)), 0))]
    return Motion(np.cumsum(_trapezoid(dt, velocity), axis=0), velocity, R)


def _first_rest(dt: Scalars, resting: Flags) -> tuple[int, int, int]:
    """Return where the first long rest begins, is long enough, and ends; (0, N, N) if never."""
    first, rested = 0, 0.0
    for k, (step, rests) in enumerate(zip(dt, resting, strict=True)):
        if not rests:
            rested = 0.0
            continue
        first = k if rested == 0.0 else first
        rested += step
        if rested >= ALIGNMENT_S:
            moving = np.flatnonzero(~resting[k:])
            return first, k, k + int(moving[0]) if len(moving) else len(dt)
    return 0, len(dt), len(dt)


def _trapezoid(dt: Scalars, values: Vectors) -> Vectors:
    """Return what the mean of two neighbours adds in each step (N, 3); nothing in the first."""
    added = np.zeros_like(values)
    added[1:] = 0.5 * dt[1:, np.newaxis] * (values[1:] + values[:-1])
    return added
