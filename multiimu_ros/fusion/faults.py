"""Which IMU of an array is at fault, now, while its neighbours say what it should have read.

`leave_one_out` compares each with the others, on four scales of time.  The worst beyond the
threshold is set aside first, for an error of one moves the mean of K by a K-th, which would blame
the healthy.  Gyroscope and accelerometer of one IMU share a chip and a clock: they leave together,
and return when both have agreed for a while.  Where no majority agrees nobody is excluded; the
variance of all who disagree grows instead.

Equations and limits: docs/derivations/faults.md.
"""

import numpy as np

from multiimu_ros.arrays import Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.fault_state import (
    BLOCK,
    CALM_S,
    CHI,
    DISPUTE_S,
    DOUBT,
    DOUBT_S,
    EXCLUDE,
    exclude,
    EXCLUDED,
    fault_states,
    FaultState,
    FORCE,
    GUARD_COLUMNS,
    guard_state,
    HELD,
    HOLD,
    HOLD_S,
    INFORMATION,
    JUMP,
    largest_chi,
    MEAN,
    MEMORY_S,
    NOISE_SCALE,
    POWER,
    readmit,
    SCALE,
    SHARE,
    SINCE_S,
    SUSPECT,
    TRIAD,
    VOTER,
    WELL_S,
    WIDTH,
    worst_scale,
)
from multiimu_ros.fusion.leave_one_out import (
    average,
    begin_anew,
    compare,
    elect,
    is_present,
    voters_mean,
)

__all__ = ['GUARD_COLUMNS', 'FaultState', 'fault_states', 'guard_state', 'judge']

RAMP = 0.25  # [s] in which the share of a returned IMU grows to all of it
LEAST_STEP = 1e-5  # [s] two scans with one stamp are still two readings


@compiled
def judge(guard: Vectors, triad: int, z: Vectors, R: Vectors, slow: Vectors, dt: float) -> None:
    """Judge one triad of one scan; rates first, then forces.

    Parameters
    ----------
    guard : (K, GUARD_COLUMNS) array
        Of `guard_state`; changed in place.
    triad : int
        0 for angular rates [rad/s], 1 for specific forces at the base origin [m/s^2].
    z : (K, 3) array
        Readings in the base frame, offsets and lever arms taken out; NaN where there is none.
    R : (K, 3) array
        Their white noise, infinite where there is no reading; changed in place: infinite where an
        IMU is excluded, larger where it is suspected, returns, or disagrees with no majority.
    slow : (K, 3) array
        Variance of what lasts: biases, scale and timing times the motion.
    dt : float
        Time since the last scan [s].
    """
    average(guard, triad, z, R, slow, max(dt, LEAST_STEP))
    _decide(guard, triad, max(dt, LEAST_STEP))
    for i in range(len(guard)):
        if not is_present(guard, i):
            begin_anew(guard, triad, i, JUMP)
        elif guard[i, EXCLUDED] == 1.0:
            _follow_fault(guard, triad, i, max(dt, LEAST_STEP))
    _weigh(guard, triad, R)
    if triad == FORCE:
        _pass_time(guard, dt)


@compiled
def _decide(guard: Vectors, triad: int, dt: float) -> None:
    """Find who agrees; exclude who does not, or note that nobody can say."""
    members, present = 0, 0
    for i in range(len(guard)):
        here = is_present(guard, i)
        member = here and guard[i, EXCLUDED] == 0.0
        guard[i, VOTER] = 1.0 if member else 0.0
        guard[i, HELD] = 0.0
        members += member
        present += here
    agree = elect(guard, triad)
    if agree == 0 and present > members:  # somebody may have been excluded wrongly, or has healed
        for i in range(len(guard)):
            guard[i, VOTER] = 1.0 if is_present(guard, i) else 0.0
        agree = elect(guard, triad)
        for i in range(len(guard)):
            healed = guard[i, EXCLUDED] == 1.0 and guard[i, VOTER] == 1.0 and agree > 1
            if healed and not largest_chi(guard, 1 - triad, i) > EXCLUDE:
                readmit(guard, i)
    if agree > 0:
        for i in range(len(guard)):
            beyond = guard[i, VOTER] == 0.0 and largest_chi(guard, triad, i) > EXCLUDE
            if beyond and guard[i, EXCLUDED] == 0.0:
                _condemn(guard, triad, i, dt)
        return
    for i in range(len(guard)):
        member = is_present(guard, i) and guard[i, EXCLUDED] == 0.0
        guard[i, VOTER] = 1.0 if member else 0.0
    compare(guard, triad)
    for i in range(len(guard)):
        if guard[i, VOTER] == 1.0 and largest_chi(guard, triad, i) > EXCLUDE:
            guard[i, DISPUTE_S] = HOLD
            guard[i, TRIAD], guard[i, SCALE] = triad, worst_scale(guard, triad, i)


@compiled
def _condemn(guard: Vectors, triad: int, i: int, dt: float) -> None:
    """Exclude IMU i; but a first jump costs the reading only, as it may be a heel strike."""
    row = guard[i]
    if worst_scale(guard, triad, i) != JUMP or row[DOUBT_S] > 0.0:
        exclude(guard, triad, i)
        return
    row[HELD], row[DOUBT_S] = 1.0, DOUBT
    for place in range(3, WIDTH):  # as if it had read what the others do
        information, moment = voters_mean(guard, triad, place % 3)
        at = triad * BLOCK + MEAN
        gain = dt / max(dt, MEMORY_S[place // 3])
        row[at + place] -= gain * (row[at + place % 3] - moment / information)


@compiled
def _follow_fault(guard: Vectors, triad: int, i: int, dt: float) -> None:
    """Keep the long memories of an excluded IMU free of what short ones condemn; name noise.

    Jumps of either sign average out, so that chi-squared is the same at both short scales; of a
    step it is larger at the longer one by the ratio of their noises.
    """
    row, at = guard[i], triad * BLOCK
    if row[at + CHI] > EXCLUDE or row[at + CHI + 1] > EXCLUDE:
        begin_anew(guard, triad, i, 2)
    if row[SINCE_S] == 0.0:
        row[at + POWER] = row[at + POWER + 1] = 0.0
    gain = dt / max(dt, MEMORY_S[1])
    for scale in range(2):
        chi = row[at + CHI + scale]
        if not np.isnan(chi):
            row[at + POWER + scale] += gain * (chi - row[at + POWER + scale])
    jumps = row[SCALE] == JUMP or row[SCALE] == NOISE_SCALE
    lasted = row[SINCE_S] > 2.0 * MEMORY_S[1]
    if jumps and row[TRIAD] == triad and lasted and row[at + POWER] > EXCLUDE:
        step = np.sqrt((2.0 - gain) / gain) * row[at + POWER]
        row[SCALE] = NOISE_SCALE if row[at + POWER + 1] < step else JUMP


@compiled
def _weigh(guard: Vectors, triad: int, R: Vectors) -> None:
    """Write into R what the judgement makes of each IMU."""
    disputed = False
    for i in range(len(guard)):
        disputed = disputed or guard[i, DISPUTE_S] > 0.0
    if disputed:
        _widen(guard, triad, R)
    for i in range(len(guard)):
        row = guard[i]
        if row[EXCLUDED] == 1.0 or row[SHARE] == 0.0 or row[HELD] == 1.0:
            R[i] = np.inf
            continue
        trust = row[SHARE]
        chi = largest_chi(guard, triad, i)
        if chi > SUSPECT and row[DISPUTE_S] == 0.0:
            trust *= np.sqrt(SUSPECT / chi)  # Huber
        if trust < 1.0:
            for axis in range(3):
                R[i, axis] /= trust


@compiled
def _widen(guard: Vectors, triad: int, R: Vectors) -> None:
    """Raise the variance of those in dispute until it explains how far they are apart.

    Of two by the same factor, so that their mean stays where it is.
    """
    factor = np.ones((len(guard), 3))
    for place in range(WIDTH):
        axis = place % 3
        information, moment = voters_mean(guard, triad, place)
        for i in range(len(guard)):
            own = guard[i, INFORMATION + place]
            if guard[i, VOTER] == 0.0 or information - own <= 1e-9 * information:
                continue
            y = guard[i, triad * BLOCK + MEAN + place]
            apart = y - (moment - own * y) / (information - own)
            others = 0.0
            for j in range(len(guard)):
                if j != i and guard[j, VOTER] == 1.0:
                    others += 1.0 / R[j, axis]
            expected = R[i, axis] + 1.0 / others
            factor[i, axis] = max(factor[i, axis], apart * apart / expected)
    for i in range(len(guard)):
        if guard[i, DISPUTE_S] > 0.0:
            for axis in range(3):
                R[i, axis] *= factor[i, axis]


@compiled
def _pass_time(guard: Vectors, dt: float) -> None:
    """Let shares grow, disputes end, and those return who have agreed for long enough."""
    for i in range(len(guard)):
        row = guard[i]
        row[SINCE_S] += dt
        row[WELL_S] += dt
        row[DISPUTE_S] = max(row[DISPUTE_S] - dt, 0.0)
        if row[HELD] == 0.0:
            row[DOUBT_S] = max(row[DOUBT_S] - dt, 0.0)
        row[SHARE] = min(row[SHARE] + dt / RAMP, 1.0)
        if row[EXCLUDED] == 0.0:
            continue
        calm = True
        for triad in range(2):
            calm = calm and largest_chi(guard, triad, i) <= SUSPECT  # NaN is no agreement
        row[CALM_S] = row[CALM_S] + dt if calm else 0.0
        if row[CALM_S] >= row[HOLD_S]:
            readmit(guard, i)
