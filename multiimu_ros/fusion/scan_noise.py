"""How far the readings of one scan may be from the truth, for what reason."""

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.fusion_state import (
    FORCES,
    FusionState,
    INTERVAL,
    PERIOD,
    SCANS,
    SLOPE,
    VALUE,
)
from multiimu_ros.fusion.median import insert, middle
from multiimu_ros.fusion.rig_model import RigModel

STARTING_PERIOD = 0.005  # [s] believed for the first two scans only
PERIOD_MEMORY = 64  # scans that the running mean of the period looks back


@compiled
def follow_time(state: FusionState, stamp: int) -> None:
    """Note the time since the last scan, and follow the mean period."""
    clock = state.clock
    if state.scans[0] == 0:
        clock[INTERVAL] = STARTING_PERIOD
        return
    clock[INTERVAL] = (stamp - state.stamps[-1]) * 1e-9
    if clock[PERIOD] == 0.0:
        clock[PERIOD] = clock[INTERVAL]
    # A hole in the stream is no change of rate: it counts as ten periods at most.
    clock[PERIOD] += (min(clock[INTERVAL], 10.0 * clock[PERIOD]) - clock[PERIOD]) / PERIOD_MEMORY


@compiled
def white_noise(state: FusionState, values: Vectors, share: Scalars) -> Vectors:
    """Return R (K, 6) = density^2 / period; infinite without a reading, larger on probation."""
    R = np.full_like(state.density, np.inf)
    interval = state.clock[PERIOD] if state.clock[PERIOD] > 0.0 else STARTING_PERIOD
    for i in range(len(R)):
        if share[i] > 0.0 and not np.isnan(values[i, 0]):
            R[i] = state.density[i] ** 2 / (interval * share[i])
    return R


@compiled
def slow_variance(
    model: RigModel, state: FusionState, triad: int, z: Vectors, P_a: Matrix
) -> Vectors:
    """Return the variance (K, 3) between healthy readings of a triad that is not white.

    What alignment has not learnt of the bias yet, its instability, scale and misalignment times
    the motion, the delay of a stamp times its slope; for forces also what an error of the angular
    acceleration (covariance P_a) does at the end of a lever arm.  How the rig moves is what most
    of the readings z (K, 6) say now: a motion may begin with this scan.
    """
    first = 3 * triad
    slow, ordered = np.zeros((len(z), 3)), np.empty(len(z))
    square, slope = state.fused[VALUE] ** 2, np.zeros(3)
    for axis in range(3):
        now = _median(z, first + axis, ordered)
        last = state.fused[VALUE, first + axis]
        if not np.isnan(now):
            square[first + axis] = now**2
            slope[axis] = abs(now - last) / state.clock[INTERVAL]
        slope[axis] = max(slope[axis], abs(state.fused[SLOPE, first + axis]))
    for i in range(len(slow)):
        for axis in range(3):
            row = first + axis
            total = model.floor[i, row] + _bias_left(model, state, i, row)
            total += model.delay_variance[i] * slope[axis] ** 2
            for other in range(6):
                total += model.response_variance[i, row, other] * square[other]
            slow[i, axis] = total
        if triad == FORCES:
            spread = cross_variance(model.lever_arms_b[i], P_a)
            for axis in range(3):
                slow[i, axis] += spread[axis]
    return slow


@compiled
def _median(z: Vectors, column: int, ordered: Vector) -> float:
    """Return the median of a column, of what is not NaN in it; NaN if there is nothing."""
    count = 0
    for i in range(len(z)):
        value = z[i, column]
        if np.isnan(value):
            continue
        insert(ordered, count, value)
        count += 1
    if count == 0:
        return np.nan
    return middle(ordered, count)


@compiled
def _bias_left(model: RigModel, state: FusionState, i: int, row: int) -> float:
    """Return the variance of a bias that was `SCANS` times compared with the others."""
    period = state.clock[PERIOD] if state.clock[PERIOD] > 0.0 else STARTING_PERIOD
    white = state.density[i, row] ** 2 / period
    bias = model.bias_variance[i, row]
    return float(bias * white / (white + state.tally[i, SCANS] * bias))


@compiled
def cross_variance(arm: Vector, P: Matrix) -> Vector:
    """Return the variance (3,) of a x arm, where a has the covariance P (3, 3)."""
    x, y, z = arm
    out = np.empty(3)
    out[0] = z * z * P[1, 1] + y * y * P[2, 2] - 2.0 * y * z * P[1, 2]
    out[1] = x * x * P[2, 2] + z * z * P[0, 0] - 2.0 * x * z * P[0, 2]
    out[2] = y * y * P[0, 0] + x * x * P[1, 1] - 2.0 * x * y * P[0, 1]
    return out


@compiled
def interpolation_gain(b: Vectors, R: Vectors, noise_gain: Scalars) -> Vector:
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
