"""The forces of a scan brought to the base origin, with what is known of the turn.

    f_0 = f_i - a x r_i - w x (w x r_i)

The rate w is fused already; the angular acceleration a is that of `array_acceleration`, or across
a saturation that of the bridge.  An error of either moves the fused force only as far as the
array does not balance about the base origin.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.array_acceleration import (
    array_acceleration,
    HASTE,
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
    SWUNG,
    TURNED,
    VALUE,
    VARIANCE,
)
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.rigid_body import lever_arm_matrix, push_slope, SLOPE_WINDOW
from multiimu_ros.fusion.scan_noise import cross_variance, slow_variance

SWING_MEMORY = 0.5  # [s] that the mean squares of the motion look back
BROAD = 2.0  # the third derivative of several waves is beyond that of their mean square
# Three sigma squared of two slopes' difference: at 200 Hz 4.2 times the variance of one.
SURPRISE = 9.0 * 4.2


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
    _follow_motion(state, rate, acceleration)
    state.fused[SLOPE, :3], state.spread[:] = acceleration, P_a
    z[:, 3:] = at_origin(model, z, lever_arm_matrix(rate, acceleration))


@compiled
def _slope_variance(state: FusionState, slope: Vector, noise: Vector) -> Vector:
    """Return the variance (3,) of the slope; where a stride begins, of what it lags behind too.

    What a parabola cannot follow grows with the square of how swiftly the rig goes to and fro,
    as the rates of the last seconds tell; `slope_variance` takes the swiftest hand.
    """
    period, swift = state.clock[PERIOD], 1.0
    if state.clock[TURNED] > 0.0:
        swift = min(BROAD * state.clock[SWUNG] / (state.clock[TURNED] * HASTE), 1.0)
    P_slope = slope_variance(swift * slope, noise, max(SLOPE_WINDOW, 2.0 * period))
    if state.scans[0] < 4:
        return P_slope
    misfit, hurry = np.zeros(3), 0.0
    _newest_slope(state.stamps, state.rates, misfit)
    for axis in range(3):
        change = slope[axis] - misfit[axis]
        hurry += max(change * change - SURPRISE * noise[axis], 0.0)
    for axis in range(3):
        P_slope[axis] += 4.0 * hurry
    return P_slope


@compiled
def _newest_slope(stamps: Stamps, rates: Vectors, out: Vector) -> None:
    """Write the slope (3,) of the newest three rates; of two, where a window holds no more."""
    last, before = (stamps[-1] - stamps[-2]) * 1e-9, (stamps[-2] - stamps[-3]) * 1e-9
    bend = last / (last + before) if (stamps[-1] - stamps[-4]) * 1e-9 <= SLOPE_WINDOW else 0.0
    for axis in range(3):
        newest = (rates[-1, axis] - rates[-2, axis]) / last
        older = (rates[-2, axis] - rates[-3, axis]) / before
        out[axis] = newest + bend * (newest - older)


@compiled
def _follow_motion(state: FusionState, rate: Vector, acceleration: Vector) -> None:
    """Follow the squares of rate and angular acceleration: how swiftly the rig turns about."""
    keep = max(1.0 - state.clock[INTERVAL] / SWING_MEMORY, 0.0)
    state.clock[TURNED] *= keep
    state.clock[SWUNG] *= keep
    for axis in range(3):
        state.clock[TURNED] += rate[axis] * rate[axis]
        state.clock[SWUNG] += acceleration[axis] * acceleration[axis]


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
            if P[k] < np.inf:  # a rate that nobody has measured yet makes no frame
                added[axis] += J * J * P[k]
    return added
