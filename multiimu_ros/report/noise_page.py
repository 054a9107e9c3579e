"""The noise of one IMU as sections of a page: figures in the units of data sheets; pictures."""

from collections.abc import Sequence
from html import escape
import math
from typing import NamedTuple

import numpy as np

from multiimu_ros.calibration.allan_fit import Term
from multiimu_ros.calibration.noise import BLOCKS, NoiseModel, spectrum, TRIADS
from multiimu_ros.calibration.time_series import ModelHint, suggest_model
from multiimu_ros.report.figures import XYZ
from multiimu_ros.report.noise_figures import allan_deviation, correlogram, power_density
from multiimu_ros.report.page import picture

DEGREE = np.pi / 180
MICRO_G = 9.80665e-6  # [m/s^2]
HOUR = 3600.0  # [s]


class Unit(NamedTuple):
    """A unit that data sheets use, and how many there are in one of SI."""

    name: str
    per_si: float


UNITS = {
    'gyroscope': {
        'noise_density': Unit('deg/s/√Hz', 1 / DEGREE),
        'bias_instability': Unit('deg/h', HOUR / DEGREE),
        'bias_random_walk': Unit('deg/h/√h', HOUR * math.sqrt(HOUR) / DEGREE),
    },
    'accelerometer': {
        'noise_density': Unit('µg/√Hz', 1 / MICRO_G),
        'bias_instability': Unit('µg', 1 / MICRO_G),
        'bias_random_walk': Unit('µg/√h', math.sqrt(HOUR) / MICRO_G),
    },
}
NAMES = {
    'noise_density': 'noise density',
    'bias_instability': 'bias instability',
    'bias_random_walk': 'bias random walk',
}


def in_words(term: Term, per_si: float) -> str:
    """Return a term as `value ± sigma`, or the most that it can be, in a unit."""
    if not term.determined:
        return f'< {float(f"{per_si * term.high:.2g}"):g}'
    digits = max(0, 1 - math.floor(math.log10(per_si * term.sigma)))
    return f'{per_si * term.value:.{digits}f} ± {per_si * term.sigma:.{digits}f}'


def noise_rows(model: NoiseModel, triad: str) -> list[dict[str, str]]:
    """Return a row per axis: the three figures of the rig file, with their units in the keys."""
    columns = {
        f'{NAMES[name]} [{unit.name}]': [
            in_words(term, unit.per_si) for term in model.triad(triad).axes(BLOCKS[name])
        ]
        for name, unit in UNITS[triad].items()
    }
    return [
        {triad: axis} | {head: cells[k] for head, cells in columns.items()}
        for k, axis in enumerate(XYZ)
    ]


def untold(model: NoiseModel) -> list[str]:
    """Return a sentence for each figure that the record does not tell, and how long it takes."""
    sentences = []
    for triad in TRIADS:
        for name, letter in BLOCKS.items():
            silent = [t for t in model.triad(triad).axes(letter) if not t.determined]
            if not silent:
                continue
            needed = max(term.needed_s for term in silent)
            hint = (
                f'at least {duration(needed)} would'
                if math.isfinite(needed)
                else 'no length that is worth waiting for would'
            )
            sentences.append(
                f'{triad}: {duration(model.record.duration)} of rest do not tell the '
                f'{NAMES[name]} of {len(silent)} of 3 axes; {hint}.'
            )
    return sentences


def duration(seconds: float) -> str:
    """Return a length of time in the unit that fits it."""
    for unit, size in (('h', HOUR), ('min', 60.0)):
        if seconds >= 2 * size:
            return f'{seconds / size:.3g} {unit}'
    return f'{seconds:.3g} s'


def model_hints(model: NoiseModel) -> dict[str, tuple[ModelHint, ...]]:
    """Return what kind of process each axis looks like."""
    return {
        triad: tuple(suggest_model(axis, model.record.rate_hz) for axis in _values(model, triad).T)
        for triad in TRIADS
    }


def noise_sections(name: str, model: NoiseModel) -> list[str]:
    """Return the sections of one IMU: its figures, what they lack, and six pictures.

    Parameters
    ----------
    name : str
        Of the IMU.
    model : NoiseModel
        What `fit_noise` returned.
    """
    hints = model_hints(model)
    sections = [_summary(name, model)]
    for triad in TRIADS:
        noise, values = model.triad(triad), _values(model, triad)
        lines = [
            f'{axis}: {hint.kind}. {hint.reason}'
            for axis, hint in zip(XYZ, hints[triad], strict=True)
        ]
        sections += [
            picture(
                f'{name}, {triad}: Allan deviation',
                'Dots and 95 % bands: the three axes. Black: the terms that the record tells, '
                'root mean square over the axes.',
                allan_deviation(noise, triad),
            ),
            picture(
                f'{name}, {triad}: noise density',
                'Root of the two-sided power density (Welch); one-sided would be √2 more.',
                power_density(spectrum(values, model.record.rate_hz), noise, triad),
            ),
            picture(
                f'{name}, {triad}: correlation of samples',
                '<br>'.join(map(escape, lines)),
                correlogram(values, triad),
            ),
        ]
    return sections


def _values(model: NoiseModel, triad: str) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    samples = model.record.samples
    return samples.angular_rate if triad == 'gyroscope' else samples.specific_force


def _summary(name: str, model: NoiseModel) -> str:
    tables = ''.join(_table(noise_rows(model, triad)) for triad in TRIADS)
    facts = (
        f'{duration(model.record.duration)} of rest at {model.record.rate_hz:.1f} Hz, '
        f'{model.record.lost} samples lost. ± is one standard deviation; &lt; is what the figure '
        'stays below with 95 % confidence.'
    )
    missing = ''.join(f'<li>{escape(sentence)}</li>' for sentence in untold(model))
    listed = f'<ul>{missing}</ul>' if missing else ''
    return f'<section><h2>{escape(name)}</h2><p class="soft">{facts}</p>{tables}{listed}</section>'


def _table(rows: Sequence[dict[str, str]]) -> str:
    head = ''.join(f'<th>{escape(key)}</th>' for key in rows[0])
    body = ''.join(
        '<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row.values()) + '</tr>'
        for row in rows
    )
    return (
        f'<div class="scroll"><table><thead><tr>{head}</tr></thead>'
        f'<tbody>{body}</tbody></table></div>'
    )
