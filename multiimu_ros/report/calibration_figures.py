"""Figures of what a calibration was made from: the recording, its poses, what the fits left.

Every IMU has its colour throughout; the ninth and later ones repeat colours with other markers.
"""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
import numpy as np

from multiimu_ros.arrays import Matrix, NANOSECONDS, Scalars, Vectors
from multiimu_ros.calibration.coverage import CANDIDATES, missing_poses, name_direction
from multiimu_ros.report.figures import draw, IMU_COLOURS, STILL
from multiimu_ros.rig_calibration.board import pose_means
from multiimu_ros.rig_calibration.calibrate import Calibration
from multiimu_ros.rig_calibration.motion import MOVING

MISSING, COVERED, POSE = '#D55E00', '#9AA5AF', '#0072B2'
DEGREE = np.pi / 180
SLOW = 0.01  # [deg/s] a gyroscope that never says more is dead; the axis needs a size
BINS = 1500  # more columns than the picture shows
BOUT_S = 5.0  # of turning without a rest: from pose to pose it takes three
WAVING_S = 15.0  # of bouts that short rests join: less is no waving
NEAR, LEAST_STEPS = 0.98, 6  # of the peak; how far its picture reaches at least
LEGEND_COLUMNS = 4


def look(imu: int) -> dict[str, Any]:
    """Return colour and marker of an IMU."""
    colours = len(IMU_COLOURS)
    return {'color': IMU_COLOURS[imu % colours], 'marker': 'os'[imu // colours % 2]}


def up_directions(calibration: Calibration) -> Vectors:
    """Return which way was up in each rest (P, 3), in the frame of the first IMU [-]."""
    force = pose_means(calibration.board.calibrated(0), calibration.intervals)
    force = force[np.isfinite(force).all(axis=1)]
    return np.asarray(force / np.linalg.norm(force, axis=1, keepdims=True))


def force_residuals(calibration: Calibration) -> tuple[Matrix, Matrix]:
    """Return |f| - g (P, K) of each rest as read, and as calibrated [m/s^2]; NaN if not heard."""
    if calibration.intrinsics:
        fits = calibration.intrinsics
        before = np.column_stack([fit.residual_before for fit in fits])
        return before, np.column_stack([fit.residual_after for fit in fits])
    board, columns = calibration.board, []
    for k, track in enumerate(board.tracks):
        for samples in (track.samples, board.calibrated(k)):
            force = pose_means(samples, calibration.intervals)
            columns.append(np.linalg.norm(force, axis=1) - board.gravity)
    stacked = np.column_stack(columns)
    return stacked[:, ::2], stacked[:, 1::2]


def rest_minutes(calibration: Calibration) -> Scalars:
    """Return the middle of each rest (P,) since the beginning [min]."""
    intervals, start_ns = calibration.intervals, calibration.board.tracks[0].samples.stamp_ns[0]
    begin = (intervals.begin_ns - start_ns) / NANOSECONDS
    return np.asarray((begin + intervals.duration_s / 2) / 60)


def waving(calibration: Calibration) -> list[tuple[float, float]]:
    """Return begin and end of the spans in which the board was waved about [min]."""
    samples, intervals = calibration.board.calibrated(0), calibration.intervals
    rate = np.linalg.norm(samples.angular_rate, axis=1)
    begins = np.r_[samples.stamp_ns[:1], intervals.end_ns]
    ends = np.r_[intervals.begin_ns, samples.stamp_ns[-1:]]
    spans: list[list[int]] = []
    for begin, end in zip(begins.tolist(), ends.tolist(), strict=True):
        inside = slice(*np.searchsorted(samples.stamp_ns, [begin, end]))
        if end - begin < BOUT_S * NANOSECONDS or np.median(rate[inside]) < MOVING:
            continue
        if spans and begin - spans[-1][1] < BOUT_S * NANOSECONDS:
            spans[-1][1] = end
        else:
            spans.append([begin, end])
    minutes = (np.array(spans).reshape(-1, 2) - samples.stamp_ns[0]) / NANOSECONDS / 60
    return [(begin, end) for begin, end in minutes.tolist() if end - begin >= WAVING_S / 60]


def recording(calibration: Calibration) -> bytes:
    """Draw how fast the first IMU turned, with the rests, the waving and what was out of range."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        _shade_rests(axes, calibration)
        minutes, low, high = _envelope(calibration)
        axes.fill_between(minutes, low, high, color=POSE, lw=0.6)
        top = max(float(high.max()), SLOW)
        bottom = max(float(np.quantile(low, 0.02)), 1e-4 * top)
        for begin, end in waving(calibration):
            axes.annotate('', (begin, 2.2 * top), (end, 2.2 * top),
                          arrowprops={'arrowstyle': '<->', 'color': '#1b2530'})  # fmt: skip
            axes.text((begin + end) / 2, 2.5 * top, 'waving', ha='center', va='bottom')
        spoilt = _spoilt_minutes(calibration)
        if len(spoilt):
            axes.plot(spoilt, np.full(len(spoilt), 1.5 * top), '|', color=MISSING, ms=6,
                      label='out of range (any IMU)')  # fmt: skip
        axes.set(yscale='log', xlim=(minutes[0], minutes[-1]), ylim=(bottom, 7.0 * top))
        axes.set(xlabel='time [min]', ylabel='rate of turn |ω| [deg/s]')
        axes.yaxis.set_major_formatter('{x:g}')
        axes.grid(visible=False, axis='x')
        if axes.get_legend_handles_labels()[0]:
            figure.legend(loc='outside upper right', ncols=2, handlelength=1.2)

    return draw(paint, 3.2)


def _shade_rests(axes: Axes, calibration: Calibration) -> None:
    label, half = 'at rest', calibration.intervals.duration_s / 120
    for middle, reach in zip(rest_minutes(calibration), half, strict=True):
        axes.axvspan(middle - reach, middle + reach, color=STILL, zorder=0, lw=0, label=label)
        label = ''


def _envelope(calibration: Calibration) -> tuple[Scalars, Scalars, Scalars]:
    """Return instants [min] and between which rates the first IMU turned there [deg/s]."""
    samples = calibration.board.calibrated(0)
    rate = np.linalg.norm(samples.angular_rate, axis=1) / DEGREE
    starts = np.unique(np.linspace(0, len(rate), BINS, endpoint=False).astype(int))
    minutes = (samples.stamp_ns[starts] - samples.stamp_ns[0]) / NANOSECONDS / 60
    return minutes, np.minimum.reduceat(rate, starts), np.maximum.reduceat(rate, starts)


def _spoilt_minutes(calibration: Calibration) -> Scalars:
    """Return when any IMU was out of its range [min], thinned to what a picture shows."""
    tracks = calibration.board.tracks
    start_ns = int(tracks[0].samples.stamp_ns[0])
    when = np.concatenate([track.seconds_since(start_ns)[~track.usable] for track in tracks])
    column = max(float(np.ptp(tracks[0].seconds_since(start_ns))) / BINS, 1e-9)
    return np.asarray(np.unique(np.round(when / column)) * column / 60)


def on_map(up: Vectors) -> Matrix:
    """Return where directions (N, 3) lie on an equal-area map (N, 2) of their hemisphere.

    Lambert's azimuthal projection, both halves seen from +z: the pole in the middle, the equator
    on the unit circle.
    """
    flat = np.hypot(up[:, 0], up[:, 1])[:, np.newaxis]
    along = np.divide(up[:, :2], flat, out=np.zeros((len(up), 2)), where=flat > 0)
    return np.asarray(along * np.sqrt(np.maximum(1 - np.abs(up[:, [2]]), 0.0)))


def pose_sphere(calibration: Calibration) -> bytes:
    """Draw which way was up in the rests on a map of both hemispheres, and what is missing."""
    up = up_directions(calibration)
    missing = missing_poses(up)
    names = [f'{name_direction(direction, signed=True)} up' for direction in CANDIDATES]

    def paint(figure: Figure) -> None:
        for axes, sign in zip(figure.subplots(1, 2), (1.0, -1.0), strict=True):
            _globe(axes, '+z' if sign > 0 else '−z')
            for name, (x, y), z in zip(names, on_map(CANDIDATES), CANDIDATES[:, 2], strict=True):
                if sign * z < 0:
                    continue
                if name in missing:
                    axes.plot(x, y, 'o', mfc='white', mec=MISSING, mew=1.8, ms=13, zorder=4)
                    axes.text(x, y, f'{missing.index(name) + 1}', ha='center', va='center',
                              color=MISSING, fontsize=8, fontweight='bold', zorder=5)  # fmt: skip
                else:
                    axes.plot(x, y, '+', color=COVERED, ms=9, mew=1.2, zorder=2)
            here = on_map(up[sign * up[:, 2] >= 0])
            axes.plot(here[:, 0], here[:, 1], 'o', color=POSE, ms=5.5, mec='white', mew=0.5,
                      zorder=3)  # fmt: skip
        axes.plot([], [], 'o', color=POSE, ms=5.5, label='a rest')
        axes.plot([], [], '+', color=COVERED, ms=9, mew=1.2, label='wanted and there')
        axes.plot([], [], 'o', mfc='white', mec=MISSING, mew=1.8, ms=9,
                  label='wanted but missing')  # fmt: skip
        figure.legend(loc='outside upper center', ncols=3, handlelength=1.0)

    return draw(paint, 4.2)


def _globe(axes: Axes, pole: str) -> None:
    """Draw the rim of a hemisphere, its parallels and meridians, and the names of the faces."""
    angle = np.linspace(0, 2 * np.pi, 181)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    axes.fill(*circle.T, color='#F7F9FB', zorder=0)
    for height in (0.0, 0.5, np.sqrt(0.75)):  # 0, 30 and 60 deg above the equator
        radius = np.sqrt(1 - height)
        axes.plot(*(radius * circle).T, color='#8793A0' if height == 0 else '#DDE3E8',
                  lw=1.0 if height == 0 else 0.6, zorder=1)  # fmt: skip
    for x, y in circle[:90:15]:
        axes.plot([-x, x], [-y, y], color='#DDE3E8', lw=0.6, zorder=1)
    for face, x, y in (('+x', 1.19, 0), ('−x', -1.19, 0), ('+y', 0, 1.19), ('−y', 0, -1.19)):
        axes.text(x, y, face, ha='center', va='center')
    axes.text(0.08, -0.08, pole, ha='left', va='top', zorder=6,
              bbox={'color': 'white', 'alpha': 0.75, 'pad': 1.0})  # fmt: skip
    axes.set_title(f'{pole} half', loc='center')
    axes.set(aspect='equal', xlim=(-1.3, 1.3), ylim=(-1.3, 1.3))
    axes.axis('off')


def residuals(calibration: Calibration) -> bytes:
    """Draw |f| - g of each rest as read and as calibrated, and the drift that the fit found."""
    before, after = (1e3 * values for values in force_residuals(calibration))
    minutes = rest_minutes(calibration)

    def paint(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for k, name in enumerate(calibration.after.names):
            for axes, values in ((upper, before), (lower, after)):
                axes.plot(minutes, values[:, k], ls='none', ms=3.5, **look(k),
                          label=name if axes is upper else None)  # fmt: skip
            if calibration.intrinsics:
                fit = calibration.intrinsics[k]
                drift = 1e3 * fit.fit.accelerometer.drift
                lower.plot(minutes[fit.poses.known], drift, color=look(k)['color'], lw=1.0)
        for axes in (upper, lower):
            axes.axhline(0.0, color='black', lw=0.8)
        upper.set(title='as read', ylabel='|f| − g [mm/s²]')
        lower.set(title='as calibrated', ylabel='|f| − g [mm/s²]', xlabel='time [min]')
        if calibration.intrinsics:
            lower.plot(
                [], [], color='black', lw=1.0, label='drift of the bias, as the fit sees it'
            )
            lower.legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
        _name_imus(figure, upper, len(before.T))

    return draw(paint, 5.0 + 0.25 * _rows(len(before.T)))


def turn_residuals(calibration: Calibration) -> bytes:
    """Draw the angle between predicted and measured gravity after each move."""
    minutes = rest_minutes(calibration)

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        for k, (fit, name) in enumerate(
            zip(calibration.intrinsics, calibration.after.names, strict=True)
        ):
            moves = fit.fit.view.transitions
            middle = [(minutes[move.start] + minutes[move.stop]) / 2 for move in moves]
            axes.plot(middle, fit.turn_residual / DEGREE, ls='none', ms=3.5, **look(k),
                      label=name)  # fmt: skip
        axes.set(yscale='log', xlabel='time [min]', ylabel='angle left [deg]')
        axes.set_xlim(0.0, 1.02 * minutes[-1])
        axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.yaxis.set_major_formatter('{x:g}')
        axes.yaxis.set_minor_formatter('')
        _name_imus(figure, axes, len(calibration.intrinsics))

    return draw(paint, 2.9 + 0.25 * _rows(len(calibration.intrinsics)))


def correlations(calibration: Calibration) -> bytes:
    """Draw the correlation of |w| with the first IMU about its peak, and the delays found."""
    found = [(k, one) for k, one in enumerate(calibration.alignments) if one is not None]
    imus = calibration.after.imus
    reach = max(_reach(one.correlation.lags, one.correlation.values) for _, one in found)

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, width_ratios=(1.5, 1.0))
        for row, (k, one) in enumerate(found):
            near = np.abs(one.correlation.lags - one.coarse) < reach
            left.plot(1e3 * one.correlation.lags[near], one.correlation.values[near], ms=2.5,
                      lw=0.9, **look(k))  # fmt: skip
            left.axvline(1e3 * one.coarse, color=look(k)['color'], lw=0.8, ls=(0, (4, 3)))
            delay = round(1e3 * (imus[k].time_offset - imus[0].time_offset), 3) + 0.0
            sigma = 1e3 * (imus[k].time_offset_sigma or 0.0)
            right.errorbar(delay, row, xerr=sigma, capsize=2, ms=4.5, **look(k))
            right.annotate(f'{delay:.3f} ± {sigma:.3f} ms', (delay, row), (0, 5), fontsize=9,
                           ha='center', textcoords='offset points')  # fmt: skip
        left.set(xlabel='delay [ms]', ylabel='correlation of |ω| [-]')
        right.set_yticks(range(len(found)), [imus[k].name for k, _ in found])
        right.set(xlabel='delay found [ms]', ylim=(len(found) - 0.5, -0.7))
        right.margins(x=0.7)

    return draw(paint, max(3.0, 1.2 + 0.36 * len(found)))


def _reach(lags: Scalars, values: Scalars) -> float:
    """Return three times how far from the peak the correlation has fallen visibly [s]."""
    peak = int(np.argmax(values))
    fallen = np.abs(lags[values < NEAR * values[peak]] - lags[peak])
    return float(max(3 * fallen.min(initial=np.ptp(lags)), LEAST_STEPS * (lags[1] - lags[0])))


def _rows(imus: int) -> int:
    return -(-imus // LEGEND_COLUMNS) if imus > 1 else 0


def _name_imus(figure: Figure, axes: Axes, imus: int) -> None:
    if imus > 1:
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc='outside upper center', markerscale=1.4,
                      ncols=min(imus, LEGEND_COLUMNS), handletextpad=0.2)  # fmt: skip
