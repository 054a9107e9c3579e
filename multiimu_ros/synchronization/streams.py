"""The compiled heart of the synchroniser: K ring buffers, one table, one clock.

Each stream owns one row of the integer `table`; the columns are named below.  `take` admits a
sample or says why not; `advance` makes the next scan when it is due.  All stamps in [ns].
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled

RING = 2048  # samples kept of each stream: a second at 2 kHz, far more than any patience

COLUMNS = 15  # of the table
(
    WRITTEN, CURSOR, LATEST, PERIOD, WAITED, USABLE_FROM, ENABLED, FAULT, REPEATED,
    RECEIVED, BACKWARD, INVALID, STUCK, GAPS, BURST,
) = range(COLUMNS)  # fmt: skip

CLOCK_FIELDS = 5
REFERENCE, LAST_SCAN, NEWEST, STARTED, NOT_BEFORE = range(CLOCK_FIELDS)
PATIENCE, START_PATIENCE, PROBATION, JUMP = range(4)  # of the settings

NOT_DUE, REFUSED, JUMPED = -1, -2, -3  # where otherwise the stamp of a scan is returned
HEALTHY, IS_INVALID, IS_STUCK = range(3)  # of FAULT

NEVER = np.iinfo(np.int64).min // 4  # a stamp before all stamps, safe to subtract from
REPEATS = 10  # identical readings damn a sensor, if its neighbours change meanwhile
GAP_PERIODS = 3
PERIOD_MEMORY = 64  # intervals that the running mean of the period looks back


class Streams(NamedTuple):
    """The state of a synchroniser: arrays, changed in place."""

    stamps: Stamps  # (K, RING)
    values: Vectors  # (K, RING, 6)
    table: Stamps  # (K, COLUMNS)
    clock: Stamps  # (CLOCK_FIELDS,)
    settings: Stamps  # (5,)
    maps: Matrix  # (K, 6, 7): [A | c] of the affine map that readings pass on entry
    offsets: Stamps  # (K,): added to the stamps on entry
    sample: Vector  # (6,): the reading that comes in
    last: Vectors  # (K, 6): the last one of each stream, as it came in
    scan: Vectors  # (K, 8): the scan that goes out: readings, NaN where none; share; noise gain


@compiled
def restart(streams: Streams) -> None:
    """Forget the samples of every stream; keep counters, periods and enabled flags."""
    for row in streams.table:
        row[WRITTEN] = row[CURSOR] = row[FAULT] = row[REPEATED] = row[BURST] = 0
        row[LATEST] = NEVER
        row[WAITED] = 1
        row[USABLE_FROM] = NEVER
    clock = streams.clock
    clock[REFERENCE] = 0
    clock[LAST_SCAN] = clock[NEWEST] = clock[STARTED] = clock[NOT_BEFORE] = NEVER


@compiled
def take(streams: Streams, k: int, stamp: int) -> int:
    """Admit the reading in `streams.sample` to stream k.

    Returns
    -------
    int
        Stamp of the scan that became due, or NOT_DUE, REFUSED (counted), JUMPED (time went back).
    """
    row, clock, settings = streams.table[k], streams.clock, streams.settings
    stamp += streams.offsets[k]
    row[RECEIVED] += 1
    if stamp <= row[LATEST]:
        if stamp < row[LATEST] - settings[JUMP]:
            row[RECEIVED] -= 1  # it comes again after the restart
            return JUMPED
        row[BACKWARD] += 1
        return REFUSED
    if not _is_sound(streams, k):
        return REFUSED
    if row[WRITTEN] > 0:
        _note_interval(row, stamp, settings)
    elif stamp > clock[STARTED] + settings[START_PATIENCE] and clock[STARTED] != NEVER:
        row[USABLE_FROM] = stamp + settings[PROBATION]
    if row[WRITTEN] == 0 or row[BURST] == 1:
        row[BURST] = stamp < clock[NEWEST] - settings[PATIENCE]
    row[WAITED] = 1
    row[FAULT] = HEALTHY
    row[LATEST] = stamp
    slot = row[WRITTEN] % RING
    streams.stamps[k, slot] = stamp
    for axis in range(6):
        streams.values[k, slot, axis] = _mapped(streams.maps[k, axis], streams.sample)
    row[WRITTEN] += 1
    row[CURSOR] = max(row[CURSOR], row[WRITTEN] - RING)
    clock[NEWEST] = max(clock[NEWEST], stamp)
    if clock[STARTED] == NEVER:
        clock[STARTED] = stamp
    return advance(streams)


@compiled
def _mapped(row: Vector, sample: Vector) -> float:
    """Return one line of A @ sample + c."""
    total = 0.0
    for other in range(6):
        total += row[other] * sample[other]
    return total + float(row[6])


@compiled
def _is_sound(streams: Streams, k: int) -> bool:
    """Refuse NaN and frozen readings, count them, and remember the fault."""
    row, table = streams.table[k], streams.table
    changed = row[WRITTEN] == 0
    for axis in range(6):
        reading = streams.sample[axis]
        if not np.isfinite(reading):
            row[INVALID] += 1
            row[FAULT] = IS_INVALID
            return False
        changed = changed or reading != streams.last[k, axis]
    if changed:
        streams.last[k] = streams.sample
        row[REPEATED] = 0
        return True
    row[REPEATED] += 1
    # Without a neighbour that changes nobody can tell: a perfect simulation rests like that.
    neighbours_change = False
    for other in range(len(table)):
        alive = other != k and table[other, WAITED] == 1 and table[other, WRITTEN] > 0
        if alive and 2 * table[other, REPEATED] < REPEATS:
            neighbours_change = True
    if row[REPEATED] < REPEATS or not neighbours_change:
        return True
    row[STUCK] += 1
    row[FAULT] = IS_STUCK
    return False


@compiled
def _note_interval(row: Stamps, stamp: int, settings: Stamps) -> None:
    """Follow the period of a stream; scans that were made without it cost it its trust."""
    interval = stamp - row[LATEST]
    if row[WAITED] == 0:
        row[USABLE_FROM] = stamp + settings[PROBATION]
    if row[PERIOD] == 0:
        row[PERIOD] = interval
    if interval > GAP_PERIODS * row[PERIOD]:
        row[GAPS] += 1
    # The mean, for stamps may come in bursts; an outage counts as ten periods at most.
    weight = min(row[WRITTEN], PERIOD_MEMORY)
    row[PERIOD] += (min(interval, 10 * row[PERIOD]) - row[PERIOD]) // weight


@compiled
def advance(streams: Streams) -> int:
    """Write the next scan into `streams.scan` and return its stamp, or NOT_DUE."""
    table, clock, settings, scan = streams.table, streams.clock, streams.settings, streams.scan
    stamp = _next_stamp(streams.stamps, table, clock, settings)
    if stamp == NOT_DUE:
        return NOT_DUE
    for row in table:
        if row[WAITED] == 1 and row[LATEST] < stamp:
            if not _is_overdue(row, clock, stamp, settings):
                return NOT_DUE
            row[WAITED] = 0
    for k in range(len(table)):
        scan[k, :6], scan[k, 6], scan[k, 7] = np.nan, 0.0, 1.0
        if table[k, ENABLED] == 0:
            continue
        since = stamp - table[k, USABLE_FROM]
        scan[k, 6] = min(max(since / settings[PROBATION], 0.0), 1.0)
        # The first scans after a return may or may not have seen it, as topics are served; a
        # patience later every scan waits for it.
        if since > settings[PATIENCE] - settings[PROBATION]:
            _interpolate(streams.stamps[k], streams.values[k], table[k], stamp, scan[k])
    clock[LAST_SCAN] = stamp
    return stamp


@compiled
def _is_overdue(row: Stamps, clock: Stamps, stamp: int, settings: Stamps) -> bool:
    # At the start topics are discovered one by one, and what one of them kept comes in a burst.
    begun = clock[STARTED] + settings[START_PATIENCE]
    starting = row[LATEST] == NEVER or (row[BURST] == 1 and stamp < begun)
    patience = settings[START_PATIENCE] if starting else settings[PATIENCE]
    return bool(clock[NEWEST] >= stamp + patience)


@compiled
def _first_after(stamps: Stamps, row: Stamps, instant: int) -> int:
    """Return the stamp of the first unscanned sample of a stream after `instant`, or NOT_DUE."""
    index = row[CURSOR]
    while index < row[WRITTEN] and stamps[index % RING] <= instant:
        index += 1
    return int(stamps[index % RING]) if index < row[WRITTEN] else NOT_DUE


@compiled
def _next_stamp(stamps: Stamps, table: Stamps, clock: Stamps, settings: Stamps) -> int:
    """Return the reference's next stamp; hand the role on where others go on without it."""
    for _ in range(len(table)):
        k = clock[REFERENCE]
        if table[k, ENABLED] == 1:
            stamp = _first_after(stamps[k], table[k], clock[LAST_SCAN])
            if stamp != NOT_DUE:
                return stamp
            # A silence that all streams share is no fault of the reference; only samples that
            # are none of its last round tell that others go on.
            last_round = max(clock[LAST_SCAN], table[k, LATEST] + GAP_PERIODS * table[k, PERIOD])
            earliest = NOT_DUE
            for other in range(len(table)):
                stamp = _first_after(stamps[other], table[other], last_round)
                if stamp != NOT_DUE and (earliest == NOT_DUE or stamp < earliest):
                    earliest = stamp
            if earliest == NOT_DUE or not _is_overdue(table[k], clock, earliest, settings):
                return NOT_DUE
        clock[REFERENCE] = (k + 1) % len(table)
    return NOT_DUE


@compiled
def _interpolate(stamps: Stamps, values: Vectors, row: Stamps, stamp: int, out: Vector) -> None:
    """Write readings and noise gain of one stream at `stamp`, unless its samples are too far.

    A parabola through the two samples around the stamp and the one before them; a straight line
    where that one is missing.  The curvature matters: what a line leaves out of a turning rate
    adds up to a drift in attitude, like coning.
    """
    if row[WRITTEN] == 0 or row[LATEST] < stamp or row[FAULT] == IS_STUCK:
        return
    while row[CURSOR] + 1 < row[WRITTEN] and stamps[(row[CURSOR] + 1) % RING] <= stamp:
        row[CURSOR] += 1
    before = row[CURSOR] % RING
    if stamps[before] == stamp:
        out[:6], out[7] = values[before], 1.0
        return
    after, earlier = (row[CURSOR] + 1) % RING, (row[CURSOR] - 1) % RING
    interval = stamps[after] - stamps[before]
    limit = GAP_PERIODS * row[PERIOD]
    if stamps[before] > stamp or interval > limit:
        return
    u = (stamp - stamps[before]) / interval
    a, b, c = 0.0, 1.0 - u, u
    span = stamps[before] - stamps[earlier]
    if row[CURSOR] > 0 and 0 < span < limit and row[WRITTEN] - row[CURSOR] < RING - 1:
        v = span / interval  # Lagrange's polynomials on -v, 0, 1
        a, b, c = u * (u - 1.0) / (v * (v + 1.0)), (u + v) * (1.0 - u) / v, u * (u + v) / (1.0 + v)
    for axis in range(6):
        out[axis] = a * values[earlier, axis] + b * values[before, axis] + c * values[after, axis]
    out[7] = a * a + b * b + c * c


# numba recognises an array among its arguments at once, but must study a tuple anew at every
# call, which takes longer than the work itself: these doors take the arrays one by one.


@compiled
def take_door(
    stamps: Stamps,
    values: Vectors,
    table: Stamps,
    clock: Stamps,
    settings: Stamps,
    maps: Matrix,
    offsets: Stamps,
    sample: Vector,
    last: Vectors,
    scan: Vectors,
    k: int,
    stamp: int,
) -> int:
    """Call `take` with the arrays of `Streams`, in its order."""
    streams = Streams(
        stamps, values, table, clock, settings, maps, offsets, sample, last, scan
    )  # fmt: skip
    return take(streams, k, stamp)
