"""Overlapping Allan deviation of three axes [1]_.

Half the mean square of the difference of neighbouring averages over tau, for every place at which
the two fit into the record:

    sigma^2(tau) = 1/2 mean_i (ybar_{i+m} - ybar_i)^2,   ybar_i = mean(y_i ... y_{i+m-1}),
    tau = m / rate

TUM report (6) and thesis (5.9) lack the factor 1/2.  allantools computes it; what the numbers are
worth, and what they say about the sensor, is in `allan_fit`.

.. [1] W. J. Riley, "Handbook of Frequency Stability Analysis", NIST SP 1065, 2008, eq. (11).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from multiimu_ros.arrays import as_vectors, Scalars, Vectors

Counts = NDArray[np.int64]  # (P,)

SHARE = 8  # the longest averages are this part of the record: fewer than seven say little
LEAST = 64  # samples


@dataclass(frozen=True)
class AllanCurve:
    """Allan deviations of one triad at P averaging times.

    Parameters
    ----------
    rate_hz : float
        Sampling rate [Hz].
    count : int
        Length of the record [samples].
    factor : (P,) int array
        Averaging lengths m [samples].
    averages : (P,) int array
        How many differences each deviation is the mean of; they overlap.
    deviation : (P, 3) array
        Allan deviations, in the unit u of the readings [u].
    """

    rate_hz: float
    count: int
    factor: Counts
    averages: Counts
    deviation: Vectors

    @property
    def tau(self) -> Scalars:
        """Averaging times (P,) [s]."""
        return np.asarray(self.factor / self.rate_hz)


def averaging_factors(count: int) -> Counts:
    """Return the averaging lengths, two an octave, from 1 to an eighth of `count` samples."""
    octaves = np.log2(count / SHARE)
    return np.unique(np.round(2 ** np.arange(0.0, octaves + 1e-9, 0.5))).astype(np.int64)


def allan_curve(values: Vectors, rate_hz: float) -> AllanCurve:
    """Compute the overlapping Allan deviation of evenly spaced readings.

    Parameters
    ----------
    values : (N, 3) array
        Readings [u]; gaps are closed or cut out beforehand (`noise.gap_free`).
    rate_hz : float
        Sampling rate [Hz].

    Raises
    ------
    ValueError
        If readings are not finite, never change, or are too few.
    """
    import allantools  # type: ignore[import-untyped]  # noqa: PLC0415 it takes half a second

    values = as_vectors(values, 'values')
    if len(values) < LEAST:
        msg = f'`values` must have at least {LEAST} samples, got {len(values)}.'
        raise ValueError(msg)
    if not np.isfinite(values).all():
        bad = int((~np.isfinite(values)).any(axis=1).sum())
        msg = f'`values` must be finite, got {bad} samples that are not; cut them out.'
        raise ValueError(msg)
    factor = averaging_factors(len(values))
    columns = [
        allantools.oadev(axis, rate=rate_hz, data_type='freq', taus=factor / rate_hz)[1]
        for axis in values.T  # from which it takes the mean: sums of g would cost digits
    ]
    deviation = np.column_stack(columns)
    if not (deviation > 0).all():
        axis = 'xyz'[int(np.argmin(deviation.min(axis=0)))]
        msg = f'`values` must change, got a constant {axis} axis; is the sensor stuck?'
        raise ValueError(msg)
    return AllanCurve(rate_hz, len(values), factor, len(values) + 1 - 2 * factor, deviation)
