"""What the guard of K IMUs remembers, as the rows of one array, and the same in words.

Row i of a guard belongs to IMU i; its columns are named below.  Each triad (0 angular rate, 1
specific force) has a block of `BLOCK` columns; what follows the blocks, the pair shares.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Vectors
from multiimu_ros.compiled import compiled

# At 200 Hz the gains of these memories are 1, 0.1, 0.01 and 0.002.
MEMORY_S = (0.0, 0.05, 0.5, 2.5)
SCALES = len(MEMORY_S)
WIDTH = 3 * SCALES  # three axes at each scale, scale by scale

# Of a block: running mean, its variance from white noise and from slow errors; chi-squared at
# each scale, NaN where there is nothing to compare; running mean of it at the first two scales.
MEAN, NOISE, SLOW = 0, WIDTH, 2 * WIDTH
CHI = 3 * WIDTH
POWER = CHI + SCALES
PAST = POWER + 2  # medians of the last three scans, of three axes each: in the first row only
UNREST = PAST + 9  # by how much all disagree more than they should, scale by scale: likewise
BLOCK = UNREST + SCALES
INFORMATION = 2 * BLOCK  # WIDTH columns that one call of the kernel works in
(
    EXCLUDED, SHARE, CALM_S, HOLD_S, SINCE_S, WELL_S, DISPUTE_S,
    COUNT, TRIAD, SCALE, VOTER, AGREES, DOUBT_S, HELD, INTERPOLATED,
) = range(INFORMATION + WIDTH, INFORMATION + WIDTH + 15)  # fmt: skip
GUARD_COLUMNS = INTERPOLATED + 1

EXCLUDE = 40.0  # chi-squared of 3: 1e-8; eight IMUs at 200 Hz draw a million of them in an hour
SUSPECT = 20.0  # 2e-4; must stay below for the hold time before an IMU returns
HOLD, LONGEST_HOLD = 0.5, 8.0  # [s] doubled by each relapse
DOUBT = 0.03  # [s] one jump costs one reading; a second within this time, the IMU
CALMS_S = 0.5  # [s] an array that disagreed as a whole is itself again
RELAPSE = 10.0  # [s] after a return; what happens later is a new fault

RATE, FORCE = 0, 1
# What the scales show; NOISE_SCALE is no scale, but jumps of either sign.
JUMP, STEP, BIAS, DRIFT, NOISE_SCALE = range(5)
TRIAD_WORDS = ('angular rate', 'specific force')
SCALE_WORDS = ('jump', 'bias', 'bias', 'drift', 'noise')


def guard_state(count: int) -> Vectors:
    """Return the guard of `count` IMUs (K, GUARD_COLUMNS) that has seen nothing yet."""
    guard = np.zeros((count, GUARD_COLUMNS))
    guard[:, SHARE] = guard[:, INTERPOLATED] = 1.0
    guard[:, HOLD_S] = HOLD
    guard[:, WELL_S] = np.inf
    guard[:, [TRIAD, SCALE]] = np.nan
    for triad in (RATE, FORCE):
        guard[:, triad * BLOCK + CHI : triad * BLOCK + POWER] = np.nan
        guard[:, triad * BLOCK + PAST : triad * BLOCK + UNREST] = np.nan
        guard[:, triad * BLOCK + UNREST : (triad + 1) * BLOCK] = 1.0
    return guard


class FaultState(NamedTuple):
    """What the guard thinks of one IMU.

    Parameters
    ----------
    state : {'ok', 'suspect', 'excluded', 'readmitted', 'ambiguous'}
        'readmitted' until a relapse would count as a new fault; 'ambiguous' where the IMUs
        disagree and no majority says which is wrong.
    reason : str
        Triad and kind of the last fault, as 'angular rate: jump'; '' if there was none.
    chi_square : float
        The largest of its statistics now; NaN where nothing can be compared [-].
    since_s : float
        Since the last exclusion or return, or the start [s].
    exclusions : int
        How often it was excluded.
    """

    state: str
    reason: str
    chi_square: float
    since_s: float
    exclusions: int


def fault_states(guard: Vectors) -> tuple[FaultState, ...]:
    """Say of each row of a guard (K, GUARD_COLUMNS) what it means."""
    return tuple(
        FaultState(
            _state(row),
            _reason(row[TRIAD], row[SCALE]),
            _largest(row),
            float(row[SINCE_S]),
            int(row[COUNT]),
        )
        for row in guard
    )


def _largest(row: Vectors) -> float:
    chi = np.concatenate(
        [row[triad * BLOCK + CHI : triad * BLOCK + POWER] for triad in (RATE, FORCE)]
    )
    known = chi[~np.isnan(chi)]
    return float(known.max()) if len(known) else float('nan')


def _state(row: Vectors) -> str:
    if row[EXCLUDED]:
        return 'excluded'
    if row[DISPUTE_S] > 0.0:
        return 'ambiguous'
    if _largest(row) > SUSPECT:
        return 'suspect'
    return 'readmitted' if row[WELL_S] < RELAPSE else 'ok'


def _reason(triad: float, scale: float) -> str:
    if np.isnan(triad):
        return ''
    return f'{TRIAD_WORDS[int(triad)]}: {SCALE_WORDS[int(scale)]}'


@compiled
def worst_scale(guard: Vectors, triad: int, i: int) -> int:
    """Return the scale at which the chi-squared of IMU i is largest; -1 where all are NaN."""
    worst = -1
    largest = -1.0
    for scale in range(SCALES):
        chi = guard[i, triad * BLOCK + CHI + scale]
        if chi > largest:
            worst, largest = scale, chi
    return worst


@compiled
def largest_chi(guard: Vectors, triad: int, i: int) -> float:
    """Return the largest chi-squared of IMU i; NaN where there is none."""
    scale = worst_scale(guard, triad, i)
    return float(guard[i, triad * BLOCK + CHI + scale]) if scale >= 0 else np.nan


@compiled
def exclude(guard: Vectors, triad: int, i: int) -> None:
    """Take IMU i out, for what its statistics of `triad` show now."""
    row = guard[i]
    relapsed = row[WELL_S] < RELAPSE
    row[HOLD_S] = min(2.0 * row[HOLD_S], LONGEST_HOLD) if relapsed else HOLD
    row[EXCLUDED], row[SHARE] = 1.0, 0.0
    row[CALM_S] = row[SINCE_S] = row[DISPUTE_S] = 0.0
    row[COUNT] += 1.0
    row[TRIAD], row[SCALE] = triad, worst_scale(guard, triad, i)


@compiled
def readmit(guard: Vectors, i: int) -> None:
    """Let IMU i in again, with a share that has yet to grow."""
    row = guard[i]
    row[EXCLUDED] = row[SHARE] = row[SINCE_S] = row[WELL_S] = row[CALM_S] = 0.0
