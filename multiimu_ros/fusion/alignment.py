"""Differences of biases between the IMUs, learnt while they run.

What two IMUs disagree on at all times is a difference of their biases.  Each IMU therefore
carries an offset e_i, the slow mean of z_i - fused, which is subtracted before fusion.  As
sum b_i e_i = 0 the fused value is that of the plain weighted mean; but when an IMU leaves or
returns, nothing moves, for the others already agree with it.  The common bias, which no array can
see, is left to the rest updates of the attitude filter.
"""

import numpy as np

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.fusion_state import (
    COUNT,
    FusionState,
    INTERVAL,
    PERIOD,
    SCANS,
    SHARE,
    SUMS,
)
from multiimu_ros.fusion.rig_model import RigModel

ALIGNMENT_TIME = 2.0  # [s] long against vibration, short against a warming sensor's drift
LEARNING_SCANS = 64  # before that an offset takes what it sees
TEACHES, CONTRADICTED, AT_LIMIT = 0.0, 1.0, 2.0
CLIP = 3.0  # sigma of one reading: a broken sensor moves its offset no faster than noise does


@compiled
def align(
    model: RigModel,
    state: FusionState,
    z: Vectors,
    b: Vectors,
    share: Scalars,
    excluded: Scalars,
    out: Vectors,
) -> None:
    """Move the offsets towards what each IMU shows beside the rest; add up what stays unknown.

    A disagreement in motion is partly one of scale, so it moves the offset by the part of its
    variance that is the bias's.  What is excluded as faulty teaches nothing.

    Parameters
    ----------
    z, b : (K, 6) arrays
        Readings without lever arm and offset; their shares.
    share, excluded : (K,) arrays
        Trust of the synchroniser; TEACHES, CONTRADICTED by the others, or AT_LIMIT.
    out : (4, 6) array
        Fused values, variance, bias variance, density; changed in place.
    """
    square = out[0] ** 2
    mean, drift = np.zeros(6), np.zeros(6)
    heard = 0
    for i in range(len(z)):
        heard += 1 if b[i].any() else 0
        for axis in range(6):
            if b[i, axis] > 0.0:
                mean[axis] += b[i, axis] * z[i, axis]
    for i in range(len(z)):
        if not np.isnan(z[i, 0]):
            others = heard - 1 if b[i].any() else heard
            _count(state, i, z[i], share[i], excluded[i], others)
        for axis in range(6):
            bias, from_scale = model.bias_variance[i, axis], _from_scale(model, square, i, axis)
            part = b[i, axis] ** 2
            out[1, axis] += part * from_scale
            out[2, axis] += part * bias
            out[3, axis] += part * state.density[i, axis] ** 2
            if bias > 0.0 and excluded[i] == TEACHES and not np.isnan(z[i, axis]):
                gap = _clipped(state, i, axis, z[i, axis] - mean[axis], from_scale)
                step = _gain(state, i) * bias / (bias + from_scale) * gap
                state.offsets[i, axis] += step
                drift[axis] += b[i, axis] * step
    state.offsets[:] -= drift  # IMUs of different age or scale: keep sum b_i e_i as it is
    tally = state.tally[len(z)]
    tally[COUNT] += 1.0
    for axis in range(6):
        tally[SUMS + axis] += out[0, axis]
    out[3] = np.sqrt(out[3])


@compiled
def _count(
    state: FusionState, i: int, z: Vectors, share: float, excluded: float, others: int
) -> None:
    """Note what IMU i reads in this scan, and that it learns from one more."""
    tally = state.tally[i]
    if share == 0.0 and tally[SHARE] > 0.0:
        tally[SCANS] = 0.0  # back from an outage, perhaps with another bias
    if excluded == TEACHES and others > 0:
        tally[SCANS] += 1.0
    if share == 1.0 and excluded != AT_LIMIT:
        tally[COUNT] += 1.0
        for axis in range(6):
            tally[SUMS + axis] += z[axis] + state.offsets[i, axis]


@compiled
def _from_scale(model: RigModel, square: Scalars, i: int, axis: int) -> float:
    """Return the variance of a reading that scale, misalignment and mounting explain."""
    block = 3 * (axis // 3)
    total = 0.0
    for other in range(block, block + 3):
        total += model.scale_variance[i, axis, other] * square[other]
    return total


@compiled
def _gain(state: FusionState, i: int) -> float:
    slow = min(state.clock[INTERVAL] / ALIGNMENT_TIME, 1.0)
    return float(max(slow, 1.0 / max(state.tally[i, SCANS], 1.0)))


@compiled
def _clipped(state: FusionState, i: int, axis: int, gap: float, from_scale: float) -> float:
    if state.tally[i, SCANS] < LEARNING_SCANS or state.clock[PERIOD] == 0.0:
        return gap
    white = state.density[i, axis] ** 2 / state.clock[PERIOD]
    limit = CLIP * np.sqrt(white + from_scale)
    return float(min(max(gap, -limit), limit))
