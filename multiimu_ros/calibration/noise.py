"""The noise of one IMU from a recording of it at rest: the `noise` block of the rig file.

White noise (`noise_density`, N), flicker (`bias_instability`, B) and the driving noise of the
bias (`bias_random_walk`, K) are three terms of the Allan fit and never stand in for each other.
What one axis cannot tell, the three may tell together: their mean square is then its value, with
the sigma of that mean.  Where the axes evidently differ, only those that cannot tell are averaged.
What they cannot tell together either stays out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch
from scipy.stats import chi2

from multiimu_ros.arrays import as_vectors, Scalars, Vectors
from multiimu_ros.calibration.allan import allan_curve, AllanCurve
from multiimu_ros.calibration.allan_fit import (
    AllanFit,
    fit_allan,
    SIGNIFICANT,
    Term,
    term_of,
    TERMS,
)
from multiimu_ros.calibration.resting_record import LEAST_S, resting_record, RestingRecord
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig import Noise, PerTriad
from multiimu_ros.samples import ImuSamples

TRIADS = ('gyroscope', 'accelerometer')
BLOCKS = {'noise_density': 'N', 'bias_instability': 'B', 'bias_random_walk': 'K'}
UNLIKE = 0.01  # p-value below which axes differ
SEGMENTS = 16  # of the record in a Welch spectrum, half overlapping
KALIBR = {'noise_density': 'N', 'random_walk': 'K'}
KALIBR_UNITS = {
    'accelerometer_noise_density': 'm/s^2/sqrt(Hz)',
    'accelerometer_random_walk': 'm/s^3/sqrt(Hz)',
    'gyroscope_noise_density': 'rad/s/sqrt(Hz)',
    'gyroscope_random_walk': 'rad/s^2/sqrt(Hz)',
}


@dataclass(frozen=True)
class TriadNoise:
    """What the Allan analysis says about three like axes; u stands for rad/s or m/s^2.

    Parameters
    ----------
    curve : AllanCurve
        Their deviations [u].
    fits : tuple of AllanFit
        x, y, z.
    shared : dict
        By letter, what holds for the axes that alone cannot tell.
    """

    curve: AllanCurve
    fits: tuple[AllanFit, AllanFit, AllanFit]
    shared: dict[str, Term]

    def axes(self, letter: str) -> tuple[Term, Term, Term]:
        """Return a term for x, y, z: its own, or the shared one where an axis cannot tell."""
        own = (fit.terms[letter] for fit in self.fits)
        x, y, z = (term if term.determined else self.shared[letter] for term in own)
        return x, y, z

    def together(self, letter: str) -> Term:
        """Return the root mean square of a term over the axes."""
        return _mean_term(self.fits, letter)


@dataclass(frozen=True)
class NoiseModel:
    """The noise of one IMU, and the rest from which it was told."""

    record: RestingRecord
    gyroscope: TriadNoise
    accelerometer: TriadNoise

    def triad(self, name: str) -> TriadNoise:
        """Return `gyroscope` or `accelerometer`."""
        return self.gyroscope if name == 'gyroscope' else self.accelerometer

    @property
    def noise(self) -> Noise:
        """The block of the rig file; figures that some axis lacks are left out as a whole.

        Raises
        ------
        CalibrationError
            If even the noise density cannot be told.
        """
        blocks: dict[str, PerTriad] = {}
        for name, letter in BLOCKS.items():
            terms = {triad: self.triad(triad).axes(letter) for triad in TRIADS}
            if all(term.determined for axes in terms.values() for term in axes):
                blocks[name] = _per_triad(terms, 'value')
                blocks[f'{name}_sigma'] = _per_triad(terms, 'sigma')
        if 'noise_density' not in blocks:
            msg = (
                'The white noise of the readings must stand out of their steps and drifts, and '
                'does not; check range and resolution with `multiimu inspect`.'
            )
            raise CalibrationError(msg)
        return Noise(**blocks)


def _per_triad(terms: dict[str, tuple[Term, Term, Term]], key: str) -> PerTriad:
    return PerTriad(
        **{triad: tuple(getattr(term, key) for term in axes) for triad, axes in terms.items()}
    )


def fit_noise(samples: ImuSamples, name: str = 'imu', least_s: float = LEAST_S) -> NoiseModel:
    """Tell the noise of an IMU from the longest rest in a recording.

    Parameters
    ----------
    samples : ImuSamples
        Readings, raw or calibrated; motion before and after the rest is cut off.
    name : str
        What to call the IMU in an error.
    least_s : float
        Length below which a rest is refused [s].

    Raises
    ------
    CalibrationError
        If the IMU does not rest long enough, or an axis is stuck.
    """
    record = resting_record(samples, name, least_s)
    for key in ('angular_rate', 'specific_force'):
        stuck = np.ptp(getattr(record.samples, key), axis=0) == 0
        if stuck.any():
            axis = 'xyz'[int(np.argmax(stuck))]
            msg = f'`{key}` of `{name}` must vary, but {axis} is constant; is the sensor stuck?'
            raise CalibrationError(msg)
    gyroscope = triad_noise(record.samples.angular_rate, record.rate_hz)
    return NoiseModel(
        record, gyroscope, triad_noise(record.samples.specific_force, record.rate_hz)
    )


def triad_noise(values: Vectors, rate_hz: float) -> TriadNoise:
    """Analyse (N, 3) evenly spaced readings of a resting triad."""
    curve = allan_curve(values, rate_hz)
    x, y, z = (fit_allan(curve, axis) for axis in range(3))
    shared = {}
    for letter in TERMS:
        silent = [fit for fit in (x, y, z) if not fit.terms[letter].determined]
        if silent:
            shared[letter] = _mean_term((x, y, z) if _alike((x, y, z), letter) else silent, letter)
    return TriadNoise(curve, (x, y, z), shared)


def _alike(fits: Sequence[AllanFit], letter: str) -> bool:
    """Say whether a term may be the same on all axes, by the scatter of their estimates.

    The mean of only those that came out too small to be told would be too small as well.
    """
    index = TERMS.index(letter)
    squares = np.array([fit.free[index] for fit in fits])
    variances = np.array([fit.covariance[index, index] for fit in fits])
    scatter = float(np.sum((squares - squares.mean()) ** 2 / variances))
    return bool(chi2(len(fits) - 1).sf(scatter) > UNLIKE)


def _mean_term(fits: Sequence[AllanFit], letter: str) -> Term:
    """Return the root mean square of a term over axes, whose noise is independent."""
    index, count = TERMS.index(letter), len(fits)
    square = float(np.mean([fit.free[index] for fit in fits]))
    variances = [fit.covariance[index, index] for fit in fits]
    term = term_of(square, float(np.sqrt(np.sum(variances))) / count)
    if term.determined:
        return term
    margins = [_margin(fit, letter) for fit in fits]
    most = max(square, 0.0) + float(np.sqrt(np.sum(np.square(margins)))) / count
    silent = [fit.terms[letter] for fit in fits if not fit.terms[letter].determined]
    needed = min((term.needed_s for term in silent), default=math.inf)
    return Term(math.nan, math.nan, 0.0, math.sqrt(most), needed)


def _margin(fit: AllanFit, letter: str) -> float:
    """Return how much larger the square of a term may be than it was found."""
    index, term = TERMS.index(letter), fit.terms[letter]
    if term.determined:
        return float(SIGNIFICANT * np.sqrt(fit.covariance[index, index]))
    return float(term.high**2 - max(fit.squares[index], 0.0))


@dataclass(frozen=True)
class Spectrum:
    """Welch's estimate of power spectral densities.

    Parameters
    ----------
    frequency : (F,) array
        Above 0 [Hz].
    one_sided : (F, 3) array
        All power at positive frequencies [u^2/Hz]: white noise of density N has 2 N^2.
    """

    frequency: Scalars
    one_sided: NDArray[np.float64]

    @property
    def two_sided(self) -> NDArray[np.float64]:  # (F, 3)
        """Half of it, the convention of the rig file: white noise of density N has N^2."""
        return self.one_sided / 2


def spectrum(values: Vectors, rate_hz: float) -> Spectrum:
    """Estimate the spectra of (N, 3) evenly spaced readings, in pieces of N / 16 (Hann)."""
    values = as_vectors(values, 'values')
    length = min(len(values), max(256, len(values) // SEGMENTS))
    frequency, power = welch(values - values.mean(axis=0), rate_hz, nperseg=length, axis=0)
    return Spectrum(frequency[1:], power[1:])


def kalibr_yaml(model: NoiseModel, topic: str) -> str:
    """Return the IMU file of kalibr: one number a triad, the root mean square of its axes.

    kalibr's `random_walk` is K, the driving noise of the bias.  A figure that the recording does
    not tell is left out, and a comment says so: kalibr will ask for it.
    """
    lines = ['# Root mean square over the axes.']
    for triad in ('accelerometer', 'gyroscope'):
        for name, letter in KALIBR.items():
            key = f'{triad}_{name}'
            term = model.triad(triad).together(letter)
            if term.determined:
                lines.append(f'{key}: {term.value:.6g}  # [{KALIBR_UNITS[key]}]')
            else:
                lines.append(
                    f'# {key}: {model.record.duration:.0f} s do not tell it; at most '
                    f'{term.high:.2g} [{KALIBR_UNITS[key]}]'
                )
    lines += [f'rostopic: {topic}', f'update_rate: {model.record.rate_hz:.6g}  # [Hz]']
    return '\n'.join(lines) + '\n'
