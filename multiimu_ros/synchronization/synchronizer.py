"""Put K streams of samples on one clock, scan by scan, as they arrive.

One stream is the reference: every one of its samples makes a scan, to whose stamp the others are
interpolated by a parabola.  A scan is due when every stream that lives has reached its stamp.
All decisions are taken in the time of the stamps, never in the time of arrival, so that the same
samples give the same scans in whatever order the topics are served:

* a stream that stays `patience` behind the newest stamp is absent, and no longer waited for;
  if it was the reference, the next living stream takes over, and no scan is lost; at the start,
  when topics are discovered one by one, patience is longer;
* between two samples further apart than 3 periods nothing is interpolated: the scan has NaN there;
* a stream that returns from an outage is given but not trusted for `probation`: its share is 0,
  then grows to 1 over the same time again, so that nothing downstream sees a step;
* NaN, backward stamps and frozen readings never enter; they are counted per stream.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Matrix, NANOSECONDS, Scalars, Stamps, Vector, Vectors
from multiimu_ros.synchronization import streams as s
from multiimu_ros.synchronization.arrivals import ArrivalCursors, Arrivals
from multiimu_ros.synchronization.blocks import take_block


@dataclass(frozen=True, kw_only=True)
class SyncConfig:
    """Settings of the synchroniser.

    Parameters
    ----------
    patience_s : float
        How far one stream may stay behind the newest stamp before it counts as absent [s].
    start_patience_s : float
        The same at the start, for streams that never said anything, or whose first samples come
        in a burst [s].
    probation_s : float
        How long a stream that returns is watched before its share grows [s].
    jump_s : float
        A stamp this far behind its predecessor means that time itself jumped back, as when a
        recording starts again [s].
    """

    patience_s: float = 0.05
    start_patience_s: float = 0.5
    probation_s: float = 0.25
    jump_s: float = 1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0:  # also catches NaN
                msg = f'`{name}` must be positive, got {value}.'
                raise ValueError(msg)
        if not self.patience_s < self.probation_s:
            limits = f'`patience_s` {self.patience_s}, got {self.probation_s}'
            msg = f'`probation_s` must be above {limits}.'
            raise ValueError(msg)


@dataclass(frozen=True)
class Scan:
    """All readings of one instant.

    Parameters
    ----------
    stamp_ns : int
        The instant [ns].
    values : (K, 6) array
        Angular rate [rad/s] and specific force [m/s^2] of each IMU, NaN where it has none.
    share : (K,) array
        0 while an IMU is on probation, 1 once it is trusted [-].
    noise_gain : (K,) array
        Variance of each interpolated reading per variance of one sample [-].
    """

    stamp_ns: int
    values: Vectors
    share: Scalars
    noise_gain: Scalars


BLOCK = 1024  # readings that `take_block` takes in one compiled call, and scans at most
NO_SCANS: tuple[tuple[int, Vectors], ...] = ()  # what nearly every `take` returns


def scan_of(stamp_ns: int, rows: Vectors) -> Scan:
    """Return a scan from its rows (K, 8)."""
    return Scan(stamp_ns, rows[:, :6].copy(), rows[:, 6].copy(), rows[:, 7].copy())


def _stacked(scans: Sequence[tuple[int, Vectors]], count: int) -> tuple[Stamps, Matrix]:
    stamps = np.array([stamp_ns for stamp_ns, _ in scans], np.int64)
    return stamps, np.array([rows for _, rows in scans]).reshape(-1, count, 8)


@dataclass(frozen=True)
class StreamHealth:
    """What became of one stream: its state in one word, and its counters."""

    state: str
    rate_hz: float
    received: int
    backward: int
    invalid: int
    stuck: int
    gaps: int


class Synchronizer:
    """K streams in, scans out.

    Parameters
    ----------
    count : int
        Number of streams K.
    config : SyncConfig
        Patience and probation.
    maps : (K, 6, 7) array, optional
        [A | c] of the affine map A v + c that the readings of each stream pass on entry; by
        default they stay as they are.
    offsets_ns : (K,) int array, optional
        Added to the stamps of each stream on entry [ns]; by default 0.
    """

    def __init__(
        self,
        count: int,
        config: SyncConfig,
        maps: Matrix | None = None,
        offsets_ns: Stamps | None = None,
    ) -> None:
        settings = [round(value * NANOSECONDS) for value in vars(config).values()]
        identity = np.broadcast_to(np.eye(6, 7), (count, 6, 7))
        self._streams = s.Streams(
            stamps=np.zeros((count, s.RING), dtype=np.int64),
            values=np.zeros((count, s.RING, 6)),
            table=np.zeros((count, s.COLUMNS), dtype=np.int64),
            clock=np.zeros(s.CLOCK_FIELDS, dtype=np.int64),
            settings=np.array(settings, dtype=np.int64),
            maps=np.array(identity if maps is None else maps),
            offsets=np.array(np.zeros(count) if offsets_ns is None else offsets_ns, np.int64),
            sample=np.zeros(6),
            last=np.zeros((count, 6)),
            scan=np.zeros((count, 8)),
        )
        self._streams.table[:, s.ENABLED] = 1
        self._sample = self._streams.sample
        self._cursors = ArrivalCursors(count)
        self.time_jumps = 0
        self.restart()

    def restart(self) -> None:
        """Forget all samples, keep the counters: the next stamp may be anything."""
        s.restart(self._streams)
        self._cursors.restart()

    def push(self, stream: int, stamp_ns: int, values: Sequence[float] | Vector) -> Sequence[Scan]:
        """Take one reading (6 numbers, rate then force); return the scans that became due."""
        return [scan_of(*due) for due in self.take(stream, stamp_ns, values)]

    def take(
        self, stream: int, stamp_ns: int, values: Sequence[float] | Vector
    ) -> Sequence[tuple[int, Vectors]]:
        """Take one reading; return stamp and rows (K, 8) of the scans that became due.

        The columns are those of `Scan`: values, share, noise gain.
        """
        self._sample[:] = values
        due_ns = s.take_door(*self._streams, stream, stamp_ns)
        if due_ns == s.JUMPED:
            self.time_jumps += 1
            self.restart()
            due_ns = s.take_door(*self._streams, stream, stamp_ns)
        if due_ns < 0:
            return NO_SCANS
        scans = []
        while due_ns >= 0:
            scans.append((due_ns, self._streams.scan.copy()))
            due_ns = s.advance(self._streams)
        return scans

    def take_block(
        self, ks: Stamps, stamps: Stamps, values: Vectors
    ) -> Iterator[tuple[Stamps, Matrix]]:
        """Take N readings at once; yield stamps (M,) and rows (M, K, 8) as N calls of `take`.

        Between two of these time may have jumped, never within one.

        Parameters
        ----------
        ks, stamps : (N,) int arrays
            Stream and stamp [ns] of each reading.
        values : (N, 6) array
            Rate, then force.
        """
        count, first = len(self._streams.table), 0
        while first < len(ks):
            due = np.empty(BLOCK, np.int64)
            scans = np.empty((BLOCK, count, 8))
            last = first + BLOCK
            rest = ks[first:last], stamps[first:last], values[first:last]
            taken, made = take_block(self._streams, *rest, scans, due)
            yield due[:made], scans[:made]
            first += taken
            late = []
            while (due_ns := s.advance(self._streams)) >= 0:  # there was no room left for it
                late.append((due_ns, self._streams.scan.copy()))
            yield _stacked(late, count)
            if first < min(last, len(ks)) and made < BLOCK:  # time jumps back
                jumped = self.take(int(ks[first]), int(stamps[first]), values[first])
                yield _stacked(jumped, count)
                first += 1

    def arrivals(self, until_ns: int | None = None) -> Arrivals:
        """Return the samples admitted since the last call and not newer than the last scan.

        `until_ns` asks for those up to an earlier scan only, where one push returned several.
        """
        streams = self._streams
        last_ns = int(streams.clock[s.LAST_SCAN])
        until_ns = last_ns if until_ns is None else min(until_ns, last_ns)
        return self._cursors.take(streams.stamps, streams.values, streams.table, until_ns)

    def set_enabled(self, stream: int, enabled: bool) -> None:
        """Exclude a stream by hand, or take it back (on probation)."""
        self._streams.table[stream, s.ENABLED] = enabled
        if enabled:
            trusted_from = self._streams.clock[s.NEWEST] + self._streams.settings[s.PROBATION]
            self._streams.table[stream, s.USABLE_FROM] = trusted_from

    def health(self) -> tuple[StreamHealth, ...]:
        """Return the state and the counters of every stream."""
        return tuple(self._health(row) for row in self._streams.table.tolist())

    def _health(self, row: list[int]) -> StreamHealth:
        if not row[s.ENABLED]:
            state = 'disabled'
        elif not row[s.WAITED] or row[s.FAULT]:
            state = ('absent', 'invalid', 'stuck')[row[s.FAULT]]
        elif row[s.USABLE_FROM] > self._streams.clock[s.NEWEST]:
            state = 'probation'
        else:
            state = 'ok' if row[s.RECEIVED] else 'absent'
        return StreamHealth(
            state=state,
            rate_hz=NANOSECONDS / row[s.PERIOD] if row[s.PERIOD] else 0.0,
            received=row[s.RECEIVED],
            backward=row[s.BACKWARD],
            invalid=row[s.INVALID],
            stuck=row[s.STUCK],
            gaps=row[s.GAPS],
        )
