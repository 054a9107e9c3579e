"""By how much the stamps of one IMU are off those of another on the same body.

Once they are coarsely aligned (`rate_track`), the rates of both, smoothed alike, differ by a 3 x 3
mixing (mounting, scale, misalignment), a bias and a time map,

    w_b(t) = W w_a(t + delay + skew (t - t_0)) + c,

fitted by Gauss-Newton on a spline of w_a.  Its covariance comes from the sums of its scores over
blocks of a second, so that noise of any colour, and stamps that jitter, are counted as they are.
The rates must be free of g-sensitivity: a leak of 0.05 deg/s per g, whose force moves with the
angular acceleration, passes for 10 us; what is left of it adds to the covariance.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from multiimu_ros.arrays import Flags, Matrix, Scalars, Vector, Vectors
from multiimu_ros.errors import SyncError
from multiimu_ros.registration.correlation import MIN_CORRELATION
from multiimu_ros.synchronization.rate_track import correlate_tracks, RateTrack, usable
from multiimu_ros.synchronization.resampling import bridge, Grid, make_grid, resample, smooth

ITERATIONS = 30
REWEIGHTED = 4  # times at least
BLOCK_S = 1.0
NO_SKEW = 4.0
FREEDOM = 4.0  # of Student's t
MEDIAN_OF_THREE = 2.366  # of a chi-squared variable with three degrees of freedom


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


def fit_time_map(first: RateTrack, second: RateTrack) -> TimeMap:
    """Bring the second track onto the clock of the first.

    A skew that is within `NO_SKEW` of its sigma is taken as zero: IMUs mostly share a clock, and
    a skew made of noise would spoil the times far from the motion.

    Raises
    ------
    SyncError
        If the tracks do not turn together; says what to look at.
    """
    coarse = correlate_tracks(first, second)
    if coarse.correlation < MIN_CORRELATION:
        msg = (
            f'The rates of turn do not agree at any delay (correlation {coarse.correlation:.2f}, '
            f'needed {MIN_CORRELATION}); are both IMUs on one rigid body, and was it turned?'
        )
        raise SyncError(msg)
    pair = _Pair.of(first, second)
    x, covariance, origin, jitter = _fit(pair, coarse.offset, with_skew=True)
    if abs(x[1]) < NO_SKEW * np.sqrt(covariance[1, 1]):
        x, covariance, origin, jitter = _fit(pair, coarse.offset, with_skew=False)
    delay_sigma, skew_sigma = np.sqrt(np.diag(covariance)).tolist()
    return TimeMap(
        float(x[0]),
        float(x[1]),
        float(origin),
        delay_sigma,
        skew_sigma,
        coarse.correlation,
        jitter,
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
        grid, a = first.smoothed(first.step, sigma)
        own, b = second.smoothed(second.step, sigma)
        known = usable(b)
        spline = CubicSpline(grid.time, bridge(a), axis=0)
        leak, variance = np.zeros((own.count, 3)), np.zeros((3, 3))
        if second.force is not None and second.leak_sigma is not None:
            leak = smooth(resample(second.time, second.force, usable(second.force), own), own)
            # The first track leaks as much, along forces that hardly differ but for the mounting.
            variance = 2 * np.square(second.leak_sigma)
        sound = usable(a)
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
