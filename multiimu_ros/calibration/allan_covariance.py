"""How far overlapping Allan variances scatter together, from the spectrum of the noise.

Allan variances of one record share its samples, and neighbouring averaging times nearly all of
them.  With D_i the differences of neighbouring averages and C_ab(k) the covariance of those at
lengths m_a and m_b, k samples apart, Gaussian noise has (docs/derivations/allan.md)

    Cov[avar_a, avar_b] = 1/2 sum_k w(k) C_ab(k)^2  ~  1 / (2 M) integral S^2 |H_a|^2 |H_b|^2 df,
    |H_m(f)| = 2 sin^2(pi f m) / (m sin(pi f)),    M = max(M_a, M_b),

with f in cycles per sample.  S is a sum of four known shapes, so the integrals are computed once
for a length of record and serve every axis.  A rate ramp R adds to D its mean d = R tau, and
to the covariance d_a d_b Cov[mean D_a, mean D_b].
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from multiimu_ros.arrays import Matrix, Scalars, Vector
from multiimu_ros.calibration.allan import averaging_factors

RANDOM = 4  # quantisation, white, flicker, random walk; the ramp is no noise
BLOCK = 1 << 14  # frequencies at a time
FINE = 16  # steps per 1 / record, where the mean over a record has its spectrum
REACH = 256  # how far that is looked at [1 / record]


def unit_spectra(frequency: Scalars) -> NDArray[np.float64]:  # (4, F)
    """Return the two-sided densities per sample of Q, N, B and K of size 1 at a rate of 1 Hz.

    Parameters
    ----------
    frequency : (F,) array
        Cycles per sample, above 0.
    """
    step = 4 * np.sin(np.pi * frequency) ** 2
    return np.array([step, np.ones_like(step), 1 / (2 * np.pi * frequency), 1 / step])


@dataclass(frozen=True)
class CovarianceBasis:
    """Covariances of the Allan variances of one length of record, shape by shape of the noise.

    Parameters
    ----------
    pairs : (4, 4, P, P) array
        Of products of two shapes of noise.
    ramps : (4, P, P) array
        Of each shape with a ramp.
    """

    pairs: NDArray[np.float64]
    ramps: NDArray[np.float64]

    def covariance(self, squares: Vector, rate_hz: float, factor: NDArray[np.int64]) -> Matrix:
        """Return the covariance (P, P) of the Allan variances [u^4].

        Parameters
        ----------
        squares : (5,) array
            Q^2, N^2, B^2, K^2, R^2 in SI; the first may be negative.
        rate_hz : float
            Sampling rate [Hz].
        factor : (P,) int array
            Averaging lengths.
        """
        unit = squares[:RANDOM] * rate_hz ** np.array([2.0, 1.0, 0.0, -1.0])
        lift = np.sqrt(squares[RANDOM]) * factor / rate_hz
        noise = np.einsum('t,u,tuab->ab', unit, unit, self.pairs)
        ramp = np.einsum('t,tab->ab', unit, self.ramps)
        return np.asarray(noise + np.outer(lift, lift) * ramp)

    def since(self, first: int) -> 'CovarianceBasis':
        """Return the basis without the `first` shortest averaging times."""
        return CovarianceBasis(self.pairs[:, :, first:, first:], self.ramps[:, first:, first:])


@lru_cache(maxsize=32)
def covariance_basis(count: int) -> CovarianceBasis:
    """Compute the basis for a record of `count` samples and its `averaging_factors`."""
    factor = averaging_factors(count)
    averages = np.asarray(count + 1 - 2 * factor, np.float64)
    pairs = np.zeros((RANDOM, RANDOM, len(factor), len(factor)))
    for begin in range(0, count // 2, BLOCK):
        # Midpoints of 1 / count are exact for polynomials of the degree that these have.
        frequency = (np.arange(begin, min(begin + BLOCK, count // 2)) + 0.5) / count
        gain = _gain(factor, frequency) ** 2
        spectra = unit_spectra(frequency)
        for t in range(RANDOM):
            for u in range(t + 1):
                pairs[t, u] += (gain * (spectra[t] * spectra[u])) @ gain.T
    for t in range(RANDOM):
        pairs[:t, t] = pairs[t, :t]
    pairs *= 2 / count / (2 * np.maximum.outer(averages, averages))  # 2: negative frequencies
    return CovarianceBasis(pairs, _ramps(count, factor, averages))


def _gain(factor: NDArray[np.int64], frequency: Scalars) -> NDArray[np.float64]:  # (P, F)
    """Return |H|, the gain from readings to differences of neighbouring averages."""
    m = factor[:, np.newaxis].astype(float)
    return np.asarray(2 * np.sin(np.pi * m * frequency) ** 2 / (m * np.sin(np.pi * frequency)))


def _ramps(
    count: int, factor: NDArray[np.int64], averages: Scalars
) -> NDArray[np.float64]:  # (4, P, P)
    """Return the covariance of the means of all differences of a record."""
    frequency = (np.arange(min(FINE * REACH, FINE * count // 2)) + 0.5) / (FINE * count)
    M = averages[:, np.newaxis]
    mean = np.sin(np.pi * frequency * M) / (M * np.sin(np.pi * frequency))
    gain = _gain(factor, frequency) * mean
    weighted = unit_spectra(frequency)[:, np.newaxis] * gain
    return np.asarray(2 / (FINE * count) * weighted @ gain.T)
