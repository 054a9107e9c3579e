"""Compiled kernels of the 15-state error-state filter; `error_state.py` tells the idea.

State x (15,) is (position, velocity, unused, gyro bias, accel bias) with the attitude apart in
R (3, 3); the error has the attitude in the unused slot.  Equations and their numbers are those
of docs/derivations/error_state.md.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude import GAP, level, OUTAGE
from multiimu_ros.odometry.kalman import (
    propagate,
    scalar_update,
    transform_block,
    white_equivalent,
)
from multiimu_ros.odometry.strapdown import curvature, increments
from multiimu_ros.rotations import exp_so3, product, renormalise, right_jacobian, skew

CREDIBLE_SQUARE = 16.0  # 4 sigma; beyond it a swinging foot that looks still for a moment
LINEAR = 0.1  # [rad] of a larger sigma a linear filter makes turns out of the next second's noise
CONFIRMED = 0.1  # [s] no swing looks still for longer, but a running stance does


@compiled
def transition(R: Matrix, phi: Vector, dv: Vector, dp: Vector, dt: float) -> Matrix:
    """Return F (15, 15) of one strapdown step (error_state.md (3)).

    Parameters
    ----------
    R : (3, 3) array
        Attitude at the start of the step.
    phi, dv, dp : (3,) arrays
        Its increments, from `strapdown.increments`.
    dt : float
        Its length [s].
    """
    F = np.eye(15)
    turn = skew(phi)
    for i in range(3):
        F[i, 3 + i] = dt
    F[0:3, 6:9] = -product(R, skew(dp))
    F[0:3, 9:12] = dt * dt / 6.0 * product(R, skew(dv))
    F[0:3, 12:15] = -0.5 * dt * dt * (R + product(R, turn) / 3.0)
    F[3:6, 6:9] = -product(R, skew(dv))
    F[3:6, 9:12] = 0.5 * dt * product(R, skew(dv))
    F[3:6, 12:15] = -dt * product(R, right_jacobian(-phi))
    F[6:9, 6:9] = exp_so3(-phi)
    F[6:9, 9:12] = -dt * right_jacobian(phi)
    return F


@compiled
def _add_noise(
    P: Matrix, R: Matrix, rate_psd: Vector, force_psd: Vector, walks: Vector, dt: float
) -> None:
    """Add what a step's white noises and bias walks do (error_state.md (5))."""
    for i in range(3):
        for j in range(3):
            psd = 0.0
            for k in range(3):
                psd += R[i, k] * R[j, k] * force_psd[k]
            P[i, j] += psd * dt**3 / 3.0
            P[i, 3 + j] += psd * dt**2 / 2.0
            P[3 + i, j] += psd * dt**2 / 2.0
            P[3 + i, 3 + j] += psd * dt
        P[6 + i, 6 + i] += rate_psd[i] * dt + walks[i] * dt**3 / 3.0
        P[6 + i, 9 + i] -= walks[i] * dt**2 / 2.0
        P[9 + i, 6 + i] -= walks[i] * dt**2 / 2.0
        P[9 + i, 9 + i] += walks[i] * dt
        P[12 + i, 12 + i] += walks[3 + i] * dt


@compiled
def _move(
    x: Vector,
    R: Matrix,
    P: Matrix,
    rate0: Vector,
    force0: Vector,
    rate1: Vector,
    force1: Vector,
    dt: float,
    gravity: float,
) -> None:
    """Advance the state x (15,) = (p, v, -, gyro bias, accel bias), R and P by one step."""
    phi, dv, dp = increments(
        rate0 - x[9:12], force0 - x[12:15], rate1 - x[9:12], force1 - x[12:15], dt
    )
    F = transition(R, phi, dv, dp, dt)
    propagate(P, F)
    x[0:3] += dt * x[3:6] + R @ dp
    x[3:6] += R @ dv
    x[2] -= 0.5 * gravity * dt * dt
    x[5] -= gravity * dt
    R[:] = renormalise(product(R, exp_so3(phi)))


@compiled
def _coast(x: Vector, R: Matrix, P: Matrix, phi: Vector, dt: float) -> None:
    """Bridge an outage: the velocity stays, the attitude turns by `phi`.

    Integrated over seconds, the noise of the readings at its two ends would be a motion.
    """
    F = np.eye(15)
    for i in range(3):
        F[i, 3 + i] = dt
        F[6 + i, 9 + i] = -dt
    F[6:9, 6:9] = exp_so3(-phi)
    propagate(P, F)
    x[0:3] += dt * x[3:6]
    R[:] = renormalise(product(R, exp_so3(phi)))


@compiled
def _update_direct(
    error: Vector, P: Matrix, measured: int, residual: Vector, variance: Vector, first: int
) -> None:
    """Correct the states from `first` on by seeing three states, from `measured` on."""
    for axis in range(3):
        h = np.zeros(15)
        h[measured + axis] = 1.0
        scalar_update(error, P, h, residual[axis], variance[axis], first, 15)


@compiled
def _update_gravity(
    error: Vector, P: Matrix, R: Matrix, residual: Vector, variance: Vector, gravity: float
) -> None:
    """Correct all but the position by force = R' g + accel bias + noise."""
    h = np.zeros((3, 15))
    h[:, 6:9] = skew(gravity * R[2])
    for axis in range(3):
        h[axis, 12 + axis] = 1.0
        scalar_update(error, P, h[axis], residual[axis], variance[axis], 3, 15)


@compiled
def _inject(x: Vector, R: Matrix, P: Matrix, error: Vector) -> None:
    """Move the estimated error into the state (error_state.md (8))."""
    x += error
    x[6:9] = 0.0
    R[:] = renormalise(product(R, exp_so3(error[6:9])))
    transform_block(P, exp_so3(-error[6:9]), 6)


@compiled
def _zero_velocity(x: Vector, R: Matrix, P: Matrix, variance: float) -> None:
    error = np.zeros(15)
    _update_direct(error, P, 3, -x[3:6], np.full(3, variance), 0)
    _inject(x, R, P, error)


@compiled
def _credible(x: Vector, P: Matrix, variance: float) -> bool:
    """Say whether the estimated velocity could be zero, going by its own uncertainty."""
    expected = P[3, 3] + P[4, 4] + P[5, 5] + 3.0 * variance
    return bool(x[3] ** 2 + x[4] ** 2 + x[5] ** 2 < CREDIBLE_SQUARE * expected)


@compiled
def _hold(x: Vector, P: Matrix, velocity: float, turn: float, walks: Vector) -> None:
    """Set the velocity to zero but for a tremor that no other state shares; let the rest walk.

    `velocity`, `turn` and `walks` (6,) are the variances of tremor, attitude and biases.
    """
    x[3:6] = 0.0
    P[3:6, :] = 0.0
    P[:, 3:6] = 0.0
    for i in range(3):
        P[3 + i, 3 + i] = velocity
        P[6 + i, 6 + i] += turn
        P[9 + i, 9 + i] += walks[i]
        P[12 + i, 12 + i] += walks[3 + i]


@compiled
def align(
    x: Vector, R: Matrix, P: Matrix, force: Vector, variance: Vector, gravity: float
) -> None:
    """Level the attitude by a force whose noise and motion have `variance` (3,)."""
    corrected = force - x[12:15]
    R[:] = level(corrected)
    P[6:9, :] = 0.0
    P[:, 6:9] = 0.0
    for i in range(3):  # a tilt of 1 rad is no knowledge; yaw is zero by definition
        for j in range(3):
            P[6 + i, 6 + j] = (1.0 if i == j else 0.0) - R[2, i] * R[2, j]
    # `level` leaves no residual but in the length, which speaks of the bias alone.
    error = np.zeros(15)
    _update_gravity(error, P, R, corrected - gravity * R[2], variance, gravity)
    _inject(x, R, P, error)


@compiled
def step(
    x: Vector,
    R: Matrix,
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
    """Take one sample; `memory` (15,): last rate, force, rest, time still; those before, dt."""
    gravity, velocity_sigma, velocity_time, resting_velocity, resting_walk = settings[:5]
    walks = settings[9:15] ** 2
    if resting:
        if memory[6] == 0.0:  # the last of what the velocity tells about the other states
            _zero_velocity(x, R, P, white_equivalent(resting_velocity, velocity_time, dt))
        _hold(x, P, resting_velocity**2, resting_walk**2 * dt, walks * dt)
        # What a rest tells of biases and tilt could move the position in retrospect; whoever
        # looks on would see a standing rig move, so it is only considered.
        error = np.zeros(15)
        _update_direct(error, P, 9, rate - x[9:12], rate_density**2 / dt, 3)
        residual = force - x[12:15] - gravity * R[2]
        _update_gravity(error, P, R, residual, force_density**2 / dt, gravity)
        _inject(x, R, P, error)
    else:
        hidden = max(0.0, dt - GAP) ** 2 / dt
        rate_psd = rate_density**2 + min(hidden * settings[5] ** 2, LINEAR**2 / dt)
        force_psd = force_density**2 + hidden * settings[6] ** 2
        rate_psd = rate_psd + settings[7] ** 2 * np.sum((rate - x[9:12]) ** 2) * dt
        force_psd = force_psd + settings[8] ** 2 * np.sum((force - gravity * R[2]) ** 2) * dt
        R0 = R.copy()
        turn = curvature(memory[8:11], memory[:3], rate, memory[14], dt)
        push = curvature(memory[11:14], memory[3:6], force, memory[14], dt)
        if dt > OUTAGE:
            phi = dt * (0.5 * (memory[:3] + rate) - x[9:12])
            _coast(x, R, P, phi * (1.0 - memory[6]), dt)  # what rested most likely still does
        else:
            _move(
                x, R, P, memory[:3] + turn, memory[3:6] + push, rate + turn, force + push,
                dt, gravity,
            )  # fmt: skip
        _add_noise(P, R0, rate_psd, force_psd, walks, dt)
        if dt > OUTAGE:  # level anew what may have been tilted unseen, as at the start
            error = np.zeros(15)
            residual = force - x[12:15] - gravity * R[2]
            variance = force_density**2 / dt + settings[6] ** 2
            _update_gravity(error, P, R, residual, variance, gravity)
            _inject(x, R, P, error)
        if still:
            roll = settings[15] ** 2 * np.sum((rate - x[9:12]) ** 2)
            sigma = np.sqrt(velocity_sigma**2 + roll)
            variance = white_equivalent(sigma, velocity_time, dt)
            if memory[7] > CONFIRMED or _credible(x, P, variance):
                _zero_velocity(x, R, P, variance)
    memory[7] = memory[7] + dt if still else 0.0
    memory[8:14], memory[14] = memory[:6], dt
    memory[:3], memory[3:6], memory[6] = rate, force, 1.0 if resting else 0.0
