"""The forces of a scan brought to the base origin, with what is known of the turn.

    f_0 = f_i - a x r_i - w x (w x r_i)

The rate w is fused already; the angular acceleration a is that of `array_acceleration`, or across
a saturation that of the bridge.  An error of either moves the fused force only as far as the
array does not balance about the base origin.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.array_acceleration import (
    array_acceleration,
    slope_variance,
    turning_variance,
)
from multiimu_ros.fusion.bridging import note_walk
from multiimu_ros.fusion.faults import judge
from multiimu_ros.fusion.fusion_state import (
    BRIDGED,
    FORCES,
    FusionState,
    GUARD,
    INTERVAL,
    PERIOD,
    SLOPE,
    VALUE,
    VARIANCE,
)
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.rigid_body import lever_arm_matrix, push_slope, SLOPE_WINDOW
from multiimu_ros.fusion.scan_noise import cross_variance, slow_variance


@compiled
def level(
    model: RigModel, state: FusionState, settings: Vector, stamp: int, z: Vectors, R: Vectors
) -> None:
    """Take the lever arms out of the forces in `z`; the rates are fused already."""
    rate, P = state.fused[VALUE, :3], state.fused[VARIANCE, :3]
    slope, gain = push_slope(state.stamps, state.rates, state.scans, stamp, rate)
    noise = np.empty(3)
    for axis in range(3):  # what the motion allows is known even where no slope is
        noise[axis] = min(gain * P[axis], settings[axis] ** 2)
    P_slope = _slope_variance(state, slope, noise)
    if state.clock[BRIDGED] > 0.0:
        slope[:] = state.bridge[0, 3:]
        for axis in range(3):
            noise[axis] = P_slope[axis] = state.bridge[4 + axis, 3 + axis]
    state.spread[:] = 0.0
    if settings[GUARD] > 0.0:
        judge_forces(model, state, z, R, rate, slope, noise, P_slope)
    acceleration, P_a = slope, state.bridge[4:, 3:].copy()
    if state.clock[BRIDGED] == 0.0:
        unlike = R[:, 3:] + slow_variance(model, state, FORCES, z, state.spread)
        acceleration, P_a = array_acceleration(
            z[:, 3:], unlike, model.lever_arms_b, rate, slope, P_slope
        )
        if state.scans[0] > 2:
            note_walk(state, P, acceleration, P_a)
    state.fused[SLOPE, :3], state.spread[:] = acceleration, P_a
    z[:, 3:] = at_origin(model, z, lever_arm_matrix(rate, acceleration))


@compiled
def _slope_variance(state: FusionState, slope: Vector, noise: Vector) -> Vector:
    """Return the variance (3,) of the slope; where a stride begins, of what it lags behind too."""
    P_slope = slope_variance(slope, noise, max(SLOPE_WINDOW, 2.0 * state.clock[PERIOD]))
    hurry = 0.0
    for axis in range(3):
        change = slope[axis] - state.fused[SLOPE, axis]
        hurry += max(change * change - 9.0 * noise[axis], 0.0)
    for axis in range(3):
        P_slope[axis] += 4.0 * hurry
    return P_slope


@compiled
def at_origin(model: RigModel, z: Vectors, L: Matrix) -> Vectors:
    """Return the forces (K, 3) of z (K, 6) without their lever arms."""
    force = z[:, 3:].copy()
    for i in range(len(z)):
        arm = model.lever_arms_b[i]
        for row in range(3):
            force[i, row] -= L[row, 0] * arm[0] + L[row, 1] * arm[1] + L[row, 2] * arm[2]
    return force


@compiled
def judge_forces(
    model: RigModel,
    state: FusionState,
    z: Vectors,
    R: Vectors,
    rate: Vector,
    slope: Vector,
    noise: Vector,
    P_slope: Vector,
) -> None:
    """Judge forces whose lever arms the gyroscopes alone took out.

    A broken accelerometer would turn the array's angular acceleration, and with it what all the
    others seem to read.
    """
    force = at_origin(model, z, lever_arm_matrix(rate, slope))
    slow = slow_variance(model, state, FORCES, z, np.diag(P_slope - noise))
    white = R[:, 3:].copy()
    for i in range(len(z)):
        white[i] += cross_variance(model.lever_arms_b[i], np.diag(noise))
    judged = white.copy()
    judge(state.guard, FORCES, force, judged, slow, state.clock[INTERVAL])
    for i in range(len(z)):
        for axis in range(3):
            if judged[i, axis] != white[i, axis]:
                R[i, 3 + axis] *= judged[i, axis] / white[i, axis]


@compiled
def levelling_variance(model: RigModel, state: FusionState, b: Vectors) -> Vector:
    """Return what the errors of w and a add to the variance (3,) of the fused force.

    Parameters
    ----------
    b : (K, 6) array
        Shares of the IMUs; their weighted mean arm is what the errors act at.
    """
    w, P = state.fused[VALUE, :3], state.fused[VARIANCE, :3]
    added = turning_variance(b[:, 3:], model.lever_arms_b, state.spread)
    arm = np.zeros(3)
    for axis in range(3):
        arm[:] = 0.0
        for i in range(len(b)):
            for k in range(3):
                arm[k] += b[i, 3 + axis] * model.lever_arms_b[i, k]
        # d (w x (w x r)) / dw = w r' + (w . r) I - 2 r w'
        for k in range(3):
            J = w[axis] * arm[k] - 2.0 * arm[axis] * w[k]
            if k == axis:
                J += w[0] * arm[0] + w[1] * arm[1] + w[2] * arm[2]
            added[axis] += J * J * P[k]
    return added
