"""The compiled heart of the synchroniser: K ring buffers, one table, one clock.

Each stream owns one row of the integer `table`; the columns are named below.  `take` admits a
sample or says why not; `advance` makes the next scan when it is due.  All stamps in [ns].
"""

import numpy as np

from multiimu_ros.arrays import Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled

RING = 2048  # samples kept of each stream: a second at 2 kHz, far more than any patience

COLUMNS = 15  # of the table
(
    WRITTEN, CURSOR, LATEST, PERIOD, WAITED, USABLE_FROM, ENABLED, FAULT, REPEATED,
    RECEIVED, BACKWARD, INVALID, STUCK, GAPS, FIRST,
) = range(COLUMNS)  # fmt: skip

CLOCK_FIELDS = 4
REFERENCE, LAST_SCAN, NEWEST, STARTED = range(CLOCK_FIELDS)
PATIENCE, START_PATIENCE, PROBATION, JUMP = range(4)  # of the settings

TAKEN, REFUSED, JUMPED = range(3)
NOT_DUE = -1
HEALTHY, IS_INVALID, IS_STUCK = range(3)  # of FAULT

NEVER = np.iinfo(np.int64).min // 4  # a stamp before all stamps, safe to subtract from
REPEATS_BESIDE_OTHERS = 10  # identical readings that damn a sensor whose neighbours change
REPEATS_ALONE = 200  # and one that has no changing neighbour: a perfect simulation may rest
GAP_PERIODS = 3
PERIOD_MEMORY = 64  # intervals that the running mean of the period looks back


@compiled
def restart(table: Stamps, clock: Stamps) -> None:
    """Forget the samples of every stream; keep counters, periods and enabled flags."""
    for row in table:
        row[WRITTEN] = row[CURSOR] = row[FAULT] = row[REPEATED] = 0
        row[LATEST] = row[FIRST] = NEVER
        row[WAITED] = 1
        row[USABLE_FROM] = NEVER
    clock[REFERENCE] = 0
    clock[LAST_SCAN] = clock[NEWEST] = clock[STARTED] = NEVER


@compiled
def take(
    stamps: Stamps,
    values: Vectors,
    table: Stamps,
    clock: Stamps,
    settings: Stamps,
    stream: int,
    stamp: int,
    sample: Vector,
) -> int:
    """Admit one sample; return TAKEN, REFUSED (counted) or JUMPED (time went back)."""
    row = table[stream]
    row[RECEIVED] += 1
    if stamp <= row[LATEST]:
        if stamp < row[LATEST] - settings[JUMP]:
            row[RECEIVED] -= 1  # it comes again after the restart
            return JUMPED
        row[BACKWARD] += 1
        return REFUSED
    if not _is_sound(values, table, stream, sample):
        return REFUSED
    if row[WRITTEN] > 0:
        _note_interval(row, stamp, settings)
    elif stamp > clock[STARTED] + settings[START_PATIENCE] and clock[STARTED] != NEVER:
        row[USABLE_FROM] = stamp + settings[PROBATION]
    if row[FIRST] == NEVER:
        row[FIRST] = stamp
    row[WAITED] = 1
    row[FAULT] = HEALTHY
    row[LATEST] = stamp
    slot = row[WRITTEN] % RING
    stamps[stream, slot] = stamp
    values[stream, slot] = sample
    row[WRITTEN] += 1
    row[CURSOR] = max(row[CURSOR], row[WRITTEN] - RING)
    clock[NEWEST] = max(clock[NEWEST], stamp)
    if clock[STARTED] == NEVER:
        clock[STARTED] = stamp
    return TAKEN


@compiled
def _is_sound(values: Vectors, table: Stamps, stream: int, sample: Vector) -> bool:
    """Refuse NaN and frozen readings, count them, and remember the fault."""
    row = table[stream]
    if not np.isfinite(sample).all():
        row[INVALID] += 1
        row[FAULT] = IS_INVALID
        return False
    last = (row[WRITTEN] - 1) % RING
    if row[WRITTEN] == 0 or (values[stream, last] != sample).any():
        row[REPEATED] = 0
        return True
    row[REPEATED] += 1
    neighbours_change = False
    for k in range(len(table)):
        alive = k != stream and table[k, WAITED] == 1 and table[k, WRITTEN] > 0
        if alive and 2 * table[k, REPEATED] < REPEATS_BESIDE_OTHERS:
            neighbours_change = True
    limit = REPEATS_BESIDE_OTHERS if neighbours_change else REPEATS_ALONE
    if row[REPEATED] < limit:
        return True
    row[STUCK] += 1
    row[FAULT] = IS_STUCK
    return False


@compiled
def _note_interval(row: Stamps, stamp: int, settings: Stamps) -> None:
    """Follow the period of a stream; a hole longer than the patience costs it its trust."""
    interval = stamp - row[LATEST]
    if interval > settings[PATIENCE]:
        row[USABLE_FROM] = stamp + settings[PROBATION]
    if row[PERIOD] == 0:
        row[PERIOD] = interval
    if interval > GAP_PERIODS * row[PERIOD]:
        row[GAPS] += 1
    # The mean, for stamps may come in bursts; an outage counts as ten periods at most.
    weight = min(row[WRITTEN], PERIOD_MEMORY)
    row[PERIOD] += (min(interval, 10 * row[PERIOD]) - row[PERIOD]) // weight


@compiled
def advance(
    stamps: Stamps, values: Vectors, table: Stamps, clock: Stamps, settings: Stamps, out: Vectors
) -> int:
    """Write the next scan into `out` (K, 7) and return its stamp, or NOT_DUE.

    Columns 0-5 of `out` are the readings, NaN where there are none; column 6 is the share.
    """
    stamp = _next_stamp(stamps, table, clock, settings)
    if stamp == NOT_DUE:
        return NOT_DUE
    for k in range(len(table)):
        if table[k, WAITED] == 1 and table[k, LATEST] < stamp:
            if not _is_overdue(table[k], clock, stamp, settings):
                return NOT_DUE
            table[k, WAITED] = 0
    for k in range(len(table)):
        out[k, :] = np.nan
        if table[k, ENABLED] == 1:
            _interpolate(stamps[k], values[k], table[k], stamp, out[k])
            since = stamp - table[k, USABLE_FROM]
            out[k, 6] = min(max(since / settings[PROBATION], 0.0), 1.0)
    clock[LAST_SCAN] = stamp
    return stamp


@compiled
def _is_overdue(row: Stamps, clock: Stamps, stamp: int, settings: Stamps) -> bool:
    patience = settings[START_PATIENCE] if row[LATEST] == NEVER else settings[PATIENCE]
    return bool(clock[NEWEST] >= stamp + patience)


@compiled
def _next_stamp(stamps: Stamps, table: Stamps, clock: Stamps, settings: Stamps) -> int:
    """Return the reference's next stamp; hand the role on where the reference is silent."""
    for _ in range(len(table)):
        k = clock[REFERENCE]
        row = table[k]
        if row[ENABLED] == 1 and row[WRITTEN] > 0:
            index = row[CURSOR]
            while index < row[WRITTEN] and stamps[k, index % RING] <= clock[LAST_SCAN]:
                index += 1
            if index < row[WRITTEN]:
                return int(stamps[k, index % RING])
        silent_since = max(row[LATEST], clock[LAST_SCAN], clock[STARTED])
        if row[ENABLED] == 1 and not _is_overdue(row, clock, silent_since, settings):
            return NOT_DUE
        clock[REFERENCE] = (k + 1) % len(table)
    return NOT_DUE


@compiled
def _interpolate(stamps: Stamps, values: Vectors, row: Stamps, stamp: int, out: Vector) -> None:
    """Write the readings of one stream at `stamp`, unless the samples around it are too far."""
    if row[WRITTEN] == 0 or row[LATEST] < stamp or row[FAULT] == IS_STUCK:
        return
    while row[CURSOR] + 1 < row[WRITTEN] and stamps[(row[CURSOR] + 1) % RING] <= stamp:
        row[CURSOR] += 1
    before = row[CURSOR] % RING
    if stamps[before] == stamp:
        out[:6] = values[before]
        return
    after = (row[CURSOR] + 1) % RING
    interval = stamps[after] - stamps[before]
    if stamps[before] > stamp or interval > GAP_PERIODS * row[PERIOD]:
        return
    part = (stamp - stamps[before]) / interval
    out[:6] = (1.0 - part) * values[before] + part * values[after]
