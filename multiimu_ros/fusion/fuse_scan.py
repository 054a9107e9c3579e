"""The compiled heart of the fusion stage: one scan in, one fused reading out.

    open_scan   time, noise, limits, faults of the rates
    (a filter fuses the rates)
    level       angular acceleration, lever arms out, faults of the forces
    (a filter fuses the forces)
    close_scan  variances, alignment

`fuse_scan` is all of it with the filter that is the default; other filters are called between
the three parts.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.alignment import align, AT_LIMIT, CONTRADICTED
from multiimu_ros.fusion.array_acceleration import array_acceleration, slope_variance
from multiimu_ros.fusion.bridging import bridge_gap, note_walk
from multiimu_ros.fusion.fault_state import EXCLUDED
from multiimu_ros.fusion.faults import judge
from multiimu_ros.fusion.federated import federated_step, information_shares
from multiimu_ros.fusion.fusion_state import (
    BEFORE,
    BRIDGED,
    FusionState,
    GUARD,
    INTERVAL,
    LEARN,
    PERIOD,
    SHARE,
    SLOPE,
    VALUE,
    VARIANCE,
)
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.rigid_body import lever_arm_matrix, push_slope, SLOPE_WINDOW
from multiimu_ros.fusion.saturation import saturated
from multiimu_ros.fusion.scan_noise import (
    cross_variance,
    follow_time,
    interpolation_gain,
    slow_variance,
    white_noise,
)
from multiimu_ros.fusion.three_cornered_hat import track

LEAST_PART = 0.05  # of a sensor axis in a base axis: what is less is misalignment


@compiled
def open_scan(
    model: RigModel,
    state: FusionState,
    settings: Vector,
    stamp: int,
    values: Vectors,
    share: Scalars,
) -> tuple[Vectors, Vectors, Vectors]:
    """Prepare a scan for the fusion of its rates.

    Returns
    -------
    z : (K, 6) array
        Readings without their offsets.
    R : (K, 6) array
        Their variances; infinite where there is none, or none to be believed.
    at_limit : (K, 6) array
        1 where the sensor's own axis is at its limit, else 0.
    """
    follow_time(state, stamp)
    R = white_noise(state, values, share)
    z = values - state.offsets
    at_limit = np.zeros_like(values)
    if saturated(values, model.to_sensor, model.limits, at_limit):
        _leave_out(model, at_limit, R)
    if settings[GUARD] > 0.0:
        slow = slow_variance(model, state, 0, z, state.spread)
        judge(state.guard, 0, z[:, :3], R[:, :3], slow, state.clock[INTERVAL])
    return z, R, at_limit


@compiled
def _leave_out(model: RigModel, at_limit: Vectors, R: Vectors) -> None:
    """Believe no base axis that a sensor axis at its limit has a part in."""
    for i in range(len(R)):
        for sensor_axis in range(6):
            if at_limit[i, sensor_axis] > 0.0:
                block = 3 * (sensor_axis // 3)
                for axis in range(3):
                    if abs(model.R_bs[i, axis, sensor_axis - block]) > LEAST_PART:
                        R[i, block + axis] = np.inf


@compiled
def level(
    model: RigModel, state: FusionState, settings: Vector, stamp: int, z: Vectors, R: Vectors
) -> None:
    """Take the lever arms out of the forces in `z`; the rates are fused already."""
    rate, P = state.fused[VALUE, :3], state.fused[VARIANCE, :3]
    slope, gain = push_slope(state.stamps, state.rates, state.scans, stamp, rate)
    state.spread[:] = 0.0
    window = max(SLOPE_WINDOW, 2.0 * state.clock[PERIOD])
    P_slope = slope_variance(slope, gain * P, window)
    hurry = 0.0  # what the slope lags behind, where a stride begins
    for axis in range(3):
        change = slope[axis] - state.fused[SLOPE, axis]
        hurry += max(change * change - 9.0 * gain * P[axis], 0.0)
    P_slope = P_slope + 4.0 * hurry
    if settings[GUARD] > 0.0:
        judge_forces(model, state, z, R, rate, slope, gain * P, P_slope)
    unlike = R[:, 3:] + slow_variance(model, state, 1, z, state.spread)
    acceleration, P_a = array_acceleration(
        z[:, 3:], unlike, model.lever_arms_b, rate, slope, P_slope
    )
    if state.clock[BRIDGED] == 0.0 and state.scans[0] > 2:
        note_walk(state, P, acceleration, P_a)
    state.fused[SLOPE, :3], state.spread[:] = acceleration, P_a
    z[:, 3:] = at_origin(model, z, lever_arm_matrix(rate, acceleration))


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
    slow = slow_variance(model, state, 1, z, np.diag(P_slope - noise))
    white = R[:, 3:].copy()
    for i in range(len(z)):
        white[i] += cross_variance(model.lever_arms_b[i], np.diag(noise))
    judged = white.copy()
    judge(state.guard, 1, force, judged, slow, state.clock[INTERVAL])
    for i in range(len(z)):
        for axis in range(3):
            if judged[i, axis] != white[i, axis]:
                R[i, 3 + axis] *= judged[i, axis] / white[i, axis]


@compiled
def close_scan(
    model: RigModel,
    state: FusionState,
    settings: Vector,
    z: Vectors,
    R: Vectors,
    b: Vectors,
    at_limit: Vectors,
    share: Scalars,
    noise_gain: Scalars,
) -> tuple[Vectors, Scalars]:
    """Return what `fuse_scan` does, and align the IMUs; the forces are fused already."""
    out = np.zeros((4, 6))
    out[0] = state.fused[VALUE]
    out[1] = state.fused[VARIANCE] * interpolation_gain(b, R, noise_gain)
    mean_arm = np.zeros(3)
    excluded = np.zeros(len(z))
    for i in range(len(z)):
        if at_limit[i].any():
            excluded[i] = AT_LIMIT
        elif state.guard[i, EXCLUDED] > 0.0:
            excluded[i] = CONTRADICTED
        for row in range(3):
            mean_arm[row] += b[i, 3 + row] * model.lever_arms_b[i, row]
    spread = cross_variance(mean_arm, state.spread)
    if np.isfinite(spread.sum()):  # a x r errs with the variance of the angular acceleration
        out[1, 3:] += spread
    if settings[LEARN] > 0.0:
        track(state.hat, z, share, noise_gain, state.clock[INTERVAL])
    weights = (b[:, 0] + b[:, 1] + b[:, 2]) / 3.0
    if b.any():
        align(model, state, z, b, share, excluded, out)
    else:  # all are on probation: nothing to align them with
        out[:] = np.nan
    state.tally[: len(z), SHARE] = share
    return out, weights


@compiled
def fuse_scan(
    model: RigModel,
    state: FusionState,
    settings: Vector,
    stamp: int,
    values: Vectors,
    share: Scalars,
    noise_gain: Scalars,
) -> tuple[Vectors, Scalars]:
    """Fuse one scan; the state moves on in place.

    Returns
    -------
    (4, 6) array
        Fused values, their variance, prior variance of the common bias, noise density; NaN if
        no IMU can be trusted.
    (K,) array
        Mean share of each IMU in the fused rate.
    """
    z, R, at_limit = open_scan(model, state, settings, stamp, values, share)
    b = information_shares(R)
    Q = (settings[:6] * state.clock[INTERVAL]) ** 2
    _fuse_triad(state, z, R, Q, b, 0)
    bridge_gap(model, state, settings, z, R, at_limit, b)
    level(model, state, settings, stamp, z, R)
    b[:, 3:] = information_shares(R[:, 3:])
    _fuse_triad(state, z, R, Q, b, 3)
    return close_scan(model, state, settings, z, R, b, at_limit, share, noise_gain)


@compiled
def _fuse_triad(
    state: FusionState, z: Vectors, R: Vectors, Q: Vector, b: Vectors, first: int
) -> None:
    """Fuse three axes with Carlson's filter."""
    end = first + 3
    x, P = federated_step(
        state.fused[VALUE, first:end], state.fused[VARIANCE, first:end],
        z[:, first:end], R[:, first:end], Q[first:end], b[:, first:end],
    )  # fmt: skip
    note_fused(state, first, x, P)


@compiled
def note_fused(state: FusionState, first: int, x: Vector, P: Vector) -> None:
    """Keep the fused values of three axes, and how fast they change."""
    for k in range(3):
        change = x[k] - state.fused[VALUE, first + k]
        state.fused[SLOPE, first + k] = change / state.clock[INTERVAL]
        state.fused[BEFORE, first + k] = state.fused[VARIANCE, first + k]
        state.fused[VALUE, first + k], state.fused[VARIANCE, first + k] = x[k], P[k]


@compiled
def fuse_scan_door(
    density: Vectors,
    bias_variance: Vectors,
    scale_variance: Matrix,
    lever_arms_b: Vectors,
    response_variance: Matrix,
    floor: Vectors,
    delay_variance: Scalars,
    to_sensor: Matrix,
    limits: Vectors,
    R_bs: Matrix,
    fused: Vectors,
    offsets: Vectors,
    tally: Vectors,
    stamps: Stamps,
    rates: Vectors,
    scans: Stamps,
    clock: Vector,
    learnt: Vectors,
    guard: Vectors,
    hat: Vectors,
    spread: Matrix,
    bridge: Matrix,
    settings: Vector,
    stamp: int,
    values: Vectors,
    share: Scalars,
    noise_gain: Scalars,
) -> tuple[Vectors, Scalars]:
    """Call `fuse_scan` with the arrays of its tuples, which numba would study at every call."""
    model = RigModel(
        density, bias_variance, scale_variance, lever_arms_b, response_variance, floor,
        delay_variance, to_sensor, limits, R_bs,
    )  # fmt: skip
    state = FusionState(
        fused,
        offsets,
        tally,
        stamps,
        rates,
        scans,
        clock,
        learnt,
        guard,
        hat,
        spread,
        bridge,
    )
    return fuse_scan(model, state, settings, stamp, values, share, noise_gain)
