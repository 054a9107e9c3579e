"""Compiled kernels of the 15-state error-state filter; `error_state.py` tells the idea.

State x (15,) is (position, velocity, unused, gyro bias, accel bias) with the attitude apart in
R (3, 3); the error has the attitude in the unused slot.  Equations and their numbers are those
of docs/derivations/error_state.md.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude_steps import GAP, LINEAR, OUTAGE
from multiimu_ros.odometry.error_fields import (
    DT_BEFORE,
    FORCE,
    FORCE_BEFORE,
    FORCE_SCALE,
    GRAVITY,
    LEARNT,
    MOTION_FORCE,
    MOTION_RATE,
    MOVED,
    RATE,
    RATE_BEFORE,
    RATE_SCALE,
    RESTED,
    RESTING_SIGMA,
    RESTING_WALK,
    ROLLING_ARM,
    STOOD,
    WALKS,
)
from multiimu_ros.odometry.error_updates import begin_rest, update
from multiimu_ros.odometry.kalman import propagate
from multiimu_ros.odometry.strapdown import curvature, increments
from multiimu_ros.rotations import exp_so3, product, renormalise, right_jacobian, skew


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
) -> Matrix:
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
    return F


@compiled
def _coast(x: Vector, R: Matrix, P: Matrix, phi: Vector, dt: float) -> Matrix:
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
    return F


@compiled
def _hold(x: Vector, P: Matrix, velocity: float, turn: float, walks: Vector) -> Matrix:
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
    F = np.eye(15)
    F[3:6, 3:6] = 0.0
    return F


@compiled
def predict(
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
    resting: bool,
) -> Matrix:
    """Move x, R and P on by `dt`, to the newest sample; return F (15, 15) of this step."""
    walks = settings[WALKS:ROLLING_ARM] ** 2
    if resting:
        tremor, tilting = settings[RESTING_SIGMA] ** 2, settings[RESTING_WALK] ** 2 * dt
        return _hold(x, P, tremor, tilting, walks * dt)
    hidden = max(0.0, dt - GAP) ** 2 / dt
    rate_psd = rate_density**2 + min(hidden * settings[MOTION_RATE] ** 2, LINEAR**2 / dt)
    force_psd = force_density**2 + hidden * settings[MOTION_FORCE] ** 2
    learnt = np.exp(memory[LEARNT]) * dt
    rate_psd = rate_psd + learnt * settings[RATE_SCALE] ** 2 * np.sum((rate - x[9:12]) ** 2)
    motion = force - settings[GRAVITY] * R[2]
    force_psd = force_psd + learnt * settings[FORCE_SCALE] ** 2 * np.sum(motion**2)
    R0 = R.copy()
    if dt > OUTAGE:
        phi = dt * (0.5 * (memory[RATE:FORCE] + rate) - x[9:12])
        F = _coast(x, R, P, phi * (1.0 - memory[RESTED]), dt)  # what rested most likely still does
    else:
        rate0, force0, before = memory[RATE:FORCE], memory[FORCE:RESTED], memory[DT_BEFORE]
        turn = curvature(memory[RATE_BEFORE:FORCE_BEFORE], rate0, rate, before, dt)
        push = curvature(memory[FORCE_BEFORE:DT_BEFORE], force0, force, before, dt)
        F = _move(
            x, R, P, rate0 + turn, force0 + push, rate + turn, force + push,
            dt, settings[GRAVITY],
        )  # fmt: skip
    _add_noise(P, R0, rate_psd, force_psd, walks, dt)
    return F


@compiled
def remember(
    memory: Vector, dt: float, rate: Vector, force: Vector, still: bool, resting: bool
) -> None:
    """Keep the newest sample in `memory` (MEMORY,)."""
    memory[STOOD] = memory[STOOD] + dt if still else 0.0
    memory[MOVED] = 0.0 if still else memory[MOVED] + dt
    memory[RATE_BEFORE:DT_BEFORE], memory[DT_BEFORE] = memory[RATE:RESTED], dt
    memory[RATE:FORCE], memory[FORCE:RESTED] = rate, force
    memory[RESTED] = 1.0 if resting else 0.0


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
    """Take one sample."""
    begin_rest(x, R, P, memory, settings, dt, resting)
    predict(x, R, P, memory, settings, dt, rate, force, rate_density, force_density, resting)
    update(x, R, P, memory, settings, dt, rate, force, rate_density, force_density, still, resting)
    remember(memory, dt, rate, force, still, resting)
