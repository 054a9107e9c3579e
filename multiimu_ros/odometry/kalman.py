"""One measurement into a covariance: the update that both error-state filters share.

Measurements enter one scalar at a time, which is exact when their noises are independent and
needs no matrix inverse.  The covariance follows Joseph's form [1]_, true for any gain; with
a = P h and s = h.a + r it reads P - K a' - a K' + s K K'.  States outside `first`
to `last` are only considered (Schmidt): they widen the others' uncertainty, uncorrected.

.. [1] P. S. Maybeck, "Stochastic Models, Estimation, and Control", vol. 1, 1979, eq. (5-89).
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled


@compiled
def scalar_update(
    error: Vector, P: Matrix, h: Vector, residual: float, variance: float, first: int, last: int
) -> None:
    """Correct `error` and `P` in place by one scalar measurement.

    Parameters
    ----------
    error : (n,) array
        Error estimated so far from this batch of measurements, truth minus estimate.
    P : (n, n) array
        Covariance of the error.
    h : (n,) array
        Row of the measurement matrix: residual = h @ true error + noise.
    residual : float
        Measured minus predicted, at an error of zero.
    variance : float
        Variance of the measurement's noise.
    first, last : int
        The states that the measurement may correct, `last` excluded.
    """
    a, s, innovation = innovate(error, P, h, residual, variance)
    if s > 0.0:
        K = a / s
        K[:first] = 0.0
        K[last:] = 0.0
        correct(error, P, K, a, s, innovation)


@compiled
def innovate(
    error: Vector, P: Matrix, h: Vector, residual: float, variance: float
) -> tuple[Vector, float, float]:
    """Return P h (n,), the innovation's variance and the innovation of a scalar measurement.

    The variance is 0 where a number is none that could be used: a NaN must not reach the state.
    """
    n = len(error)
    a = np.zeros(n)
    innovation, s = residual, variance
    for j in range(n):
        if h[j] != 0.0:
            innovation -= h[j] * error[j]
            for i in range(n):
                a[i] += P[i, j] * h[j]
    for j in range(n):
        s += h[j] * a[j]
    usable = s > 0.0 and np.isfinite(s) and np.isfinite(innovation)
    return a, s if usable else 0.0, innovation


@compiled
def correct(error: Vector, P: Matrix, K: Vector, a: Vector, s: float, innovation: float) -> None:
    """Correct error and P by whatever gain K (n,), with what `innovate` returned."""
    n = len(error)
    for i in range(n):
        error[i] += K[i] * innovation
    for i in range(n):
        for j in range(i + 1):
            P[i, j] += s * K[i] * K[j] - K[i] * a[j] - a[i] * K[j]
            P[j, i] = P[i, j]


@compiled
def propagate(P: Matrix, F: Matrix) -> None:
    """Replace P (n, n) by F P F'; passes over the zeros of F, which are most of it."""
    n = len(P)
    half = np.zeros((n, n))
    for i in range(n):
        for k in range(n):
            f = F[i, k]
            if f != 0.0:
                for j in range(n):
                    half[i, j] += f * P[k, j]
    P[:] = 0.0
    for i in range(n):
        for k in range(n):
            f = F[i, k]
            if f != 0.0:
                for j in range(i + 1):
                    P[j, i] += half[j, k] * f
    for i in range(n):
        for j in range(i):
            P[i, j] = P[j, i]


@compiled
def transform_block(P: Matrix, G: Matrix, first: int) -> None:
    """Replace the error e[first:first+3] by G (3, 3) times itself, in the covariance P (n, n)."""
    n = len(P)
    rows = np.empty((3, n))
    for i in range(3):
        for j in range(n):
            rows[i, j] = (
                G[i, 0] * P[first, j] + G[i, 1] * P[first + 1, j] + G[i, 2] * P[first + 2, j]
            )
    P[first : first + 3, :] = rows
    for j in range(n):
        x, y, z = P[j, first], P[j, first + 1], P[j, first + 2]
        for i in range(3):
            P[j, first + i] = G[i, 0] * x + G[i, 1] * y + G[i, 2] * z


@compiled
def white_equivalent(sigma: float, correlation_time: float, dt: float) -> float:
    """Return the variance of white samples that inform as little as correlated ones.

    Samples of a process of deviation `sigma` and autocorrelation exp(-t / correlation_time),
    averaged over a time T, leave a variance 2 sigma^2 correlation_time / T; white samples of
    variance r leave r dt / T (docs/derivations/error_state.md (9)).
    """
    return sigma * sigma * max(1.0, 2.0 * correlation_time / dt)
