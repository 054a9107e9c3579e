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
from multiimu_ros.fusion.bridging import bridge_gap
from multiimu_ros.fusion.fault_state import EXCLUDED, INTERPOLATED
from multiimu_ros.fusion.faults import judge
from multiimu_ros.fusion.federated import federated_step, information_shares
from multiimu_ros.fusion.fusion_state import (
    BEFORE,
    FORCES,
    FusionState,
    GUARD,
    INTERVAL,
    LEARN,
    PERIOD,
    RATES,
    SHARE,
    SLOPE,
    VALUE,
    VARIANCE,
)
from multiimu_ros.fusion.level import level, levelling_variance
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.saturation import saturated
from multiimu_ros.fusion.scan_noise import (
    follow_time,
    interpolation_gain,
    slow_variance,
    white_noise,
)
from multiimu_ros.fusion.three_cornered_hat import track

LEAST_PART = 0.05  # of a sensor axis in a base axis: what is less is misalignment
REACH = 2.0  # periods from a reading to the farthest sample that it is interpolated from
MOST_MARGIN = 0.25  # of full scale that is given away before it, however hard the knock


@compiled
def open_scan(
    model: RigModel,
    state: FusionState,
    settings: Vector,
    stamp: int,
    values: Vectors,
    share: Scalars,
    noise_gain: Scalars,
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
    if saturated(values, model.to_sensor, _believed_limits(model, state), at_limit):
        _leave_out(model, at_limit, R)
    if settings[GUARD] > 0.0:
        # The reference is not interpolated, but is compared with those that are.
        state.guard[:, INTERPOLATED] = 1.0 if noise_gain.min() < 1.0 else 0.0
        slow = slow_variance(model, state, RATES, z, state.spread)
        judged = R[:, :3].copy()  # contiguous as the forces are: numba compiles one guard for both
        judge(state.guard, RATES, z[:, :3].copy(), judged, slow, state.clock[INTERVAL])
        R[:, :3] = judged
    return z, R, at_limit


@compiled
def _believed_limits(model: RigModel, state: FusionState) -> Vectors:
    """Return up to where (K, 6) a raw axis is believed.

    A reading is interpolated by a parabola: where the motion takes it to the limit within two
    periods, a sample behind it may be cut off.
    """
    limits = model.limits.copy()
    for triad in range(2):
        square = 0.0
        for axis in range(3 * triad, 3 * triad + 3):
            square += state.fused[SLOPE, axis] ** 2
        margin = REACH * np.sqrt(square) * state.clock[PERIOD]
        for i in range(len(limits)):
            for axis in range(3 * triad, 3 * triad + 3):
                limits[i, axis] -= min(margin, MOST_MARGIN * model.limits[i, axis])
    return limits


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
    out[1] = state.fused[VARIANCE]
    added = levelling_variance(model, state, b)
    if np.isfinite(added.sum()):  # noise of a scan, which is as white as the forces are
        out[1, 3:] += added
        out[3, 3:] += added * state.clock[PERIOD]
    out[1] *= interpolation_gain(b, R, noise_gain)
    excluded = np.zeros(len(z))
    for i in range(len(z)):
        if at_limit[i].any():
            excluded[i] = AT_LIMIT
        elif state.guard[i, EXCLUDED] > 0.0:
            excluded[i] = CONTRADICTED
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
def _fuse_triad(
    state: FusionState, settings: Vector, z: Vectors, R: Vectors, b: Vectors, triad: int
) -> None:
    """Fuse three axes with Carlson's filter, and note their shares in b (K, 6)."""
    first, end = 3 * triad, 3 * triad + 3
    shares = information_shares(R[:, first:end])
    Q = (settings[first:end] * state.clock[INTERVAL]) ** 2
    x, P = federated_step(
        state.fused[VALUE, first:end], state.fused[VARIANCE, first:end],
        z[:, first:end], R[:, first:end], Q, shares,
    )  # fmt: skip
    b[:, first:end] = shares
    note_fused(state, first, x, P)


@compiled
def note_fused(state: FusionState, first: int, x: Vector, P: Vector) -> None:
    """Keep the fused values of three axes; how fast a rate changes is known better later."""
    for k in range(3):
        change = x[k] - state.fused[VALUE, first + k]
        if first > 0:
            state.fused[SLOPE, first + k] = change / state.clock[INTERVAL]
        state.fused[BEFORE, first + k] = state.fused[VARIANCE, first + k]
        state.fused[VALUE, first + k], state.fused[VARIANCE, first + k] = x[k], P[k]


@compiled
def fuse(
    model: RigModel,
    state: FusionState,
    settings: Vector,
    stamp: int,
    values: Vectors,
    share: Scalars,
    noise_gain: Scalars,
) -> tuple[Vectors, Scalars]:
    """Fuse one scan as `fuse_scan` does, for callers that are compiled themselves."""
    z, R, at_limit = open_scan(model, state, settings, stamp, values, share, noise_gain)
    b = np.zeros_like(R)
    _fuse_triad(state, settings, z, R, b, RATES)
    bridge_gap(model, state, settings, z, R, at_limit, b)
    level(model, state, settings, stamp, z, R)
    _fuse_triad(state, settings, z, R, b, FORCES)
    return close_scan(model, state, settings, z, R, b, at_limit, share, noise_gain)


@compiled
def fuse_scan(
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
    """Fuse one scan; the state moves on in place.

    The parameters are the arrays of `RigModel` and `FusionState`, then settings and scan: tuples
    numba would study at every call.

    Returns
    -------
    (4, 6) array
        Fused values, their variance, prior variance of the common bias, noise density; NaN if
        no IMU can be trusted.
    (K,) array
        Mean share of each IMU in the fused rate.
    """
    model = RigModel(
        density, bias_variance, scale_variance, lever_arms_b, response_variance, floor,
        delay_variance, to_sensor, limits, R_bs,
    )  # fmt: skip
    state = FusionState(
        fused, offsets, tally, stamps, rates, scans, clock, learnt, guard, hat, spread, bridge,
    )  # fmt: skip
    return fuse(model, state, settings, stamp, values, share, noise_gain)
