"""The compiled heart of the fusion stage: one scan in, one fused reading out.

Alignment.  What two IMUs disagree on at all times is a difference of their biases.  Each IMU
therefore carries an offset e_i, the slow mean of z_i - fused, which is subtracted before fusion.
As sum b_i e_i = 0 the fused value is that of the plain weighted mean; but when an IMU leaves or
returns, nothing moves, for the others already agree with it.  The common bias, which no array can
see, is left to the rest updates of the attitude filter.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.federated import federated_step, information_shares
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.rigid_body import lever_arm_matrix, push_slope

ALIGNMENT_TIME = 2.0  # [s] long against vibration, short against a warming sensor's drift
STARTING_PERIOD = 0.005  # [s] believed for the first two scans only
PERIOD_MEMORY = 64  # scans that the running mean of the period looks back
# Columns of the tally: scans averaged into an offset, share in the last scan; then, since somebody
# emptied them, the sums of the readings without their lever arm, and the scans that they are of.
SCANS, SHARE, SUMS, COUNT = 0, 1, 2, 8


class FusionState(NamedTuple):
    """What the fusion stage remembers between scans; arrays, changed in place."""

    fused: Vectors  # (2, 6): values and variance
    offsets: Vectors  # (K, 6): e_i
    tally: Vectors  # (K + 1, 9): see `SCANS`, `SHARE`, `SUMS`; the last row is of the fused IMU
    stamps: Stamps  # (HISTORY,) of the fused rates, for their slope
    rates: Vectors  # (HISTORY, 3)
    scans: Stamps  # (1,): how many of them are valid
    period: Scalars  # (1,): mean time between scans [s]


@compiled
def fuse_scan(
    model: RigModel,
    state: FusionState,
    motion: Vector,
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
    dt = _follow_time(state, stamp)
    R = _noise_of_one_scan(model.density, values, share, state.period[0])
    b = information_shares(R)
    Q = (motion * dt) ** 2
    z = values - state.offsets
    known, variance = state.fused
    rate, P = federated_step(known[:3], variance[:3], z[:, :3], R[:, :3], Q[:3], b[:, :3])
    known[:3], variance[:3] = rate, P
    acceleration, gain = push_slope(state.stamps, state.rates, state.scans, stamp, rate)
    L = lever_arm_matrix(rate, acceleration)
    mean_arm = np.zeros(3)
    for i in range(len(z)):
        arm = model.lever_arms_b[i]
        for row in range(3):
            z[i, 3 + row] -= L[row, 0] * arm[0] + L[row, 1] * arm[1] + L[row, 2] * arm[2]
            mean_arm[row] += b[i, 3 + row] * arm[row]
    known[3:], variance[3:] = federated_step(
        known[3:], variance[3:], z[:, 3:], R[:, 3:], Q[3:], b[:, 3:]
    )
    out = np.zeros((4, 6))
    out[0], out[1] = known, variance * _interpolation_gain(b, R, noise_gain)
    worst = P.max()
    # a x r errs with the variance of the angular acceleration
    if np.isfinite(gain) and np.isfinite(worst):
        out[1, 3:] += gain * worst * (mean_arm * mean_arm).sum()
    weights = (b[:, 0] + b[:, 1] + b[:, 2]) / 3.0
    if weights.any():
        _align(model, state, z, b, dt, share, out)
    else:  # all are on probation: nothing to align them with
        out[:] = np.nan
    for i in range(len(z)):
        state.tally[i, SHARE] = share[i]
    return out, weights


@compiled
def _follow_time(state: FusionState, stamp: int) -> float:
    """Return the time since the last scan [s], and follow the mean period."""
    if state.scans[0] == 0:
        return STARTING_PERIOD
    dt = (stamp - state.stamps[-1]) * 1e-9
    if state.period[0] == 0.0:
        state.period[0] = dt
    # A hole in the stream is no change of rate: it counts as ten periods at most.
    state.period[0] += (min(dt, 10.0 * state.period[0]) - state.period[0]) / PERIOD_MEMORY
    return float(dt)


@compiled
def _noise_of_one_scan(
    density: Vectors, values: Vectors, share: Scalars, period: float
) -> Vectors:
    """Return R (K, 6) = density^2 / period; infinite without a reading, larger on probation."""
    R = np.full_like(density, np.inf)
    interval = period if period > 0.0 else STARTING_PERIOD
    for i in range(len(R)):
        if share[i] > 0.0 and not np.isnan(values[i, 0]):
            R[i] = density[i] ** 2 / (interval * share[i])
    return R


@compiled
def _interpolation_gain(b: Vectors, R: Vectors, noise_gain: Scalars) -> Vector:
    """Return the variance (6,) of the weighted mean per that of the mean of samples.

    Interpolation averages neighbouring samples, which lowers the variance of one scan, but not
    the information: what it takes out of one scan it shares with the next.  So the weights keep
    R, and only the stated variance is lowered.
    """
    gain = np.ones(6)
    for axis in range(6):
        total, lowered = 0.0, 0.0
        for i in range(len(b)):
            if b[i, axis] > 0.0:
                part = b[i, axis] ** 2 * R[i, axis]
                total += part
                lowered += part * noise_gain[i]
        if total > 0.0:
            gain[axis] = lowered / total
    return gain


@compiled
def _align(
    model: RigModel,
    state: FusionState,
    z: Vectors,
    b: Vectors,
    dt: float,
    share: Scalars,
    out: Vectors,
) -> None:
    """Move the offsets towards what each IMU shows beside the rest; add up what stays unknown.

    A disagreement in motion is partly one of scale, so it moves the offset by the part of its
    variance that is the bias's.
    """
    square = out[0] ** 2
    mean, drift = np.zeros(6), np.zeros(6)
    for i in range(len(z)):
        for axis in range(6):
            if b[i, axis] > 0.0:
                mean[axis] += b[i, axis] * z[i, axis]
    for i in range(len(z)):
        if np.isnan(z[i, 0]):
            continue
        tally = state.tally[i]
        if share[i] == 0.0 and tally[SHARE] > 0.0:
            tally[SCANS] = 0.0  # back from an outage, perhaps with another bias
        tally[SCANS] += 1.0
        gain = max(min(dt / ALIGNMENT_TIME, 1.0), 1.0 / tally[SCANS])
        if share[i] == 1.0:
            tally[COUNT] += 1.0
            for axis in range(6):
                tally[SUMS + axis] += z[i, axis] + state.offsets[i, axis]
        for axis in range(6):
            block = 3 * (axis // 3)
            from_scale = 0.0
            for other in range(block, block + 3):
                from_scale += model.scale_variance[i, axis, other] * square[other]
            bias = model.bias_variance[i, axis]
            part = b[i, axis] ** 2
            out[1, axis] += part * from_scale
            out[2, axis] += part * bias
            out[3, axis] += part * model.density[i, axis] ** 2
            if bias > 0.0:
                step = gain * bias / (bias + from_scale) * (z[i, axis] - mean[axis])
                state.offsets[i, axis] += step
                drift[axis] += b[i, axis] * step
    state.offsets[:] -= drift  # IMUs of different age or scale: keep sum b_i e_i as it is
    tally = state.tally[len(z)]
    tally[COUNT] += 1.0
    for axis in range(6):
        tally[SUMS + axis] += out[0, axis]
    out[3] = np.sqrt(out[3])


@compiled
def fuse_scan_door(
    density: Vectors,
    bias_variance: Vectors,
    scale_variance: Matrix,
    lever_arms_b: Vectors,
    fused: Vectors,
    offsets: Vectors,
    tally: Vectors,
    stamps: Stamps,
    rates: Vectors,
    scans: Stamps,
    period: Scalars,
    motion: Vector,
    stamp: int,
    values: Vectors,
    share: Scalars,
    noise_gain: Scalars,
) -> tuple[Vectors, Scalars]:
    """Call `fuse_scan` with the arrays of its tuples, which numba would study at every call."""
    model = RigModel(density, bias_variance, scale_variance, lever_arms_b)
    state = FusionState(fused, offsets, tally, stamps, rates, scans, period)
    return fuse_scan(model, state, motion, stamp, values, share, noise_gain)
