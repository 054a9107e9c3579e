"""Figures of the noise of one IMU: Allan deviation with its terms, spectrum, correlogram.

x, y and z have the same colours everywhere.
"""

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator
import numpy as np
from numpy.typing import NDArray

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.calibration.allan_fit import deviation_band, shapes, TERMS
from multiimu_ros.calibration.noise import Spectrum, TriadNoise
from multiimu_ros.calibration.time_series import (
    autocorrelation,
    lag_points,
    partial_autocorrelation,
    white_band,
)
from multiimu_ros.report.figures import draw, XYZ

COLOURS = ('#0072B2', '#D55E00', '#009E73')
TERM_NAMES = {
    'Q': 'Q: quantisation',
    'N': 'N: white noise',
    'B': 'B: bias instability',
    'K': 'K: random walk of the bias',
    'R': 'R: ramp',
}
TERM_DASHES = {
    'Q': (0, (1, 1)),
    'N': (0, (6, 2)),
    'B': (0, (3, 2)),
    'K': (0, (6, 2, 1, 2)),
    'R': (0, (6, 2, 1, 2, 1, 2)),
}
DECADE = 20  # points a decade: the eye needs no more


class Shown(NamedTuple):
    """How a triad is shown: its name, and per SI the unit that people expect."""

    title: str
    unit: str
    per_si: float


SHOWN = {
    'gyroscope': Shown('angular rate', 'mdeg/s', 1e3 * 180 / np.pi),
    'accelerometer': Shown('specific force', 'mm/s²', 1e3),
}


def allan_deviation(noise: TriadNoise, triad: str) -> bytes:
    """Draw the three axes with their 95 % bands, and the terms as their rms over the axes.

    Parameters
    ----------
    noise : TriadNoise
        What the Allan analysis found.
    triad : str
        `gyroscope` or `accelerometer`.
    """
    shown, tau = SHOWN[triad], noise.curve.tau

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        for axis, colour in enumerate(COLOURS):
            deviation = shown.per_si * noise.curve.deviation[:, axis]
            low, high = deviation_band(deviation, noise.fits[axis].dof)
            axes.fill_between(tau, low, high, color=colour, alpha=0.15, lw=0)
            axes.plot(tau, deviation, '.-', color=colour, ms=4, lw=0.9, label=XYZ[axis])
        bottom, top = axes.get_ylim()
        lowest = 0.5 * shown.per_si * noise.curve.deviation.min()
        fine = np.geomspace(tau[0], tau[-1], 200)
        for column, letter in enumerate(TERMS):
            term = noise.together(letter)
            if term.determined:
                line = shown.per_si * term.value * np.sqrt(shapes(fine)[:, column])
                seen = line > lowest
                axes.plot(fine[seen], line[seen], color='black', lw=0.9,
                          ls=TERM_DASHES[letter], label=TERM_NAMES[letter])  # fmt: skip
        axes.set(xscale='log', yscale='log', ylim=(max(bottom, lowest), 1.3 * top))
        axes.set(xlabel='averaging time τ [s]', ylabel=f'{shown.title} [{shown.unit}]')
        _plain_numbers(axes)
        axes.legend(handlelength=2.6)

    return draw(paint, 4.2)


def power_density(spectrum: Spectrum, noise: TriadNoise, triad: str) -> bytes:
    """Draw the noise densities (root of the two-sided power) and the fitted white noise."""
    shown = SHOWN[triad]

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        frequency, density = by_decades(spectrum.frequency, spectrum.two_sided)
        for axis, colour in enumerate(COLOURS):
            axes.plot(frequency, shown.per_si * np.sqrt(density[:, axis]), color=colour,
                      label=XYZ[axis])  # fmt: skip
        white = noise.together('N')
        if white.determined:
            axes.axhline(shown.per_si * white.value, color='black', lw=0.9,
                         ls=TERM_DASHES['N'], label=TERM_NAMES['N'])  # fmt: skip
        axes.set(xscale='log', yscale='log')
        axes.set(xlabel='frequency [Hz]', ylabel=f'{shown.title} [{shown.unit}/√Hz]')
        _plain_numbers(axes)
        figure.legend(loc='outside upper center', ncols=4)

    return draw(paint, 3.4)


def by_decades(
    frequency: Scalars, power: NDArray[np.float64]
) -> tuple[Scalars, NDArray[np.float64]]:
    """Average power densities (F, 3) over at most 20 steps a decade of frequency (F,)."""
    bins = np.unique(np.round(DECADE * np.log10(frequency)), return_inverse=True)[1]
    count = np.bincount(bins)
    columns = [np.bincount(bins, column) / count for column in power.T]
    return np.bincount(bins, frequency) / count, np.column_stack(columns)


def correlogram(values: Vectors, triad: str, lags: int = 40) -> bytes:
    """Draw autocorrelation, partial autocorrelation and lag plot of (N, 3) readings at rest."""
    shown = SHOWN[triad]

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        band = white_band(len(values))
        left.axhspan(-band, band, color='#DDDDDD', lw=0, label='95 % of white noise')
        lag, extremes = np.arange(1, lags + 1), [np.array([-3 * band, 3 * band])]
        for axis, colour in enumerate(COLOURS):
            correlation = autocorrelation(values[:, axis], lags)
            partial = partial_autocorrelation(correlation)
            left.plot(lag, correlation[1:], '.-', color=colour, lw=0.8, ms=5, label=XYZ[axis])
            left.plot(lag, partial[1:], 'o', mfc='none', mec=colour, ms=3.5, mew=0.8)
            extremes += [correlation[1:], partial[1:]]
        left.plot([], [], 'o', mfc='none', mec='black', ms=3.5, mew=0.8, label='partial')
        low, high = np.concatenate(extremes).min(), np.concatenate(extremes).max()
        margin = 0.08 * (high - low)
        left.set(xlabel='lag [samples]', ylabel='autocorrelation [-]',
                 ylim=(low - margin, high + margin))  # fmt: skip
        _lag_plot(right, values, shown)
        figure.legend(*left.get_legend_handles_labels(), loc='outside upper center', ncols=5,
                      columnspacing=1.2)  # fmt: skip

    return draw(paint, 3.4)


def _lag_plot(axes: Axes, values: Vectors, shown: Shown) -> None:
    centred = shown.per_si * (values - values.mean(axis=0))
    reach = 1.5 * float(np.quantile(np.abs(centred), 0.999))
    for axis, colour in enumerate(COLOURS):
        before, now = lag_points(centred[:, axis], most=1000)
        axes.plot(before, now, '.', color=colour, ms=1.5, alpha=0.4)
    axes.set(aspect='equal', xlim=(-reach, reach), ylim=(-reach, reach))
    for axis_of in (axes.xaxis, axes.yaxis):
        axis_of.set_major_locator(MaxNLocator(4))
    axes.set(xlabel=f'sample k − 1 [{shown.unit}]', ylabel=f'sample k [{shown.unit}]')


def _plain_numbers(axes: Axes) -> None:
    """Write 0.1, 1, 10, and where the axis is short 0.2 and 0.5 too."""
    for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
        short = np.log10(high / low) < 2.5
        subs: Sequence[float] = (1.0, 2.0, 5.0) if short else (1.0,)
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter('{x:g}')
        axis.set_minor_formatter('')
