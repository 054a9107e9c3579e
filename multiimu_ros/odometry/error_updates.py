"""Compiled kernels of the 15-state error-state filter: what the measurements correct.

State and error are those of `error_dynamics`, the equations those of
docs/derivations/error_state.md.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.attitude_steps import CONFIRMED, CREDIBLE_SQUARE, level, OUTAGE
from multiimu_ros.odometry.error_fields import (
    CORRECTED,
    EXPECTED,
    FASTEST,
    GRAVITY,
    LEARNING_STRIDES,
    LEARNT,
    MOTION_FORCE,
    MOVED,
    RESTED,
    RESTING_SIGMA,
    ROLLING_ARM,
    ROLLING_HEIGHT,
    SETTLING_TIME,
    STANCE_SIGMA,
    STANCE_TIME,
    STANCES_TEACH,
    STOOD,
    TURNED,
)
from multiimu_ros.odometry.kalman import (
    correct,
    innovate,
    scalar_update,
    transform_block,
    white_equivalent,
)
from multiimu_ros.rotations import exp_so3, product, renormalise, skew

SLOWED_SQUARE = 0.25  # a stance begins below half of the greatest speed since the last one
SWING = 0.03  # [s] a shorter one is a stance in which the detector wavered
SURPRISE = 4.0  # a stance whose correction is worse than this is itself a fault
LEAST_LEARNT = -9.2  # ln 1e-4: below a hundredth of the profile's errors they do not matter


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
def _see_stance(
    error: Vector, P: Matrix, up: Vector, residual: Vector, variance: float, teaches: bool
) -> None:
    """Correct by the velocity of a stance; `up` (3,) is the vertical in the body frame.

    What each swing leaves again (scale, g-sensitivity, bandwidth) would pass for gyro bias and
    yaw, of which stances tell nothing by themselves.  Unless a stance `teaches`, these are only
    considered.
    """
    for axis in range(3):
        h = np.zeros(15)
        h[3 + axis] = 1.0
        a, s, innovation = innovate(error, P, h, residual[axis], variance)
        if s > 0.0:
            K = a / s
            if not teaches:
                K[6:9] -= up * np.sum(up * K[6:9])
                K[9:12] = 0.0
            correct(error, P, K, a, s, innovation)


@compiled
def _see_velocity(
    x: Vector,
    R: Matrix,
    P: Matrix,
    memory: Vector,
    velocity: Vector,
    variance: float,
    teaches: bool,
) -> None:
    """Give the rig this velocity (3,), and note for `_learn_swing` by how much it was off."""
    error = np.zeros(15)
    before = P[3, 3] + P[4, 4] + P[5, 5]
    _see_stance(error, P, R[2].copy(), velocity - x[3:6], variance, teaches)
    memory[CORRECTED:EXPECTED] += error[3:6]
    memory[EXPECTED] += before - P[3, 3] - P[4, 4] - P[5, 5]
    _inject(x, R, P, error)


@compiled
def _credible(x: Vector, P: Matrix, memory: Vector, variance: float) -> bool:
    """Say whether the rig could stand, by the uncertainty of its speed and by how fast it was."""
    expected = P[3, 3] + P[4, 4] + P[5, 5] + 3.0 * variance
    square = x[3] ** 2 + x[4] ** 2 + x[5] ** 2
    slow = max(SLOWED_SQUARE * memory[FASTEST], expected / 3.0)
    slowed = memory[FASTEST] < 0.0 or square <= slow
    return bool(slowed and square < CREDIBLE_SQUARE * expected)


@compiled
def _learn_swing(memory: Vector, strides: float) -> None:
    """After a stance, learn how large the errors of a swing are (error_state.md (13))."""
    if strides > 0.0:
        surprise = np.sum(memory[CORRECTED:EXPECTED] ** 2) / memory[EXPECTED]
        learnt = memory[LEARNT] + np.log1p((min(surprise, SURPRISE) - 1.0) / strides)
        memory[LEARNT] = max(learnt, LEAST_LEARNT)
    memory[CORRECTED:EXPECTED] = 0.0
    memory[EXPECTED] = 0.0


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
    if resting and memory[RESTED] == 0.0:
        variance = white_equivalent(settings[RESTING_SIGMA], settings[STANCE_TIME], dt)
        teaches = settings[STANCES_TEACH] > 0.0
        _see_velocity(x, R, P, memory, np.zeros(3), variance, teaches)


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
    gravity = settings[GRAVITY]
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
        variance = force_density**2 / dt + settings[MOTION_FORCE] ** 2
        _update_gravity(error, P, R, residual, variance, gravity)
        _inject(x, R, P, error)
    turn = rate - x[9:12]
    fades = settings[SETTLING_TIME] > 0.0
    # The heel comes down before the sole: the rate at which a stance began counts for a while.
    memory[TURNED] *= np.exp(-dt / settings[SETTLING_TIME]) if still and fades else 0.0
    memory[TURNED] = max(np.sum(turn**2), memory[TURNED])
    if still:
        _stand(x, R, P, memory, settings, dt, turn)
    else:
        memory[FASTEST] = max(memory[FASTEST], np.sum(x[3:6] ** 2))
        if memory[EXPECTED] > 0.0 and memory[MOVED] > SWING:
            _learn_swing(memory, settings[LEARNING_STRIDES])


@compiled
def _stand(
    x: Vector, R: Matrix, P: Matrix, memory: Vector, settings: Vector, dt: float, turn: Vector
) -> None:
    """Correct by a stance, if it is to be believed: a foot rolls about a point below the IMU."""
    sigma = np.sqrt(settings[STANCE_SIGMA] ** 2 + settings[ROLLING_ARM] ** 2 * memory[TURNED])
    variance = white_equivalent(sigma, settings[STANCE_TIME], dt)
    if memory[STOOD] > CONFIRMED or _credible(x, P, memory, variance):
        turn_n = R @ turn
        velocity = settings[ROLLING_HEIGHT] * np.array([turn_n[1], -turn_n[0], 0.0])
        _see_velocity(x, R, P, memory, velocity, variance, settings[STANCES_TEACH] > 0.0)
        memory[FASTEST] = -1.0
