"""The report of `multiimu fuse`: where the rig went, how sure that is, and how its IMUs fared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
import os
from pathlib import Path

import numpy as np

from multiimu_ros.errors import ConfigError
from multiimu_ros.pipeline_config import ImuHealth, ProfileName
from multiimu_ros.report.noise_page import duration
from multiimu_ros.report.page import facts, notes, picture, write_page
from multiimu_ros.report.walk import sound, Walk
from multiimu_ros.report.walk_motion_figures import (
    attitude,
    biases,
    close_up,
    knows_biases,
    speed,
    stride_figure,
)
from multiimu_ros.report.walk_path_figures import height, plan
from multiimu_ros.report.walk_summary import summarise, Summary

NAME = 'fuse.html'
UNKNOWN = '–'
FEW_STRIDES = 3  # fewer make no walk
LOST = 0.1  # of the distance: where 2 sigma are more, nobody should trust the path


@dataclass(frozen=True, kw_only=True)
class WalkFacts:
    """What the page says beside the walk.

    Parameters
    ----------
    recording, rig : str
        Names of the bag and of the board.
    profile : {'hand', 'foot', 'vehicle'}
        What carried the rig.
    imus : sequence of ImuHealth
        State and counters of each IMU at the end.
    benefit : str
        What the array gains over one IMU, in a sentence.
    closing : str
        How far from its start a path ended that was then closed, in a sentence; '' if it was not.
    """

    recording: str
    rig: str
    profile: ProfileName
    imus: Sequence[ImuHealth] = ()
    benefit: str = ''
    closing: str = ''


def write_walk_page(
    folder: str | os.PathLike[str], walk: Walk, about: WalkFacts, smoothed: Walk | None = None
) -> Path:
    """Write the report of a walk as one HTML file, `fuse.html`, into a folder.

    Parameters
    ----------
    folder : str or path
        It is made where it does not exist.
    walk : Walk
        What the odometry knew at each instant, as it came.
    about : WalkFacts
        What the page says beside it.
    smoothed : Walk, optional
        What it knew in hindsight; then this is what is drawn, with the other beneath it.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    ConfigError
        If there is nothing to draw, or the file cannot be written.
    """
    path = _folder(folder) / NAME
    foot = about.profile == 'foot'
    live, noticed = sound(walk)
    best = live if smoothed is None else sound(smoothed)[0]
    first, now = summarise(live, foot=foot), summarise(best, foot=foot)
    sections = [
        _figures(first, None if smoothed is None else now, foot=foot),
        *_remarks([*noticed, *remarks(now, foot=foot)]),
        *_pictures(best, None if smoothed is None else live, now, foot=foot),
        *_imus(about),
    ]
    write_page(path, f'Where {about.rig} went: {about.recording}', lead(now, about), sections)
    return path


def _folder(folder: str | os.PathLike[str]) -> Path:
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f'Cannot make the folder `{folder}`: {error.strerror}; choose a writable place.'
        raise ConfigError(msg) from error
    return Path(folder)


def lead(summary: Summary, about: WalkFacts) -> str:
    """Return the walk in two sentences of HTML."""
    way = (
        f'<b>{metres(summary.distance)}</b> in {duration(summary.duration)}, carried by a '
        f'{escape(about.profile)}'
    )
    if about.closing:
        return f'{way}, and said to have ended where it began. {escape(about.closing)}'
    apart = float(np.linalg.norm(summary.from_start))
    share = f' ({100 * apart / summary.distance:.3g} % of the way)' if summary.distance else ''
    return (
        f'{way}, ended <b>{metres(apart)}</b> from the start{share}. If it '
        'really ended where it began, that is the error; the filter itself expects '
        f'{metres(2 * float(summary.position_sigma[0]))} (2σ) horizontally and '
        f'{metres(2 * float(summary.position_sigma[1]))} in height.'
    )


def metres(length: float) -> str:
    """Return a length in the unit that fits it."""
    if np.isnan(length):
        return UNKNOWN
    if abs(length) < 0.01:
        return f'{1e3 * length:.1f} mm'
    return f'{length:.2f} m' if abs(length) < 100 else f'{length:.0f} m'


def _figures(live: Summary, smoothed: Summary | None, *, foot: bool) -> str:
    """Return the summary: tiles, or a table where a walk is known in two ways."""
    cells = _cells(live, foot=foot)
    if smoothed is None:
        return facts(cells)
    hindsight = _cells(smoothed, foot=foot)
    rows = [{'': key, 'live': cell, 'smoothed': hindsight[key]} for key, cell in cells.items()]
    return _table('In figures', rows)


def _cells(summary: Summary, *, foot: bool) -> dict[str, str]:
    across, upright = (metres(2 * sigma) for sigma in summary.position_sigma.tolist())
    along, up = float(np.hypot(*summary.from_start[:2])), float(summary.from_start[2])
    cells = {
        'duration': duration(summary.duration),
        'way, stance to stance' if foot else 'way, along the path': metres(summary.distance),
        'start to end, horizontal': metres(along),
        'start to end, height': metres(up),
        '2σ of the end, horizontal': across,
        '2σ of the end, height': upright,
        'found still': f'{summary.still_share:.1%}',
    }
    if foot:
        time = summary.stride_time
        cells |= {
            'stances': str(summary.stances),
            'stride length, median': metres(summary.stride_length),
            'stride time, median': UNKNOWN if np.isnan(time) else f'{time:.2f} s',
        }
    return cells


def _table(title: str, rows: Sequence[Mapping[str, str]], note: str = '') -> str:
    head = ''.join(f'<th>{escape(key)}</th>' for key in rows[0])
    body = ''.join(
        '<tr>' + ''.join(f'<td>{escape(cell)}</td>' for cell in row.values()) + '</tr>'
        for row in rows
    )
    words = f'<p class="soft">{escape(note)}</p>' if note else ''
    return (
        f'<section><h2>{escape(title)}</h2>{words}<div class="scroll"><table><thead><tr>{head}'
        f'</tr></thead><tbody>{body}</tbody></table></div></section>'
    )


def remarks(summary: Summary, *, foot: bool) -> list[str]:
    """Return what a reader should know before believing the pictures; sentences of HTML."""
    said = []
    if summary.gaps:
        said.append(
            f'{summary.gaps} gaps without a frame, the longest of {summary.longest_gap:.2f} s: '
            'what happened in them is not known, and lines break there.'
        )
    if not summary.still_share:
        said.append(
            'The rig was never found still, so nothing corrected the drift: velocity and '
            'position are integrals of noise and bias. Rest at the start, and in between.'
        )
    elif foot and summary.stances <= FEW_STRIDES:
        said.append(
            'Hardly any strides were found. If the foot did walk, look at how the board is '
            'mounted and at the <code>profile</code>.'
        )
    if 2 * summary.position_sigma.max() > max(LOST * summary.distance, LOST):
        said.append(
            'At the end 2σ of the position are more than a tenth of the way: the shape of the '
            'path is not to be trusted.'
        )
    return said


def _remarks(lines: Sequence[str]) -> list[str]:
    return [notes('Noticed', lines)] if lines else []


def _pictures(walk: Walk, live: Walk | None, summary: Summary, *, foot: bool) -> list[str]:
    grey = '' if live is None else ' Grey: as the filter knew it live; blue: in hindsight.'
    level = '; on a level floor they lie on a line' if foot else ''
    marks = 'each place where the foot stood' if foot else 'the end of each rest'
    sections = [
        picture(
            'From above',
            f'Dots: {marks}. Ellipses: 2σ of the position at a few instants, where they are '
            f'large enough to be seen.{grey}',
            plan(walk, foot=foot, live=live),
        ),
        picture(
            'Height',
            f'Band: 2σ. Dots: {marks}{level}.{grey}',
            height(walk, foot=foot, live=live),
        ),
        picture('Speed', 'Shaded: the rig was found still.', speed(walk, foot=foot)),
        picture(
            'Attitude',
            'Roll and pitch are the two parts of the tilt about the forward axis and the axis to '
            'the left; yaw is the turn about the vertical since the start, full turns counted '
            'on. Nothing measures yaw, so its sigma grows for good.',
            attitude(walk),
        ),
    ]
    if knows_biases(walk):
        sections.append(
            picture(
                'Biases',
                'What the filter takes for the bias of the fused IMU, in the axes of the base '
                'frame. Bands: 2σ; what they were before the first rest may be cut off.',
                biases(walk),
            )
        )
    if summary.stances > FEW_STRIDES:
        sections += [
            picture(
                'Strides',
                'From one place where the foot stood to the next. Dashed: the median.',
                stride_figure(walk),
            ),
            picture(
                'A few strides close up',
                'From the middle of the walk. Shaded: the foot was found still.',
                close_up(walk),
            ),
        ]
    return sections


def _imus(about: WalkFacts) -> list[str]:
    if not about.imus:
        return [notes('IMUs', [escape(about.benefit)])] if about.benefit else []
    return [_table('IMUs', [_imu(imu) for imu in about.imus], about.benefit)]


def _imu(imu: ImuHealth) -> dict[str, str]:
    raised = [name for name, gap in vars(imu.disagreement).items() if gap.raised]
    return {
        'name': imu.name,
        'state': imu.state,
        'rate [Hz]': f'{imu.rate_hz:.1f}',
        'weight': f'{imu.weight:.0%}',
        'received': str(imu.received),
        'rejected': str(imu.rejected),
        'gaps': str(imu.gaps),
        'excluded': f'{imu.fault.exclusions} ×',
        'recalibrate': ', '.join(raised) or 'no',
    }
