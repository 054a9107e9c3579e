"""Compiled kernels of the 15-state error-state filter: what the measurements correct.

State and error are those of `error_dynamics`, the equations those of
docs/derivations/error_state.md.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude_steps import CONFIRMED, CREDIBLE_SQUARE, level, OUTAGE
from multiimu_ros.odometry.kalman import scalar_update, transform_block, white_equivalent
from multiimu_ros.rotations import exp_so3, product, renormalise, skew

SLOWED_SQUARE = 0.25  # a stance begins below half of the greatest speed since the last one
SWING = 0.03  # [s] a shorter one is a stance in which the detector wavered
SURPRISE = 4.0  # a stance whose correction is worse than this is itself a fault
LEAST_LEARNT = -9.2  # ln 1e-4: below a hundredth of the profile's errors they do not matter
LEARNT = 15  # field of the memory: logarithm of what a swing adds to the velocity's variance


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
def _zero_velocity(x: Vector, R: Matrix, P: Matrix, memory: Vector, variance: float) -> None:
    error = np.zeros(15)
    before = P[3, 3] + P[4, 4] + P[5, 5]
    _update_direct(error, P, 3, -x[3:6], np.full(3, variance), 0)
    memory[16:19] += error[3:6]
    memory[19] += before - P[3, 3] - P[4, 4] - P[5, 5]
    _inject(x, R, P, error)


@compiled
def _credible(x: Vector, P: Matrix, memory: Vector, variance: float) -> bool:
    """Say whether the rig could stand, going by the uncertainty of its speed and by that before.

    `memory[20]` is the fastest square since the last stance, -1 once the stance has begun.
    """
    expected = P[3, 3] + P[4, 4] + P[5, 5] + 3.0 * variance
    square = x[3] ** 2 + x[4] ** 2 + x[5] ** 2
    slowed = memory[20] < 0.0 or square <= max(SLOWED_SQUARE * memory[20], expected / 3.0)
    return bool(slowed and square < CREDIBLE_SQUARE * expected)


@compiled
def _learn_swing(memory: Vector, strides: float) -> None:
    """After a stance, learn how large the errors of a swing are (error_state.md (13))."""
    if strides > 0.0:
        surprise = np.sum(memory[16:19] ** 2) / memory[19]
        learnt = memory[LEARNT] + np.log1p((min(surprise, SURPRISE) - 1.0) / strides)
        memory[LEARNT] = max(learnt, LEAST_LEARNT)
    memory[16:20] = 0.0


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
def begin_rest(
    x: Vector, R: Matrix, P: Matrix, memory: Vector, settings: Vector, dt: float, resting: bool
) -> None:
    """Where a rest begins, use the last of what the velocity tells about the other states."""
    if resting and memory[6] == 0.0:
        _zero_velocity(x, R, P, memory, white_equivalent(settings[3], settings[2], dt))


@compiled
def update(
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
    """Correct x, R and P by what the newest sample tells."""
    gravity = settings[0]
    if resting:
        # What a rest tells of biases and tilt could move the position in retrospect; whoever
        # looks on would see a standing rig move, so it is only considered.
        error = np.zeros(15)
        _update_direct(error, P, 9, rate - x[9:12], rate_density**2 / dt, 3)
        residual = force - x[12:15] - gravity * R[2]
        _update_gravity(error, P, R, residual, force_density**2 / dt, gravity)
        _inject(x, R, P, error)
        return
    if dt > OUTAGE:  # level anew what may have been tilted unseen, as at the start
        error = np.zeros(15)
        residual = force - x[12:15] - gravity * R[2]
        variance = force_density**2 / dt + settings[6] ** 2
        _update_gravity(error, P, R, residual, variance, gravity)
        _inject(x, R, P, error)
    if still:
        roll = settings[15] ** 2 * np.sum((rate - x[9:12]) ** 2)
        sigma = np.sqrt(settings[1] ** 2 + roll)
        variance = white_equivalent(sigma, settings[2], dt)
        if memory[7] > CONFIRMED or _credible(x, P, memory, variance):
            _zero_velocity(x, R, P, memory, variance)
            memory[20] = -1.0
    else:
        memory[20] = max(memory[20], np.sum(x[3:6] ** 2))
        if memory[19] > 0.0 and memory[21] > SWING:
            _learn_swing(memory, settings[16])
