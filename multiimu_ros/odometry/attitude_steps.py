"""Compiled kernels of the attitude filter; `attitude.py` tells the idea.

The error (12,) is (attitude, gyro bias, velocity, force bias), the last only considered (Schmidt).
Equations and their numbers are those of docs/derivations/attitude.md.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.kalman import (
    propagate,
    scalar_update,
    transform_block,
    white_equivalent,
)
from multiimu_ros.odometry.strapdown import curvature, increments
from multiimu_ros.rotations import exp_so3, product, renormalise, right_jacobian, skew

OUTAGE = 0.2  # [s] after longer ones the readings at the two ends have nothing in common
GAP = 0.05  # [s] longer steps hide motion: 20 Hz is the slowest IMU that we call one
LINEAR = 0.1  # [rad] of a larger sigma a linear filter makes turns out of the next second's noise
RADIAL_TIME = 1.0  # [s] memory of how strongly the rig accelerates
CREDIBLE_SQUARE = 16.0  # 4 sigma; beyond it a swinging foot that looks still for a moment
CONFIRMED = 0.1  # [s] no swing looks still for longer, but a running stance does
SIZE = 12  # of the error
ESTIMATED = 9  # of its entries

# Settings, those of `AttitudeConfig`; WALK are three, of the gyro bias.
MOTION, SLOW_SIGMA, SLOW_TIME, MOTION_RATE, RESTING_WALK, GRAVITY, WALK = range(7)
REACH, SCALE, ARM = 9, 10, 11
# Memory: the newest rate (three numbers), mean square of |f| - g, the rate before (three) and the
# time between the two; the newest force and the velocity (three each); time still; variance of
# yaw that is kept out of the filter.
RATE, RADIAL, RATE_BEFORE, DT_BEFORE, FORCE, VELOCITY, STOOD, YAW = 0, 3, 4, 7, 8, 11, 14, 15
MEMORY = 16


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
    h = np.zeros((3, SIZE))
    h[:, :3] = skew(expected)
    for axis in range(3):
        h[axis, ESTIMATED + axis] = 1.0
        residual = force[axis] - expected[axis]
        scalar_update(error, P, h[axis], residual, variance[axis], 0, ESTIMATED)


@compiled
def _update_direct(
    error: Vector, P: Matrix, measured: int, residual: Vector, variance: Vector
) -> None:
    """Correct by seeing three states, from `measured` on."""
    for axis in range(3):
        h = np.zeros(SIZE)
        h[measured + axis] = 1.0
        scalar_update(error, P, h, residual[axis], variance[axis], 0, ESTIMATED)


@compiled
def align(R: Matrix, P: Matrix, force: Vector, variance: Vector, gravity: float) -> None:
    """Level the attitude by a force whose noise and motion have `variance` (3,)."""
    R[:] = level(force)
    P[:3, :] = 0.0
    P[:, :3] = 0.0
    # A tilt of 1 rad is no knowledge; yaw is zero by definition.
    for i in range(3):
        for j in range(3):
            P[i, j] = (1.0 if i == j else 0.0) - R[2, i] * R[2, j]
    error = np.zeros(SIZE)
    # The direction is exact to first order, so only the covariance needs the update.
    length = np.sqrt(np.sum(force**2))
    _gravity_update(R, error, P, force * (gravity / length), gravity, variance)


@compiled
def _set_velocity(velocity: Vector, P: Matrix, variance: float) -> None:
    """Set the velocity to zero, with that variance."""
    velocity[:] = 0.0
    P[6:9, :] = 0.0
    P[:, 6:9] = 0.0
    for axis in range(6, 9):
        P[axis, axis] = variance


@compiled
def _advance(
    R: Matrix,
    bias: Vector,
    P: Matrix,
    memory: Vector,
    settings: Vector,
    dt: float,
    rate: Vector,
    force: Vector,
    rate_psd: Vector,
    tilting: float,
    force_psd: float,
) -> None:
    """Turn and speed up over one step (attitude.md (3), (6)); noise is [rad^2/s], [m^2/s^3].

    `tilting` is noise of all axes but the vertical.
    """
    earlier = memory[RATE:RADIAL]
    bend = curvature(memory[RATE_BEFORE:DT_BEFORE], earlier, rate, memory[DT_BEFORE], dt) - bias
    if dt > OUTAGE:
        bend = -bias
    phi, dv, _ = increments(earlier + bend, memory[FORCE:VELOCITY], rate + bend, force, dt)
    F = np.eye(SIZE)
    F[:3, :3] = exp_so3(-phi)
    F[:3, 3:6] = -dt * right_jacobian(phi)
    F[6:9, :3] = -product(R, skew(dv))
    F[6:9, 9:12] = -dt * R
    propagate(P, F)
    memory[VELOCITY:STOOD] += product(R, dv.reshape(3, 1)).ravel()
    memory[VELOCITY + 2] -= settings[GRAVITY] * dt
    R[:] = renormalise(product(R, exp_so3(phi)))
    for i in range(3):
        walk = settings[WALK + i] ** 2
        P[i, i] += rate_psd[i] * dt + walk * dt**3 / 3.0
        P[i, 3 + i] -= walk * dt**2 / 2.0
        P[3 + i, i] -= walk * dt**2 / 2.0
        P[3 + i, 3 + i] += walk * dt
        P[i, i] += tilting * dt
        for j in range(3):
            P[i, j] -= tilting * dt * R[2, i] * R[2, j]
        P[6 + i, 6 + i] += force_psd * dt


@compiled
def _credible(velocity: Vector, P: Matrix, variance: float) -> bool:
    """Say whether the velocity could be zero, going by its own uncertainty."""
    expected = P[6, 6] + P[7, 7] + P[8, 8] + 3.0 * variance
    return bool(np.sum(velocity**2) < CREDIBLE_SQUARE * expected)


@compiled
def _correct_moving(
    R: Matrix,
    bias: Vector,
    error: Vector,
    P: Matrix,
    memory: Vector,
    settings: Vector,
    dt: float,
    rate: Vector,
    force: Vector,
    white: Vector,
    sigma: float,
) -> None:
    """Use that the velocity of a rig that accelerates by `sigma` is bounded (attitude.md (7))."""
    velocity, reach, gravity = memory[VELOCITY:STOOD], settings[REACH], settings[GRAVITY]
    if dt > OUTAGE:  # level anew what may have been tilted unseen, as at the start
        _set_velocity(velocity, P, sigma * reach)
        _gravity_update(R, error, P, force, gravity, white + sigma**2)
        return
    variance = white_equivalent(np.sqrt(sigma * reach), np.sqrt(reach / sigma), dt)
    if memory[STOOD] > 0.0:
        roll = settings[ARM] ** 2 * np.sum((rate - bias) ** 2)
        slow = white_equivalent(np.sqrt(settings[SLOW_SIGMA] ** 2 + roll), settings[SLOW_TIME], dt)
        if memory[STOOD] > CONFIRMED or _credible(velocity, P, slow):
            variance = slow
    _update_direct(error, P, 6, -velocity, np.full(3, variance))


@compiled
def _rest(
    bias: Vector,
    error: Vector,
    P: Matrix,
    memory: Vector,
    settings: Vector,
    dt: float,
    rate: Vector,
    variance: Vector,
) -> None:
    """Hold the attitude, and learn the bias from a rate with noise of `variance` (3,)."""
    _set_velocity(memory[VELOCITY:STOOD], P, 0.0)
    for axis in range(3):
        P[axis, axis] += settings[RESTING_WALK] ** 2 * dt
        P[3 + axis, 3 + axis] += settings[WALK + axis] ** 2 * dt
    _update_direct(error, P, 3, rate - bias, variance)


@compiled
def told_covariance(R: Matrix, P: Matrix, memory: Vector) -> Matrix:
    """Return the covariance (6, 6) of attitude and gyro bias, with what gaps left of yaw unseen.

    Inside, a yaw unknown by a radian would soon be believed: what is second order in it looks
    like information.
    """
    told = P[:6, :6].copy()
    for i in range(3):
        for j in range(3):
            told[i, j] += memory[YAW] * R[2, i] * R[2, j]
    return told


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
    """Take one sample."""
    error = np.zeros(SIZE)
    memory[STOOD] = memory[STOOD] + dt if still else 0.0
    white = force_density**2 / dt
    radial = np.sqrt(np.sum(force**2)) - settings[GRAVITY]
    memory[RADIAL] += dt / (RADIAL_TIME + dt) * (radial * radial - memory[RADIAL])
    if resting:
        _rest(bias, error, P, memory, settings, dt, rate, rate_density**2 / dt)
        _gravity_update(R, error, P, force, settings[GRAVITY], white)
    else:
        sigma = max(settings[MOTION], np.sqrt(memory[RADIAL]))
        hidden = max(0.0, dt - GAP) ** 2 / dt
        scale = settings[SCALE] ** 2 * np.sqrt(settings[REACH] / sigma)  # (5)
        yawing = scale * np.sum((rate - bias) * R[2]) ** 2
        tilting = scale * np.sum((rate - bias) ** 2) - yawing
        feared = hidden * settings[MOTION_RATE] ** 2
        unseen = min(feared, LINEAR**2 / dt)
        memory[YAW] += (feared - unseen) * dt
        rate_psd = rate_density**2 + (unseen + yawing)
        force_psd = np.mean(force_density**2) + hidden * settings[MOTION] ** 2
        _advance(R, bias, P, memory, settings, dt, rate, force, rate_psd, tilting, force_psd)
        _correct_moving(R, bias, error, P, memory, settings, dt, rate, force, white, sigma)
    R[:] = renormalise(product(R, exp_so3(error[:3])))  # (13)
    bias += error[3:6]
    memory[VELOCITY:STOOD] += error[6:9]
    transform_block(P, exp_so3(-error[:3]), 0)
    memory[RATE_BEFORE:DT_BEFORE], memory[DT_BEFORE] = memory[RATE:RADIAL], dt
    memory[RATE:RADIAL], memory[FORCE:VELOCITY] = rate, force
