"""By how much the stamps of one IMU are off those of another on the same body.

Coarse: |w| does not depend on how a gyroscope is mounted, so its correlation over lags peaks where
the clocks agree.  It is normalised by the overlap of each lag (Pearson); without that the peak
leans towards the greater overlap, by 0.7 ms in a simulation.  A parabola gives the fraction.

Fine: the rates of both, smoothed alike, differ by a 3 x 3 mixing (mounting, scale, misalignment),
a bias and a time map,

    w_b(t) = W w_a(t + delay + skew (t - t_0)) + c,

fitted by Gauss-Newton on a spline of w_a.  Its covariance comes from the sums of its scores over
blocks of a second, so that noise of any colour, and stamps that jitter, are counted as they are.
The rates must be free of g-sensitivity: a leak of 0.05 deg/s per g, whose force moves with the
angular acceleration, passes for 10 us; what is left of it adds to the covariance.

Also the alignment of [1]_: the instants at which each stream first leaves its rest.

.. [1] IJAMCE, "Multi-IMU data fusion for indoor navigation", 3.2.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import correlate

from multiimu_ros.arrays import Flags, Matrix, Scalars, Vector, Vectors
from multiimu_ros.errors import SyncError
from multiimu_ros.synchronization.resampling import bridge, Grid, make_grid, resample, smooth

LEAST_OVERLAP_S = 5.0
LEAST_CORRELATION = 0.8  # of |w|: two boards in one hand reach 0.5, one board 0.99
ITERATIONS = 30
REWEIGHTED = 4  # times at least
BLOCK_S = 1.0
NO_SKEW = 4.0
FREEDOM = 4.0
MEDIAN_OF_THREE = 2.366  # of a chi-squared variable with three degrees of freedom
ONSET = 8.0  # times the scatter of the first second, smoothed


@dataclass(frozen=True)
class RateTrack:
    """Angular rates of one IMU.

    Parameters
    ----------
    time : (N,) array
        On its own clock [s].
    rate : (N, 3) array
        In any unit and frame; NaN where unusable.
    force : (N, 3) array, optional
        Specific force [m/s^2], to say what an unknown g-sensitivity may do.
    leak_sigma : (3, 3) array, optional
        Standard deviation of the g-sensitivity that is left [rad/s per m/s^2].
    """

    time: Scalars
    rate: Vectors
    force: Vectors | None = None
    leak_sigma: Matrix | None = None

    @property
    def step(self) -> float:
        """Median spacing [s]."""
        return float(np.median(np.diff(self.time)))


@dataclass(frozen=True)
class TimeMap:
    """Time of the first track for a stamp t of the second: t + delay + skew (t - origin).

    Parameters
    ----------
    delay : float
        At `origin` [s].
    skew : float
        [-]; positive where the second clock is slow.
    origin : float
        Middle of the second track [s].
    delay_sigma, skew_sigma : float
        Standard deviations.
    correlation : float
        Of |w| of both at the coarse optimum [-].
    jitter : float
        Sigma by which stamps and sampling instants of both together scatter [s], as the smoothing
        leaves it: of white jitter a third to a half.
    """

    delay: float
    skew: float
    origin: float
    delay_sigma: float
    skew_sigma: float
    correlation: float
    jitter: float

    def apply(self, time: Scalars) -> Scalars:
        """Return instants (N,) of the second track on the clock of the first [s]."""
        return np.asarray(time + self.delay + self.skew * (time - self.origin))


@dataclass(frozen=True)
class Correlation:
    """Overlap-normalised correlation of |w| over lags [s], both (L,), and its peak."""

    lags: Scalars
    values: Scalars
    delay: float
    peak: float


def correlate_rates(first: RateTrack, second: RateTrack) -> Correlation:
    """Find the lag at which the rates of turn agree best.

    Raises
    ------
    SyncError
        If the tracks are too short.
    """
    step = max(first.step, second.step)
    (a, a_start), (b, b_start) = _magnitude(first, step), _magnitude(second, step)
    least = min(len(a), len(b)) // 3
    if least * step < LEAST_OVERLAP_S / 3:
        msg = f'Two tracks must overlap by {LEAST_OVERLAP_S:g} s to be aligned; record longer.'
        raise SyncError(msg)
    ones_a, ones_b = np.ones(len(a)), np.ones(len(b))

    def over_lags(x: Scalars, y: Scalars) -> Scalars:
        return np.asarray(correlate(x, y, mode='full', method='fft'))

    n = np.round(over_lags(ones_a, ones_b))
    sum_a, sum_b = over_lags(a, ones_b), over_lags(ones_a, b)
    with np.errstate(invalid='ignore', divide='ignore'):
        covariance = over_lags(a, b) - sum_a * sum_b / n
        power_a = over_lags(a**2, ones_b) - sum_a**2 / n
        power_b = over_lags(ones_a, b**2) - sum_b**2 / n
        power_a = np.maximum(power_a, 1e-6 * power_a.max(initial=1e-300))
        power_b = np.maximum(power_b, 1e-6 * power_b.max(initial=1e-300))
        values = covariance / np.sqrt(power_a * power_b)
    values[n < least] = -1.0
    lags = (np.arange(len(values)) - (len(b) - 1)) * step + a_start - b_start
    k = int(np.argmax(values))
    fraction = 0.0
    if 0 < k < len(values) - 1:
        before, here, after = values[k - 1 : k + 2]
        bend = before - 2 * here + after
        fraction = 0.5 * (before - after) / bend if bend < 0 else 0.0
    return Correlation(
        np.asarray(lags, np.float64), values, float(lags[k] + fraction * step), float(values[k])
    )


def _magnitude(track: RateTrack, step: float) -> tuple[Scalars, float]:
    """Return |w| less its mean at even steps, holes bridged by 0, and its first instant."""
    finite = np.isfinite(track.rate).all(axis=1)
    if finite.sum() < 2:
        return np.zeros(0), 0.0
    time, rate = track.time[finite], track.rate[finite]
    centred = rate - np.median(rate, axis=0)  # the median of a recording that rests is the bias
    grid = np.arange(time[0], time[-1], step)
    magnitude = np.interp(grid, time, np.linalg.norm(centred, axis=1))
    return magnitude - magnitude.mean(), float(time[0])


def fit_time_map(first: RateTrack, second: RateTrack) -> TimeMap:
    """Bring the second track onto the clock of the first.

    A skew that is within `NO_SKEW` of its sigma is taken as zero: IMUs mostly share a clock, and
    a skew made of noise would spoil the times far from the motion.

    Raises
    ------
    SyncError
        If the tracks do not turn together; says what to look at.
    """
    coarse = correlate_rates(first, second)
    if coarse.peak < LEAST_CORRELATION:
        msg = (
            f'The rates of turn do not agree at any delay (correlation {coarse.peak:.2f}, '
            f'needed {LEAST_CORRELATION}); are both IMUs on one rigid body, and was it turned?'
        )
        raise SyncError(msg)
    pair = _Pair.of(first, second)
    x, covariance, origin, jitter = _fit(pair, coarse.delay, with_skew=True)
    if abs(x[1]) < NO_SKEW * np.sqrt(covariance[1, 1]):
        x, covariance, origin, jitter = _fit(pair, coarse.delay, with_skew=False)
    delay_sigma, skew_sigma = np.sqrt(np.diag(covariance)).tolist()
    return TimeMap(
        float(x[0]), float(x[1]), float(origin), delay_sigma, skew_sigma, coarse.peak, jitter
    )


@dataclass(frozen=True)
class _Pair:
    """Both tracks, smoothed alike: the first as a spline, the second on its own grid."""

    spline: CubicSpline
    grid: Grid
    known: Flags  # of the first's grid
    time: Scalars  # (n,) of the second, where it is known
    rate: Vectors  # (n, 3)
    leak: Vectors  # (n, 3): force, where a leak of it is to be counted
    leak_variance: Matrix  # (3, 3)

    @classmethod
    def of(cls, first: RateTrack, second: RateTrack) -> '_Pair':
        sigma = make_grid(0.0, 0.0, max(first.step, second.step)).sigma
        grid, a = _smoothed(first, first.step, sigma)
        own, b = _smoothed(second, second.step, sigma)
        known = _usable(b)
        spline = CubicSpline(grid.time, bridge(a), axis=0)
        leak, variance = np.zeros((own.count, 3)), np.zeros((3, 3))
        if second.force is not None and second.leak_sigma is not None:
            leak = smooth(resample(second.time, second.force, _usable(second.force), own), own)
            # The first track leaks as much, along forces that hardly differ but for the mounting.
            variance = 2 * np.square(second.leak_sigma)
        sound = _usable(a)
        leak = np.nan_to_num(leak[known])
        return cls(spline, grid, sound, own.time[known], b[known], leak, variance)

    def covered(self, t: Scalars) -> Flags:
        """Flag the instants (n,) whose neighbours in the first track are known."""
        low = np.floor((t - self.grid.start) / self.grid.step).astype(np.int64)
        inside = (low >= 1) & (low < self.grid.count - 2)
        low = low.clip(0, self.grid.count - 2)
        return np.asarray(inside & self.known[low] & self.known[low + 1])


def _fit(pair: _Pair, delay: float, with_skew: bool) -> tuple[Vector, Matrix, float, float]:
    """Iterate to the best delay and skew; return them (2,), covariance, origin and jitter.

    The origin moves to where the delay is known best, which uncouples it from the skew.
    """
    slope = pair.spline.derivative()
    origin = float(pair.time.mean())
    x, variance = np.array([delay, 0.0]), np.ones(len(pair.time))
    covariance, jitter = np.zeros((2, 2)), 0.0
    for iteration in range(ITERATIONS):
        t = pair.time + x[0] + x[1] * (pair.time - origin)
        good = pair.covered(t)
        if good.sum() < 100:
            msg = 'Two tracks hardly overlap once they are aligned; record both at the same time.'
            raise SyncError(msg)
        moment = pair.time[good]
        a, moved = pair.spline(t[good]), slope(t[good])
        used = variance[good]
        J, residual, speed = _linearise(a, moved, moment - origin, pair.rate[good], used)
        leak = pair.leak[good] / np.sqrt(used)[:, np.newaxis]
        step, covariance = _gauss_newton(J, residual, moment, with_skew, leak, pair.leak_variance)
        x = x + step
        square = np.square(residual).sum(axis=1) * used
        variance[good], jitter = _noise_and_jitter(square, speed)
        shift = -covariance[0, 1] / covariance[1, 1] if with_skew else 0.0
        origin, x[0] = origin + shift, x[0] + x[1] * shift
        done = np.abs(step) <= 1e-2 * np.sqrt(np.diag(covariance))
        if iteration >= REWEIGHTED and np.all(done) and abs(shift) < BLOCK_S:
            break
    return x, covariance, origin, jitter


def _smoothed(track: RateTrack, step: float, sigma: float) -> tuple[Grid, Matrix]:
    grid = make_grid(float(track.time[0]), float(track.time[-1]), step, sigma)
    return grid, smooth(resample(track.time, track.rate, _usable(track.rate), grid), grid)


def _usable(vectors: Vectors) -> Flags:
    return np.asarray(np.isfinite(vectors).all(axis=1))


def _linearise(
    a: Vectors, moved: Vectors, since: Scalars, b: Vectors, variance: Scalars
) -> tuple[Matrix, Vectors, Scalars]:
    """Linearise the model at the present delay, rows divided by their sigma.

    Mixing and bias are linear, so that for each delay their best values are known: what they can
    explain is taken out of residuals and derivatives alike (variable projection).

    Parameters
    ----------
    a, moved : (n, 3) arrays
        Rates of the first track, and their derivative.
    since : (n,) array
        Time since the origin [s].
    b, variance : (n, 3), (n,) arrays
        Rates of the second track, and the variance of an axis.

    Returns
    -------
    J : (n, 3, 2) array
        Derivatives by delay and skew.
    residual : (n, 3) array
    speed : (n,) array
        Squared derivative by the delay, not divided: what jitter of the stamps acts on.
    """
    root = 1 / np.sqrt(variance)[:, np.newaxis]
    A = np.column_stack((a, np.ones(len(a)))) * root
    Q, _ = np.linalg.qr(A)
    mixing = np.linalg.lstsq(A, b * root, rcond=None)[0]
    by_delay = moved @ mixing[:3]
    J = np.stack((by_delay, by_delay * since[:, np.newaxis]), axis=2) * root[:, :, np.newaxis]
    flat = J.reshape(len(b), -1)
    flat = flat - Q @ (Q.T @ flat)
    residual = b * root - A @ mixing
    return flat.reshape(len(b), 3, 2), residual, np.square(by_delay).sum(axis=1)


def _noise_and_jitter(square: Scalars, speed: Scalars) -> tuple[Scalars, float]:
    """Return the variance (n,) of a residual's axis, noise + jitter^2 x speed, and the jitter [s].

    Where the rate hardly changes (lower half), there is noise alone; where it changes most
    (upper tenth), the jitter of stamps and sampling clocks stands out of it.
    """
    slow = speed <= np.median(speed)
    noise = max(float(np.median(square[slow])) / MEDIAN_OF_THREE, 1e-300)
    fast = speed >= np.quantile(speed, 0.9)
    excess = (square[fast] / MEDIAN_OF_THREE - noise) / np.maximum(speed[fast], 1e-300)
    jitter = 3 * max(float(np.median(excess)), 0.0)
    model = noise + jitter * speed / 3
    # Student's t with FREEDOM degrees: a clipped peak must not outweigh a thousand samples.
    weighed = model * (FREEDOM + square / model) / (FREEDOM + 3)
    return np.asarray(weighed), float(np.sqrt(jitter))


def _gauss_newton(
    J: Matrix,
    residual: Vectors,
    time: Scalars,
    with_skew: bool,
    leak: Vectors,
    leak_variance: Matrix,
) -> tuple[Scalars, Matrix]:
    """Return step (2,) and covariance (2, 2), the latter from the scores of blocks of a second."""
    used = 2 if with_skew else 1
    information = np.einsum('nia,nib->ab', J, J)[:used, :used]
    scores = np.einsum('nia,ni->na', J, residual)[:, :used]
    block = ((time - time[0]) / BLOCK_S).astype(np.int64)
    sums = np.stack([np.bincount(block, scores[:, k]) for k in range(used)], axis=1)
    inverse = np.linalg.pinv(information)
    step, covariance = np.zeros(2), np.zeros((2, 2))
    step[:used] = inverse @ scores.sum(axis=0)
    centred = sums - sums.mean(axis=0)
    # The weights fall where a residual grows: the log-likelihood bends less than the step's model.
    inverse = np.linalg.pinv(information - 2 / (FREEDOM + 3) * scores.T @ scores)
    # What one unit of each g-sensitivity (row i, column c) adds to the scores.
    leaked = np.einsum('nia,nc->aic', J[:, :, :used], leak)
    spread = centred.T @ centred + np.einsum('aic,ic,bic->ab', leaked, leak_variance, leaked)
    covariance[:used, :used] = inverse @ spread @ inverse
    return step, covariance


def onset_delay(first: RateTrack, second: RateTrack) -> float:
    """Return the delay [s] that makes both tracks leave their first rest at once (IJAMCE 3.2).

    Raises
    ------
    SyncError
        If a track does not begin with a second of rest and then move.
    """
    return _onset(first) - _onset(second)


def _onset(track: RateTrack) -> float:
    grid, rate = _smoothed(track, track.step, 2 * track.step)
    first = grid.time < grid.start + 1.0
    rest = rate[first & np.isfinite(rate).all(axis=1)]
    level = ONSET * np.linalg.norm(rest.std(axis=0)) if len(rest) else np.nan
    away = np.linalg.norm(rate - rest.mean(axis=0), axis=1)
    moving = np.flatnonzero(away > level)
    if not len(moving):
        msg = 'A track must rest for a second and then be turned, to be aligned by its onset.'
        raise SyncError(msg)
    k = int(moving[0])
    before, here = away[k - 1], away[k]
    return float(grid.time[k] - grid.step * (here - level) / max(here - before, 1e-300))
