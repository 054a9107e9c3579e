"""Figures of how a walk went: speed, attitude, biases, strides."""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, Vectors
from multiimu_ros.report.figures import draw, FUSED, XYZ
from multiimu_ros.report.noise_figures import COLOURS
from multiimu_ros.report.walk import Walk
from multiimu_ros.report.walk_axes import (
    DEGREES,
    legend,
    lines,
    mark_size,
    shade,
    SIGMAS,
    time_axis,
)
from multiimu_ros.report.walk_summary import find_stances, strides, worst_horizontal

CLOSE_UP = 5  # strides
STRIDES_S = 2.5  # [s] about two strides of a walk
LONG = 120.0  # [s] longer motions are a block of ink
LEAST_SIGMA = 1e-5  # [rad] the yaw of the start is zero by definition


def speed(walk: Walk, *, foot: bool) -> bytes:
    """Draw the speed, the velocity along the axes, and the spans found still.

    A foot stops in every stride, so its velocity is drawn as the mean over some strides.
    """
    window = max(STRIDES_S, walk.seconds[-1] / 200)
    slow = foot or walk.seconds[-1] > LONG
    total = np.linalg.norm(walk.velocity_n, axis=1, keepdims=True)

    def paint(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        shade(upper, walk, 'found still')
        shade(lower, walk)
        upper.plot(*lines(walk, total), color=FUSED, lw=0.8, alpha=0.5 if slow else 1.0,
                   label='speed')  # fmt: skip
        if slow:
            upper.plot(*lines(walk, _mean(walk, total, window)), color='black', lw=1.3,
                       label=f'mean over {window:.3g} s')  # fmt: skip
        upper.set(ylabel='speed [m/s]', ylim=(0, None))
        _three(lower, walk, _mean(walk, walk.velocity_n, window) if slow else walk.velocity_n)
        lower.set_ylabel('mean velocity\n[m/s]' if slow else 'velocity\n[m/s]')
        lower.legend(ncols=3, loc='lower right', bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
        time_axis(lower, walk)
        legend(figure, upper, 3)

    return draw(paint, 4.8)


def _mean(walk: Walk, values: Matrix, window: float) -> Matrix:
    """Return the running mean over a window [s] of values (N, C) that come evenly."""
    step = float(np.median(np.diff(walk.seconds)))
    return np.asarray(uniform_filter1d(values, max(round(window / step), 1), axis=0))


def _three(axes: Axes, walk: Walk, values: Vectors) -> None:
    time, rows = lines(walk, values)
    for column, colour in enumerate(COLOURS):
        axes.plot(time, rows[:, column], color=colour, lw=1.0, label=XYZ[column])


def attitude_angles(walk: Walk) -> tuple[Vectors, Matrix]:
    """Return roll, pitch, yaw (N, 3), and the sigma (N, 2) of tilt and yaw [rad].

    R_nb is a turn by yaw about the vertical after a tilt about a horizontal axis, of which roll
    and pitch are the two parts.  Near level these are the usual angles, but they do not jump
    where a toe points straight down.
    """
    z, w = walk.orientation[:, 2], walk.orientation[:, 3]
    yaw = 2 * np.arctan2(z, w)
    turn = Rotation.from_euler('Z', yaw[:, np.newaxis])
    tilt = (turn.inv() * Rotation.from_quat(walk.orientation)).as_rotvec()
    P = walk.rotation_covariance
    sigma = np.column_stack([worst_horizontal(P), np.sqrt(np.maximum(P[:, 2, 2], 0.0))])
    return np.column_stack([tilt[:, :2], np.unwrap(yaw)]), sigma


def attitude(walk: Walk) -> bytes:
    """Draw roll and pitch, yaw, and how uncertain they are."""

    def paint(figure: Figure) -> None:
        tilt, turn, lower = figure.subplots(3, 1, sharex=True)
        angles, sigma = attitude_angles(walk)
        for axes in (tilt, turn):
            shade(axes, walk)
        time, rows = lines(walk, DEGREES * angles)
        tilt.plot(time, rows[:, 0], color=COLOURS[0], lw=0.9, label='roll')
        tilt.plot(time, rows[:, 1], color=COLOURS[1], lw=0.9, label='pitch')
        turn.plot(time, rows[:, 2], color=COLOURS[2], lw=1.0)
        for column, colour, label in ((0, 'black', 'tilt'), (1, COLOURS[2], 'yaw')):
            line = DEGREES * np.maximum(sigma[:, [column]], LEAST_SIGMA)
            lower.plot(*lines(walk, line), color=colour, label=label)
        tilt.set_ylabel('roll, pitch\n[deg]')
        turn.set_ylabel('yaw\n[deg]')
        lower.set(ylabel='1σ [deg]', yscale='log')
        lower.yaxis.set_major_formatter('{x:g}')
        lower.legend(ncols=2, loc='upper right')
        time_axis(lower, walk)
        legend(figure, tilt, 2)

    return draw(paint, 5.6)


def knows_biases(walk: Walk) -> bool:
    """Say whether there are biases to draw."""
    return bool(np.isfinite(walk.gyro_bias).any() and np.isfinite(walk.accel_bias).any())


def biases(walk: Walk) -> bytes:
    """Draw what is known of the biases in the base frame, with a band."""

    def paint(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        _bias_panel(upper, walk, DEGREES * walk.gyro_bias, DEGREES * walk.gyro_bias_sigma)
        _bias_panel(lower, walk, 1e3 * walk.accel_bias, 1e3 * walk.accel_bias_sigma)
        upper.set_ylabel('gyro bias\n[deg/s]')
        lower.set_ylabel('accel bias\n[mm/s²]')
        time_axis(lower, walk)
        legend(figure, upper, 3)

    return draw(paint, 4.8)


def _bias_panel(axes: Axes, walk: Walk, bias: Vectors, sigma: Vectors) -> None:
    low, high = bias - SIGMAS * sigma, bias + SIGMAS * sigma
    time, rows = lines(walk, np.hstack([bias, low, high]))
    for column, colour in enumerate(COLOURS):
        axes.fill_between(time, rows[:, 3 + column], rows[:, 6 + column], color=colour,
                          alpha=0.13, lw=0)  # fmt: skip
        axes.plot(time, rows[:, column], color=colour, lw=1.2, label=XYZ[column])
    # The wide band before the first rest would flatten all that follows.
    bottom = min(np.nanquantile(low, 0.05, axis=0).min(), np.nanmin(low[-1]))
    top = max(np.nanquantile(high, 0.95, axis=0).max(), np.nanmax(high[-1]))
    room = max(0.1 * (top - bottom), 1e-9)
    axes.set_ylim(bottom - room, top + room)


def stride_figure(walk: Walk) -> bytes:
    """Draw length and time of every stride of a foot."""
    stances = find_stances(walk)
    length, time = strides(walk, stances)

    def paint(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        when = walk.seconds[stances.begin[1:]]
        for axes, values, label in ((upper, length, 'length [m]'), (lower, time, 'time [s]')):
            axes.plot(when, values, '.', color=FUSED, ms=mark_size(len(when)) + 2)
            axes.axhline(float(np.nanmedian(values)), color='black', lw=1.0, ls=(0, (4, 3)))
            axes.set_ylabel(label)
            axes.set_ylim(0, 1.15 * float(np.nanmax(values)))
        time_axis(lower, walk)

    return draw(paint, 3.8)


def close_up(walk: Walk) -> bytes:
    """Draw a few strides from the middle of a walk: height, speed, pitch."""
    stances = find_stances(walk)
    first = max((len(stances) - CLOSE_UP) // 2, 0)
    last = min(first + CLOSE_UP, len(stances) - 1)
    part = walk.select(slice(int(stances.begin[first]), int(stances.end[last]) + 1))
    begin = float(walk.seconds[stances.begin[first]])

    def paint(figure: Figure) -> None:
        panels = figure.subplots(3, 1, sharex=True)
        pitch = DEGREES * attitude_angles(part)[0][:, 1]
        total = np.linalg.norm(part.velocity_n, axis=1)
        lifted = 100 * (part.position_n[:, 2] - part.position_n[0, 2])
        labels = ('height [cm]', 'speed [m/s]', 'pitch [deg]')
        for axes, values, label in zip(panels, (lifted, total, pitch), labels, strict=True):
            shade(axes, part, 'found still' if label == labels[0] else '')
            axes.plot(*lines(part, values[:, np.newaxis]), color=FUSED)
            axes.set_ylabel(label)
        panels[-1].set(xlabel=f'time from {begin:.1f} s on [s]', xlim=(0, part.seconds[-1]))
        legend(figure, panels[0], 1)

    return draw(paint, 5.0)
