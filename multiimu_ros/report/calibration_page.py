"""The report of a calibration: what was found, how well, and what to do again."""

from collections.abc import Sequence
from html import escape
import os

import numpy as np

from multiimu_ros.arrays import Matrix
from multiimu_ros.calibration.coverage import missing_poses, name_direction
from multiimu_ros.calibration.noise import fit_noise, NoiseModel, TRIADS
from multiimu_ros.calibration.resting_record import LEAST_S
from multiimu_ros.errors import CalibrationError
from multiimu_ros.report.calibration_board_figures import (
    board,
    differences,
    has_board,
    pose_differences,
    poses_of,
)
from multiimu_ros.report.calibration_figures import (
    correlations,
    force_residuals,
    pose_sphere,
    recording,
    residuals,
    turn_residuals,
    up_directions,
)
from multiimu_ros.report.calibration_table import again, FEW, folded, parameters, tally
from multiimu_ros.report.noise_figures import allan_deviation
from multiimu_ros.report.noise_page import duration, noise_rows, untold
from multiimu_ros.report.page import facts, notes, picture, write_page
from multiimu_ros.rig_calibration.calibrate import Calibration, rest_rms
from multiimu_ros.rig_calibration.verdicts import GRADES, Verdict

MILLI = 1e3
ALLAN = (
    'Dots and 95 % bands: the three axes. Black: the terms that the longest rest tells, root mean '
    'square over the axes.'
)


def write_calibration_page(
    path: str | os.PathLike[str],
    calibration: Calibration,
    verdicts: Sequence[Verdict],
    title: str,
) -> None:
    """Write the report of a calibration as one HTML file.

    Parameters
    ----------
    path : str or path
        The file.
    calibration : Calibration
        What was found; parts that were not run are left out, and the page says so.
    verdicts : sequence of Verdict
        On each figure of each IMU.
    title : str
        Heading of the page.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    sections = [
        _facts(calibration),
        again(verdicts),
        _noticed(calibration),
        *_recorded(calibration),
        *_intrinsics(calibration),
        *_clocks(calibration),
        *_placement(calibration),
        *_noise(calibration),
        parameters(verdicts),
    ]
    write_page(path, title, lead(calibration, verdicts), [part for part in sections if part])


def lead(calibration: Calibration, verdicts: Sequence[Verdict]) -> str:
    """Return what was found in one sentence of HTML."""
    count, rests = len(calibration.after.imus), len(calibration.intervals)
    before, after = (_rms(values, calibration) for values in force_residuals(calibration))
    parts = [f'|f| − g at rest {_change(before, after)} rms']
    if count > 1 and np.isfinite(calibration.spread_after):
        change = _change(calibration.spread_before, calibration.spread_after)
        parts.append(f'the spread between IMUs {change}')
    if verdicts:
        worst = max((verdict.grade for verdict in verdicts), key=GRADES.index)
        parts.append(f'the worst verdict is <b>{escape(worst)}</b> ({tally(verdicts)})')
    listed = '; '.join(parts)
    return f'{_number(count, "IMU")}, {_number(rests, "rest")}: {listed}.'


def _number(count: int, noun: str) -> str:
    return f'{count} {noun}{"" if count == 1 else "s"}'


def _change(before: float, after: float) -> str:
    """Return two forces [m/s^2] in words, in millimetres a second squared."""
    if not np.isfinite(after):
        return 'is not known'
    if not np.isfinite(before):
        return f'is now <b>{MILLI * after:.3g} mm/s²</b>'
    return f'went from {MILLI * before:.3g} to <b>{MILLI * after:.3g} mm/s²</b>'


def _rms(values: Matrix, calibration: Calibration) -> float:
    """Return the rms of (P, K) values over IMUs and rests, the longer the more they count."""
    known = np.isfinite(values)
    square = np.where(known, values, 0.0) ** 2
    with np.errstate(invalid='ignore'):
        each = np.sqrt(square.sum(axis=1) / known.sum(axis=1))
    return rest_rms(each, calibration.intervals.duration_s)


def _facts(calibration: Calibration) -> str:
    stamps = calibration.board.tracks[0].samples.stamp_ns
    intervals = calibration.intervals
    values = {
        'IMUs': str(len(calibration.after.imus)),
        'recording': duration(float(np.ptp(stamps)) * 1e-9),
        'rests': str(len(intervals)),
    }
    if len(intervals):
        values['a rest, median'] = duration(float(np.median(intervals.duration_s)))
    if calibration.lever_arms is not None:
        values['motion of all IMUs'] = duration(calibration.lever_arms.moving_s)
    values['gravity'] = f'{calibration.board.gravity:.4f} m/s²'
    return facts(values)


def _noticed(calibration: Calibration) -> str:
    """Return what the calibration noticed on the way, and which stages were left out."""
    lines = [escape(note) for note in calibration.notes]
    several = len(calibration.after.imus) > 1
    parts = {
        'clocks': bool(calibration.alignments) or not several,
        'intrinsics': bool(calibration.intrinsics),
        'rotations': bool(calibration.mountings) or not several,
        'lever arms': calibration.lever_arms is not None or not several,
    }
    lacking = [name for name, there in parts.items() if not there]
    if lacking:
        lines.append(f'Not fitted: {", ".join(lacking)}; the rig file keeps what it said of them.')
    return notes('Noticed', lines) if lines else ''


def _recorded(calibration: Calibration) -> list[str]:
    sections = [
        picture(
            'The recording',
            'How fast the first IMU turned, calibrated. Calibration needs rests, turns between '
            'them, and for lever arms and clocks a minute of waving.',
            recording(calibration),
        )
    ]
    up = up_directions(calibration)
    if len(up):
        lacking = missing_poses(up)
        advice = (
            'missing, the most useful first: '
            + ', '.join(f'({k}) {name}' for k, name in enumerate(lacking, start=1))
            if lacking
            else 'no face and no edge is missing'
        )
        sections.append(
            picture(
                'Poses',
                'Which way was up in each rest, in the frame of the first IMU, on an equal-area '
                f'map; both halves are seen from +z. Of the 6 faces and 12 edges {advice}.',
                pose_sphere(calibration),
            )
        )
    return sections


def _intrinsics(calibration: Calibration) -> list[str]:
    if not len(calibration.intervals):
        return []
    sections = [
        picture(
            'Length of gravity in the rests',
            'An accelerometer at rest must read g, whatever its pose. What the fit calls drift '
            'goes with time or temperature, and no constant bias removes it.',
            residuals(calibration),
        )
    ]
    if any(np.isfinite(fit.turn_residual).any() for fit in calibration.intrinsics):
        rms = [_rms_angle(fit.turn_residual) for fit in calibration.intrinsics]
        listed = ', '.join(
            f'{escape(name)} {angle:.3g}'
            for name, angle in zip(calibration.after.names, rms, strict=True)
        )
        sections.append(
            picture(
                'Gravity after a turn',
                'Angle between the gravity that the integrated rate predicts after each move and '
                f'the one measured there. Rms [deg]: {listed}.',
                turn_residuals(calibration),
            )
        )
    return sections


def _rms_angle(angles: Matrix) -> float:
    known = angles[np.isfinite(angles)]
    return float(np.rad2deg(np.sqrt(np.mean(known**2)))) if len(known) else float('nan')


def _clocks(calibration: Calibration) -> list[str]:
    if not any(calibration.alignments):
        return []
    first = escape(calibration.after.names[0])
    return [
        picture(
            'Clocks',
            f'How well |ω| of each IMU agrees with that of {first} when its stamps are moved by a '
            'delay, and the delays that the fine fit found, with one sigma.',
            correlations(calibration),
        )
    ]


def _placement(calibration: Calibration) -> list[str]:
    if not has_board(calibration):
        return []
    drawn = poses_of(calibration.before) is not None
    caption = 'Positions and axes of the IMUs in the base frame'
    caption += ', and in grey the poses of the rig file that went in. ' if drawn else '. '
    if calibration.lever_arms is None:
        caption += 'The positions are those that went in.'
    else:
        weakest = name_direction(calibration.lever_arms.weakest)
        caption += (
            'Black bars: three sigma, where they are long enough to be seen. The motion tells '
            f'positions worst along {weakest} of the first IMU.'
        )
    sections = [picture('The board as found', caption, board(calibration))]
    if drawn:
        moved, turned = pose_differences(calibration.before, calibration.after)
        apart = MILLI * float(np.linalg.norm(moved, axis=1).max())
        angle = float(np.rad2deg(np.linalg.norm(turned, axis=1).max()))
        sections.append(
            picture(
                'Found and drawn',
                f'At most {apart:.2g} mm and {angle:.2g} deg apart. Positions along the base '
                'axes, rotations about the axes of each IMU. Bars: one sigma, relative to the '
                'first IMU, which therefore has none.',
                differences(calibration),
            )
        )
    return sections


def _noise(calibration: Calibration) -> list[str]:
    """Return Allan plots of every IMU if a rest is long enough, or how long it must be."""
    longest = float(calibration.intervals.duration_s.max(initial=0.0))
    if longest < LEAST_S:
        line = (
            f'For Allan plots let the board rest for at least {duration(LEAST_S)} at a stretch, '
            f'better for hours; its longest rest was {duration(longest)}.'
        )
        return [notes('Noise', [line])]
    parts, names = [], calibration.after.names
    for k, name in enumerate(names):
        try:
            content = _allan(fit_noise(calibration.board.calibrated(k), name))
        except CalibrationError as error:
            content = f'<p>{escape(str(error))}</p>'
        parts.append(folded(name, content, open_=len(names) <= FEW))
    return [f'<section><h2>Noise</h2>{"".join(parts)}</section>']


def _allan(model: NoiseModel) -> str:
    """Return the figures of one IMU and its two Allan plots."""
    items = ''.join(f'<li>{escape(sentence)}</li>' for sentence in untold(model))
    parts = [f'<ul>{items}</ul>' if items else '']
    for triad in TRIADS:
        rows = noise_rows(model, triad)
        head = ''.join(f'<th>{escape(key)}</th>' for key in rows[0])
        body = ''.join(
            '<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row.values()) + '</tr>'
            for row in rows
        )
        table = f'<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'
        plot = allan_deviation(model.triad(triad), triad)
        parts.append(picture(f'{triad}: Allan deviation', ALLAN, plot))
        parts.append(f'<div class="scroll">{table}</div>')
    return ''.join(parts)
