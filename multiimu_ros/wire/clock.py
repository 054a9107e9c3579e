"""A board's 32-bit microsecond ticks, turned into host nanoseconds.

Bytes are late, never early, so all arrivals lie above the line that maps ticks to host time.  The
line is the edge of the lower convex hull of (ticks, arrival) that spans the middle of a sliding
window: of all lines below the points it is the one closest to their mean [1]_.  It is off by the
smallest delay, which no arrival can show; exchanges (sent, device ticks, arrival) bound it from
below too, and half of what then remains is taken off.

Stamps follow a line of their own, which bends towards the newest estimate and never jumps: gently
towards what is estimated, and quickly where a stamp lies after its own arrival, which proves it
wrong, as when the first bytes of all were late.  Where the ticks start again (a board that was
reset), a new epoch begins behind the last stamp.

Residuals here are y = arrival - 1000 * x [ns] over x = unwrapped ticks [us], both since the start
of the epoch: floats that lose nothing.

.. [1] L. Zhang, Z. Liu, C. H. Xia, "Clock synchronization algorithms for network measurements",
   Proc. IEEE INFOCOM, 2002.
"""

from collections import deque
from collections.abc import Iterable
from itertools import pairwise
import math

Point = tuple[float, float]  # x [us], y [ns]

_WRAP = 1 << 32
_WINDOW_US = 30e6  # a resonator that warms up by 0.1 ppm/s bends by 11 us in it
_EXCHANGES = 32
_MAX_SKEW = 20.0  # [ns/us] 2 %, four times a ceramic resonator's tolerance
_MAX_SLEW = 10.0  # [ns/us] how much the stamps bend beyond that
_HURRY = 250.0  # [ns/us] the same where a stamp is proven to be late
_HORIZON_US = 2e6  # an error is gone after this long, or half an epoch's age
_SHORT_US = 3e5  # lateness of 0.3 ms over this looks like a skew of 1000 ppm
_STALL_US = 10e6  # a stream that is further off its clock than this has a new clock


class DeviceClock:
    """Follows the clock of one board.

    Attributes
    ----------
    skew_ppm : float
        How much faster than the host's the board's clock runs; NaN before the first fit.
    jitter_us : float
        Standard deviation of the arrivals' lateness over the last second or less; NaN before.
    epochs : int
        How often the ticks have started anew, the first time included.
    ns_per_tick : float
        Present rate of the stamps, for instants shortly after the last one.
    """

    def __init__(self) -> None:
        self.skew_ppm = math.nan
        self.jitter_us = math.nan
        self.epochs = 0
        self.ns_per_tick = 1000.0
        self._stamp = 0
        self._line = (0.0, 0.0)  # y = a + b x
        self._following = False
        self._late = (0, 0.0, 0.0)  # lateness since the last fit: number, sum, sum of squares

    def restart(self) -> None:
        """Begin a new epoch with the next ticks: the board says that it was reset."""
        self._following = False

    def observe(self, ticks_us: int, arrival_ns: int) -> int:
        """Learn from ticks that came at `arrival_ns`; return their instant on the host [ns]."""
        x = self._unwrap(ticks_us, arrival_ns) if self._following else None
        if x is None:
            self._begin(ticks_us, arrival_ns)
            x = 0
        self._x, self._arrival = x, arrival_ns
        y = float(arrival_ns - self._origin - 1000 * x)
        if x - self._block_start >= self._block_length():
            self._close_block(x)
        _append(self._block, (float(x), y))
        late = y - self._line[0] - self._line[1] * x
        self._late = (self._late[0] + 1, self._late[1] + late, self._late[2] + late * late)
        out = self._out(x)
        self._stamp = max(self._stamp + 1, self._origin + 1000 * x + round(out))
        if out > y:
            self._bend(x, out, -_HURRY, (out - y) / _HURRY)
        return self._stamp

    def bound(self, ticks_us: int, sent_ns: int, arrival_ns: int) -> None:
        """Learn from an exchange: the device read `ticks_us` between these two instants."""
        if not self._following:
            return
        x = self._unwrap(ticks_us, arrival_ns)
        if x is not None:
            nominal = self._origin + 1000 * x
            self._exchanges.append((float(x), float(sent_ns - nominal), arrival_ns - nominal))

    def _unwrap(self, ticks_us: int, arrival_ns: int) -> int | None:
        """Return the ticks since the epoch began, or None where they cannot belong to it."""
        elapsed = (arrival_ns - self._arrival) / 1000.0
        last = self._x + self._first_ticks
        advance = (ticks_us - last + (_WRAP >> 1)) % _WRAP - (_WRAP >> 1)  # nearest
        advance += round((elapsed - advance) / _WRAP) * _WRAP
        if abs(advance - elapsed) > _STALL_US + 0.05 * elapsed or advance < -_STALL_US:
            return None
        return self._x + advance

    def _begin(self, ticks_us: int, arrival_ns: int) -> None:
        self.epochs += 1
        self._following = True
        self._origin, self._first_ticks = arrival_ns, ticks_us
        self._x, self._arrival = 0, arrival_ns
        self._prior = self._line[1]  # the same resonator, most likely
        self._line = (0.0, self._prior)
        self._points: deque[Point] = deque()
        self._block: list[Point] = []
        self._block_start = 0.0
        self._exchanges: deque[tuple[float, float, float]] = deque(maxlen=_EXCHANGES)
        self._late = (0, 0.0, 0.0)
        # Stamps: y = start + drift (x - x_start) + bend min(x - x_start, horizon)
        self._segment = (0.0, 0.0, self._prior, 0.0, _HORIZON_US)
        self.ns_per_tick = 1000.0 + self._prior

    def _block_length(self) -> float:
        return min(1e6, max(1e5, self._block_start / 20.0))

    def _close_block(self, x: int) -> None:
        self._points.extend(self._block)
        self._block, self._block_start = [], float(x)
        while self._points[0][0] < x - _WINDOW_US:
            self._points.popleft()
            if not self._points:
                return
        number, total, squares = self._late
        self.jitter_us = math.sqrt(max(0.0, squares / number - (total / number) ** 2)) / 1000.0
        self._late = (0, 0.0, 0.0)
        self._line = self._fit()
        drift = self._line[1]
        self.skew_ppm = (1000.0 / (1000.0 + drift) - 1.0) * 1e6
        self._bend_to(x, self._line[0] + drift * x - self._smallest_delay())

    def _fit(self) -> tuple[float, float]:
        """Return the line below the points; a short stretch says little against the last epoch."""
        slope = _slope_below(self._points)
        span = self._points[-1][0] - self._points[0][0]
        trust = span**2 / (span**2 + _SHORT_US**2)
        drift = self._prior + trust * (slope - self._prior)
        return min(y - drift * x for x, y in self._points), drift

    def _bend_to(self, x: int, target: float) -> None:
        now = self._out(x)
        horizon = min(_HORIZON_US, max(2e5, x / 2.0))
        self._bend(x, now, max(-_MAX_SLEW, min(_MAX_SLEW, (target - now) / horizon)), horizon)

    def _bend(self, x: int, now: float, bend: float, horizon: float) -> None:
        drift = self._line[1]
        self._segment = (float(x), now, drift, bend, horizon)
        self.ns_per_tick = 1000.0 + drift + bend

    def _out(self, x: int) -> float:
        x_start, start, drift, bend, horizon = self._segment
        return start + drift * (x - x_start) + bend * min(x - x_start, horizon)

    def _smallest_delay(self) -> float:
        """Return what the exchanges say the line is late by [ns]; 0 without exchanges."""
        a, b = self._line
        recent = [e for e in self._exchanges if e[0] > self._x - _WINDOW_US]
        if not recent:
            return 0.0
        earliest = max(sent - a - b * x for x, sent, _ in recent)
        latest = min(0.0, *(arrival - a - b * x for x, _, arrival in recent))
        return -0.5 * (min(earliest, latest) + latest)


def _append(hull: list[Point], point: Point) -> None:
    """Add the rightmost point to a lower convex hull (Andrew's monotone chain)."""
    x, y = point
    while len(hull) > 1:
        (x0, y0), (x1, y1) = hull[-2], hull[-1]
        if (x1 - x0) * (y - y0) > (x - x0) * (y1 - y0):
            break
        hull.pop()
    hull.append(point)


def _slope_below(points: Iterable[Point]) -> float:
    """Return the slope of the hull's edge over the middle of the points [ns/us]."""
    hull: list[Point] = []
    for point in points:
        _append(hull, point)
    middle = 0.5 * (hull[0][0] + hull[-1][0])
    for (x0, y0), (x1, y1) in pairwise(hull):
        if x1 >= middle and x1 > x0:
            return max(-_MAX_SKEW, min(_MAX_SKEW, (y1 - y0) / (x1 - x0)))
    return 0.0
