"""The part of a recording from which noise can be told: without gaps, at rest, evenly spaced.

Where one or two samples are missing the ends are joined: white noise does not notice, and slow
noise loses as much time as is missing.  Longer gaps, and stamps that go back, cut the record.

A window of a second rests if its readings scatter no more than twice as much as in the quietest
windows, and never so much that the quietest cannot be rest; if its mean rate is near the common
one, which is bias; and if its mean force is near that of the window before.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Flags, NANOSECONDS, Scalars, Vectors
from multiimu_ros.errors import CalibrationError
from multiimu_ros.samples import ImuSamples

GAP = 3.0  # periods: what is longer cuts the record
WINDOW_S = 1.0
LEAST_S = 60.0  # what a noise density to about 3 % needs
QUIETEST = 0.05  # quantile of the windows' scatter
EXCESS = 2.0  # times that
# More scatter, or more turning, is no rest whatever the sensor: 1.7 deg/s and 0.3 m/s^2 are ten
# times what a data sheet promises at 200 Hz, and 0.02 rad/s is beyond what a bias drifts.
RATE_SCATTER, FORCE_SCATTER = 0.03, 0.3
RATE_CHANGE, FORCE_CHANGE = 0.02, 0.05


@dataclass(frozen=True)
class RestingRecord:
    """Evenly spaced samples of one IMU at rest.

    Parameters
    ----------
    samples : ImuSamples
        What was kept.
    rate_hz : float
        Their rate [Hz].
    lost : int
        Samples missing among them.
    """

    samples: ImuSamples
    rate_hz: float
    lost: int

    @property
    def duration(self) -> float:
        """Length of the record [s]."""
        return len(self.samples) / self.rate_hz


def resting_record(samples: ImuSamples, name: str, least_s: float = LEAST_S) -> RestingRecord:
    """Cut the longest rest out of a recording.

    Parameters
    ----------
    samples : ImuSamples
        Readings of one IMU.
    name : str
        What to call it in an error.
    least_s : float
        Length below which the rest is refused [s].

    Raises
    ------
    CalibrationError
        If the IMU never rests, not long enough, or its readings are not finite.
    """
    _refuse_unusable(samples, name)
    piece, rate_hz = gap_free(samples)
    begin, end = longest_rest(piece, rate_hz)
    kept = piece.select(slice(begin, end))
    if not end - begin >= least_s * rate_hz:  # also where there is no rate
        rests = f'rests for {(end - begin) / rate_hz:.0f} s at a stretch' if end else 'never rests'
        msg = (
            f'`{name}` must lie still without gaps for {least_s:.0f} s, but {rests}; record 10 '
            'min for a noise density to 1 %, and some hours for the random walk of the bias.'
        )
        raise CalibrationError(msg)
    whole = np.ptp(kept.stamp_ns) / NANOSECONDS * rate_hz
    return RestingRecord(kept, rate_hz, max(0, round(whole) + 1 - len(kept)))


def _refuse_unusable(samples: ImuSamples, name: str) -> None:
    if len(samples) < 2:
        msg = f'`{name}` must have samples, got {len(samples)}; was the driver running?'
        raise CalibrationError(msg)
    finite = np.isfinite(samples.angular_rate) & np.isfinite(samples.specific_force)
    bad = int((~finite.all(axis=1)).sum())
    if bad:
        msg = f'`{name}` must have finite readings, got {bad} that are not; record it again.'
        raise CalibrationError(msg)


def gap_free(samples: ImuSamples) -> tuple[ImuSamples, float]:
    """Return the longest piece without a gap of three periods, and its rate [Hz].

    Repeated stamps are dropped, as drivers that poll send readings twice.
    """
    fresh = np.concatenate([[True], np.diff(samples.stamp_ns) != 0])
    samples = samples.select(fresh)
    steps = np.diff(samples.stamp_ns) / NANOSECONDS
    period = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.nan
    whole = (steps > 0) & (steps < GAP * period)
    begin, end = longest_run(whole)
    piece = samples.select(slice(begin, end + 1))
    near = steps[begin:end]
    near = near[near < 1.5 * period]
    return piece, float(len(near) / near.sum()) if len(near) else float('nan')


def longest_run(flags: Flags) -> tuple[int, int]:
    """Return begin and end of the longest run of true flags; (0, 0) if none is."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    if not len(edges):
        return 0, 0
    begins, ends = edges[::2], edges[1::2]
    longest = int(np.argmax(ends - begins))
    return int(begins[longest]), int(ends[longest])


def longest_rest(samples: ImuSamples, rate_hz: float) -> tuple[int, int]:
    """Return begin and end of the longest rest [samples]; (0, 0) if there is none.

    Where the rest begins or ends with motion, a window is given away: part of it may be moving.
    """
    if not rate_hz > 0:
        return 0, 0
    window = max(2, round(WINDOW_S * rate_hz))
    count = len(samples) // window
    if count < 3:
        return 0, 0
    rate, rate_scatter = _windows(samples.angular_rate, window, count)
    force, force_scatter = _windows(samples.specific_force, window, count)
    still = _calm(rate_scatter, RATE_SCATTER) & _calm(force_scatter, FORCE_SCATTER)
    if not still.any():
        return 0, 0
    still &= np.linalg.norm(rate - np.median(rate[still], axis=0), axis=1) < RATE_CHANGE
    moved = np.linalg.norm(np.diff(force, axis=0), axis=1)
    allowed = FORCE_CHANGE + 5 * force_scatter[1:] / np.sqrt(window)
    still[1:] &= (moved < allowed) | ~still[:-1]  # a moving neighbour says nothing
    begin, end = longest_run(still)
    first = window * (begin + (begin > 0))
    last = len(samples) if end == count else window * (end - 1)
    return (first, last) if last > first else (0, 0)


def _windows(values: Vectors, window: int, count: int) -> tuple[Vectors, Scalars]:
    """Return the mean (count, 3) of each window and the scatter (count,) within."""
    cut = values[: window * count].reshape(count, window, 3)
    return cut.mean(axis=1), np.sqrt(cut.var(axis=1).mean(axis=1))


def _calm(scatter: Scalars, most: float) -> Flags:
    return np.asarray(scatter <= min(EXCESS * float(np.quantile(scatter, QUIETEST)), most))
