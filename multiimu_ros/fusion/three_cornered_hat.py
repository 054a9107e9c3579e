"""The noise of each of K >= 3 IMUs, learnt in motion: the three-cornered hat of [1]_, N-cornered.

Readings of one scan share the truth, so what two of them differ by holds their noises alone, and

    var(y_i - y_j) = R_i + R_j                        K (K - 1) / 2 equations for K unknowns

The truth cancels between IMUs; what is slow (biases, errors of scale times the motion) cancels in
time, by the second difference over LAG scans

    D_i(n) = y_i(n) - 2 y_i(n - LAG) + y_i(n - 2 LAG),        var(D_i) = 6 g_i R_i

Neighbouring readings are no independent draws: interpolation mixes three samples, and a low-pass
in the sensor mixes more.  LAG = 3 keeps the three terms apart, so that R is the variance of one
sample whatever its neighbours do, g_i being the part that interpolation leaves of it.

The running mean of D^2 forgets within `MEMORY_S`; a spike is cut to a few times that mean, which
noise that truly grows pulls up within seconds.  Scans so violent that errors of scale would show
through the second difference are left out.  Derivation: docs/derivations/noise_tracking.md.

.. [1] J. E. Gray, D. W. Allan, "A method for estimating the frequency stability of an individual
   oscillator", Proc. 28th Annual Symposium on Frequency Control, 1974.
"""

import math

import numpy as np
from scipy.optimize import nnls

from multiimu_ros.arrays import Flags, Matrix, Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.rig import MAX_IMUS

MEMORY_S = 15.0  # [s] 3000 scans at 200 Hz: R of like IMUs to 4 %
LAG = 3  # scans: interpolated readings nearer than that share a sample
GAIN = 6.0  # 1 + 4 + 1: variance of a second difference of white noise
EXCESS = 35 / 18  # 1 + 2 (4^2 + 1^2) / 6^2: by how much a second difference repeats itself
CLIP = 16.0  # squares count up to so many of their mean: 4 sigma, 1 in 16 000 of white noise
WARM = 50.0  # scans before squares are clipped
MISFIT = 10.0 * 0.01**2  # an error of scale of 1 % may add a tenth to the variance of a scan
LEAST = 100.0  # scans of a pair before it is believed: R_i + R_j to 20 %
SURE = 0.25  # standard errors up to this part of the quietest pair's sum are knowledge
LEAST_VARIANCE = 1e-18  # of a perfect simulation, as `rig_model.LEAST_SIGMA`

# Columns of a row: the last 2 LAG readings, where the oldest lies, sums of noise gain and of
# scans, then for each other IMU the scans of each triad and the squares of each axis.
RING = 6 * 2 * LAG
OLDEST, NOISE_GAIN, SEEN, COUNTS = RING, RING + 1, RING + 2, RING + 3
SQUARES = COUNTS + 2 * MAX_IMUS
HAT_COLUMNS = SQUARES + 6 * MAX_IMUS


def hat_state(count: int) -> Vectors:
    """Return the memory (K, HAT_COLUMNS) of `count` IMUs, empty."""
    if not 1 <= count <= MAX_IMUS:
        msg = f'`count` must be from 1 to {MAX_IMUS} IMUs, got {count}.'
        raise ValueError(msg)
    hat = np.zeros((count, HAT_COLUMNS))
    hat[:, :RING] = np.nan
    return hat


@compiled
def track(
    hat: Vectors, z: Vectors, usable: Scalars | Flags, noise_gain: Scalars, dt: float
) -> None:
    """Learn from one scan; `hat` moves on in place.

    Parameters
    ----------
    hat : (K, HAT_COLUMNS) array
        See `hat_state`.
    z : (K, 6) array
        Aligned readings of one instant, without their lever arms [rad/s], [m/s^2]; a triad with
        NaN is left out.
    usable : (K,) bool or float array
        0 for an IMU that is left out.
    noise_gain : (K,) array
        Variance of each reading per variance of one sample; 1 where nothing is interpolated [-].
    dt : float
        Time since the last scan [s].
    """
    keep = math.exp(-dt / MEMORY_S)
    D = second_differences(hat, z, usable)
    for i in range(len(z)):
        if np.isnan(D[i, 0]) and np.isnan(D[i, 3]):
            continue
        hat[i, NOISE_GAIN] = keep * hat[i, NOISE_GAIN] + noise_gain[i]
        hat[i, SEEN] = keep * hat[i, SEEN] + 1.0
        for j in range(i):
            _add_pair(hat, D, i, j, keep)


@compiled
def second_differences(rows: Vectors, z: Vectors, usable: Scalars | Flags) -> Vectors:
    """Put readings z (K, 6) into the rings at the head of `rows`; return D (K, 6).

    NaN where one of the three readings is missing.
    """
    oldest = int(rows[0, OLDEST])
    middle = 6 * ((oldest + LAG) % (2 * LAG))
    first = 6 * oldest
    D = np.empty_like(z)
    for i in range(len(z)):
        for axis in range(6):
            reading = z[i, axis] if usable[i] and np.isfinite(z[i, axis]) else np.nan
            D[i, axis] = reading - 2.0 * rows[i, middle + axis] + rows[i, first + axis]
            rows[i, first + axis] = reading
    rows[0, OLDEST] = (oldest + 1) % (2 * LAG)
    return D


@compiled
def clipped(square: float, total: float, count: float) -> float:
    """Return a square, cut to CLIP times the mean `total / count` of those before it.

    Readings that never changed so far (0) are no measure.
    """
    if count > WARM and total > 0.0:
        return min(square, CLIP * total / count)
    return square


@compiled
def _add_pair(hat: Vectors, D: Vectors, i: int, j: int, keep: float) -> None:
    """Add what i and j differ by, unless it may be the motion that they answer differently to."""
    for triad in range(2):
        first = 3 * triad
        column, place = COUNTS + 2 * j + triad, SQUARES + 6 * j + first
        count = hat[i, column]
        gap, turn_i, turn_j, total = 0.0, 0.0, 0.0, 0.0
        for axis in range(first, first + 3):
            gap += D[i, axis] - D[j, axis]
            turn_i += D[i, axis] ** 2
            turn_j += D[j, axis] ** 2
            total += hat[i, SQUARES + 6 * j + axis]
        if not np.isfinite(gap):
            continue
        # Both feel the motion; the lesser of the two is not moved by a fault of one.
        if count > WARM and MISFIT * min(turn_i, turn_j) * count > total > 0.0:
            continue
        for axis in range(3):
            square = (D[i, first + axis] - D[j, first + axis]) ** 2
            before = hat[i, place + axis]
            hat[i, place + axis] = keep * before + clipped(square, before, count)
        hat[i, column] = keep * count + 1.0


def noise_gains(hat: Vectors) -> Scalars:
    """Return the mean noise gain (K,) of interpolation, NaN for IMUs that were never seen."""
    seen, gain = hat[:, SEEN], np.full(len(hat), np.nan)
    np.divide(hat[:, NOISE_GAIN], seen, out=gain, where=seen > 0)
    return gain


def learnt_variance(hat: Vectors) -> tuple[Vectors, Flags]:
    """Return the variance of one sample of every IMU, and where it is known.

    Returns
    -------
    R : (K, 6) array
        Variance [(rad/s)^2], [(m/s^2)^2]; never below its own standard error; NaN for an IMU
        that has not been seen beside two others long enough.
    known : (K, 6) bool array
        Whether R is told well enough to weigh by.
    """
    count = len(hat)
    pairs = np.tril_indices(count, -1)
    counts = hat[:, COUNTS:SQUARES].reshape(count, MAX_IMUS, 2)[pairs]
    squares = hat[:, SQUARES:].reshape(count, MAX_IMUS, 6)[pairs]
    seen = np.repeat(counts, 3, axis=1)  # (P, 6)
    sums = np.divide(squares, GAIN * seen, out=np.full_like(squares, np.nan), where=seen > 0)
    R, known = _solve_axes(sums, seen, count)
    return R / noise_gains(hat)[:, np.newaxis], known


def learnt_density(values: Matrix, rate_hz: float) -> Vectors:
    """Return the white noise density (K, 6) of the IMUs of a whole recording.

    Parameters
    ----------
    values : (N, K, 6) array
        Scans as `track` takes them, not interpolated; NaN where there is no reading.
    rate_hz : float
        Scans per second [Hz].

    Returns
    -------
    (K, 6) array
        [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)]; NaN where the recording does not tell.
    """
    values = np.asarray(values, dtype=np.float64)
    if values.ndim != 3 or values.shape[2] != 6:
        msg = f'`values` must have shape (N, K, 6), got {values.shape}.'
        raise ValueError(msg)
    count = values.shape[1]
    D = values[2 * LAG :] - 2.0 * values[LAG:-LAG] + values[: -2 * LAG]
    sums, seen = np.full((2, count * (count - 1) // 2, 6), np.nan)
    for p, (i, j) in enumerate(zip(*np.tril_indices(count, -1), strict=True)):
        for triad in (slice(0, 3), slice(3, 6)):
            sums[p, triad], seen[p, triad] = _whole_pair(D[:, i, triad], D[:, j, triad])
    R, known = _solve_axes(sums, seen, count)
    return np.where(known, np.sqrt(R / rate_hz), np.nan)


def _whole_pair(first: Vectors, second: Vectors) -> tuple[Vector, int]:
    """Return R_i + R_j (3,) of two triads (N, 3), and from how many scans.

    Clips and leaves out as `_add_pair`, against means that are clipped against themselves.
    """
    square = np.square(first - second)
    turn = np.minimum(np.square(first).sum(axis=1), np.square(second).sum(axis=1))
    heard = np.isfinite(square).all(axis=1)
    square, turn = square[heard], turn[heard]
    if len(square) < LEAST:
        return np.full(3, np.nan), len(square)
    mean = 2.0 * np.median(square, axis=0)  # 0.9 of the mean of white noise
    for _ in range(3):
        calm = MISFIT * turn <= mean.sum() if mean.any() else np.full(len(turn), fill_value=True)
        limit = np.where(mean > 0.0, CLIP * mean, np.inf)
        mean = np.minimum(square[calm], limit).mean(axis=0) if calm.any() else mean
    return mean / GAIN, int(calm.sum())


def _solve_axes(sums: Vectors, seen: Vectors, count: int) -> tuple[Vectors, Flags]:
    """Solve every column of `sums` (P, 6), of pairs seen so often, for R (K, 6)."""
    R, known = np.full((count, 6), np.nan), np.zeros((count, 6), dtype=np.bool_)
    i, j = np.tril_indices(count, -1)
    for axis in range(6):
        enough = seen[:, axis] >= LEAST
        met = np.zeros((count, count))
        met[i[enough], j[enough]] = met[j[enough], i[enough]] = 1.0
        heard = np.diagonal(met @ met @ met) > 0.0  # beside two others that met as well
        use = enough & heard[i] & heard[j]
        if not use.any():
            continue
        both = np.zeros((use.sum(), 2, count))
        rows = np.arange(use.sum())
        both[rows, 0, i[use]] = both[rows, 1, j[use]] = 1.0
        R[heard, axis], known[heard, axis] = _solve(
            both[:, :, heard], np.maximum(sums[use, axis], LEAST_VARIANCE), seen[use, axis]
        )
    return R, known


def _solve(both: Matrix, sums: Scalars, seen: Scalars) -> tuple[Vector, Flags]:
    """Solve R_i + R_j = `sums` (P,) for R >= 0, every pair by its relative error.

    `both` (P, 2, K) marks the one and the other IMU of each pair.  The noise of a pair is that of
    its noisier IMU; the squares of two pairs are correlated as the square of what they share.
    """
    A, E = both[:, 0] + both[:, 1], both[:, 0] - both[:, 1]
    weight = np.sqrt(seen) / sums
    R, _ = nnls(weight[:, np.newaxis] * A, weight * sums)
    shared = E @ np.diag(R) @ E.T
    V = 2.0 * EXCESS * shared**2 / np.sqrt(np.outer(seen, seen))
    B = np.linalg.pinv(weight[:, np.newaxis] * A) * weight
    error = np.sqrt(np.einsum('kp,pq,kq->k', B, V, B))
    quietest = np.min(np.where(A > 0.0, sums[:, np.newaxis], np.inf), axis=0)
    known = error <= SURE * quietest
    # A quiet IMU beside noisy ones may come out as 0, which would weigh infinitely.
    return np.maximum(R, np.maximum(error, LEAST_VARIANCE)), known
