"""The figures of a report, each a PNG that reads on a phone: one idea, few lines, units on axes.

Colours are those of Okabe and Ito, which colour-blind readers tell apart: what the array says is
always blue, the best single IMU orange, the truth and the ideal black, the other IMUs grey.
"""

from collections.abc import Callable, Mapping, Sequence
import io
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator
import numpy as np
from scipy.signal import welch

from multiimu_ros.arrays import Flags, NANOSECONDS, Scalars, Stamps, Vectors
from multiimu_ros.report.scores import aligned_position, Errors, Row
from multiimu_ros.report.tracks import Track
from multiimu_ros.report.truth import Truth

FUSED, SINGLE, MEAN, OTHER, STILL = '#0072B2', '#E69F00', '#009E73', '#B5B5B5', '#EDF1F5'
IMU_COLOURS = ('#0072B2', '#E69F00', '#009E73', '#CC79A7', '#56B4E9', '#D55E00', '#8A7F00', '#444')
WIDTH = 7.0  # [in] one column of the page
STYLE: dict[Any, Any] = {
    'figure.dpi': 150.0,
    'font.size': 11.0,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'axes.grid': True,
    'grid.color': '#DDDDDD',
    'grid.linewidth': 0.6,
    'axes.axisbelow': True,
    'axes.titlesize': 11.0,
    'axes.titlelocation': 'left',
    'axes.titleweight': 'bold',
    'lines.linewidth': 1.2,
    'legend.frameon': False,
    'legend.fontsize': 10.0,
}
XYZ = 'xyz'
MILLIDEGREE = 1e3 * 180 / np.pi


def draw(painter: Callable[[Figure], None], height: float) -> bytes:
    """Return as PNG what `painter` puts on an empty figure of that height [in]."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(WIDTH, height), layout='constrained')
        painter(figure)
        png = io.BytesIO()
        figure.savefig(png, format='png')
    return png.getvalue()


def _seconds(stamp_ns: Stamps, start_ns: int) -> Scalars:
    return np.asarray((stamp_ns - start_ns) / NANOSECONDS)


def _shade(axes: Axes, time: Scalars, still: Flags, label: str = '') -> None:
    """Shade the spans in which the rig was found still."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(time[begin], time[end - 1], color=STILL, zorder=0, lw=0, label=label)
        label = ''


def _legend_above(axes: Axes, columns: int) -> None:
    axes.legend(loc='lower right', bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.1,
                handlelength=1.4, columnspacing=1.2)  # fmt: skip


def scoreboard(rows: Sequence[Row], singles: Mapping[str, Errors]) -> bytes:
    """Draw every IMU alone, the plain mean, the array and the ideal, one panel per quantity."""

    def paint(figure: Figure) -> None:
        for axes, row in zip(figure.subplots(2, 2).flat, rows, strict=True):
            scale = row.quantity.per_si
            each = [scale * row.quantity.rms(errors) for errors in singles.values()]
            axes.bar(range(len(each)), each, color=OTHER, width=0.75)
            best = list(singles).index(row.best_imu)
            axes.bar([best], [each[best]], color=SINGLE, width=0.75)
            axes.bar([len(each) + 0.5], [scale * row.mean], color=MEAN, width=0.9)
            axes.bar([len(each) + 1.6], [scale * row.fused], color=FUSED, width=0.9)
            axes.axhline(scale * row.ideal, color='black', lw=1.0, ls=(0, (4, 3)))
            axes.set_title(f'{row.quantity.name} [{row.quantity.unit}]')
            ticks = [*range(len(each)), len(each) + 0.5, len(each) + 1.6]
            axes.set_xticks(ticks, [*map(str, range(len(each))), 'mean', 'array'], fontsize=9)
            axes.set_xlim(-0.6, len(each) + 2.4)
            axes.tick_params(axis='x', length=0)
            for label in axes.get_xticklabels()[-2:]:
                label.set(rotation=35, fontweight='bold', ha='right', rotation_mode='anchor')
            axes.grid(visible=False, axis='x')
        handles = [
            Patch(color=OTHER, label='one IMU alone'),
            Patch(color=SINGLE, label='best of them'),
            Patch(color=MEAN, label='plain mean'),
            Patch(color=FUSED, label='array'),
            Line2D([], [], color='black', lw=1.0, ls=(0, (4, 3)), label='ideal'),
        ]
        figure.legend(handles=handles, loc='outside upper center', ncols=5, handlelength=1.2,
                      columnspacing=1.0)  # fmt: skip

    return draw(paint, 5.6)


def rate_and_force_errors(
    single: Errors, fused: Errors, still: Flags, window: tuple[float, float]
) -> bytes:
    """Draw x-axis errors of rate and force over a window [s] after the start."""

    def paint(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for axes, key, scale, label in (
            (upper, 'angular_rate', MILLIDEGREE, 'rate error x [mdeg/s]'),
            (lower, 'specific_force', 1e3, 'force error x [mm/s²]'),
        ):
            time = _seconds(fused.stamp_ns, fused.stamp_ns[0])
            _shade(axes, time, still)
            own = _seconds(single.stamp_ns, fused.stamp_ns[0])
            axes.plot(own, scale * getattr(single, key)[:, 0], color=SINGLE, lw=0.7,
                      label='best single IMU')  # fmt: skip
            axes.plot(time, scale * getattr(fused, key)[:, 0], color=FUSED, lw=0.9, label='array')
            axes.set_ylabel(label)
            axes.set_xlim(window)
        _legend_above(upper, 2)
        lower.set_xlabel('time [s]')

    return draw(paint, 4.6)


def spectra(single: Errors, fused: Errors, rate_hz: float, ideal: tuple[float, float]) -> bytes:
    """Draw the amplitude spectra of the errors; `ideal` are densities [rad/s/√Hz], [m/s²/√Hz]."""

    def paint(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        for axes, key, scale, density, title in (
            (left, 'angular_rate', MILLIDEGREE, ideal[0], 'rate error [mdeg/s/√Hz]'),
            (right, 'specific_force', 1e3, ideal[1], 'force error [mm/s²/√Hz]'),
        ):
            for errors, colour, label in (
                (single, SINGLE, 'best single IMU'), (fused, FUSED, 'array'),
            ):  # fmt: skip
                frequency, amplitude = _amplitude(getattr(errors, key), rate_hz)
                axes.loglog(frequency, scale * amplitude, color=colour, label=label)
            axes.axhline(scale * density, color='black', lw=1.0, ls=(0, (4, 3)), label='ideal')
            axes.set_title(title)
            axes.set_xlabel('frequency [Hz]')
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter('{x:g}')
                axis.set_minor_formatter('')
            axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        figure.legend(*left.get_legend_handles_labels(), loc='outside upper center', ncols=3)

    return draw(paint, 3.7)


def _amplitude(error: Vectors, rate_hz: float) -> tuple[Scalars, Scalars]:
    """Return frequencies [Hz] and the noise density there, rms of three axes.

    As in the rig file, white noise of density N has a variance of N^2 times the rate: half the
    one-sided power density.
    """
    length = min(len(error), round(8 * rate_hz))
    frequency, power = welch(error, rate_hz, nperseg=length, axis=0)
    # Twenty points a decade: the eye needs no more, and the noise of the estimate averages out.
    bins = np.unique(np.round(20 * np.log10(frequency[1:])), return_inverse=True)[1]
    count = np.bincount(bins)
    mean_power = np.bincount(bins, power[1:].mean(axis=1)) / count
    return np.bincount(bins, frequency[1:]) / count, np.sqrt(mean_power / 2)


def attitude(single: Errors, fused: Errors, track: Track) -> bytes:
    """Draw the attitude errors about the fixed axes with the array's own 3-sigma band."""

    def paint(figure: Figure) -> None:
        time = _seconds(fused.stamp_ns, fused.stamp_ns[0])
        panels = figure.subplots(3, 1, sharex=True)
        for axis, (axes, name) in enumerate(
            zip(panels, ('about x (east)', 'about y (north)', 'about z (yaw)'), strict=True)
        ):
            band = 3 * MILLIDEGREE * track.attitude_sigma_n[:, axis]
            _shade(axes, time, track.still)
            axes.fill_between(
                time, -band, band, color=FUSED, alpha=0.15, lw=0, label='3σ of array'
            )
            own = _seconds(single.stamp_ns, fused.stamp_ns[0])
            axes.plot(own, MILLIDEGREE * single.attitude_n[:, axis], color=SINGLE,
                      label='best single IMU')  # fmt: skip
            axes.plot(time, MILLIDEGREE * fused.attitude_n[:, axis], color=FUSED, label='array')
            axes.set_ylabel(f'{name}\n[mdeg]')
        _legend_above(panels[0], 3)
        panels[-1].set_xlabel('time [s]')

    return draw(paint, 6.0)


def trajectory(track: Track, truth: Truth) -> bytes:
    """Draw the path from above and its height, with the instants found still marked."""

    def paint(figure: Figure) -> None:
        plan, height = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
        here = aligned_position(track, truth)
        time = _seconds(track.stamp_ns, track.stamp_ns[0])
        still = track.still
        for axes, (x, true_x), (y, true_y) in (
            (plan, (here[:, 0], truth.position_n[:, 0]), (here[:, 1], truth.position_n[:, 1])),
            (height, (time, time), (here[:, 2], truth.position_n[:, 2])),
        ):
            axes.plot(true_x, true_y, color='black', lw=2.2, alpha=0.35, label='truth')
            axes.plot(x, y, color=FUSED, lw=1.0, label='odometry')
            axes.plot(x[still], y[still], '.', color='#D55E00', ms=3.5, label='found still')
        plan.set_aspect('equal', adjustable='datalim')
        plan.set(title='from above', xlabel='x [m]', ylabel='y [m]')
        height.set(title='height', xlabel='time [s]', ylabel='z [m]')
        figure.legend(*plan.get_legend_handles_labels(), loc='outside upper center', ncols=3,
                      markerscale=2.0)  # fmt: skip

    return draw(paint, 4.0)


def position_error(tracks: Mapping[str, Errors], best: str) -> bytes:
    """Draw the distance to the truth over time: array, plain mean, single IMUs."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        start = tracks['array'].stamp_ns[0]
        looks = {'mean': (MEAN, 'plain mean'), 'array': (FUSED, 'array')}
        looks[best] = (SINGLE, 'best single IMU')
        order = [name for name in tracks if name not in looks]
        for name in [*order, best, 'mean', 'array']:
            colour, label = looks.get(name, (OTHER, 'other IMUs' if name == order[0] else None))
            distance = 1e3 * np.linalg.norm(tracks[name].position_n, axis=1)
            time = _seconds(tracks[name].stamp_ns, start)
            axes.plot(time, distance, color=colour, label=label, lw=0.8 if label is None else 1.3)
        axes.set(xlabel='time [s]', ylabel='position error [mm]', ylim=(0, None))
        _legend_above(axes, 4)

    return draw(paint, 3.2)


def weights(track: Track, names: Sequence[str]) -> bytes:
    """Draw the share of each IMU in the fused rate."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        time = _seconds(track.stamp_ns, track.stamp_ns[0])
        bottom = np.zeros(len(time))
        for k, name in enumerate(names):
            top = bottom + 100 * track.weights[:, k]
            colour = IMU_COLOURS[k % len(IMU_COLOURS)]
            axes.fill_between(time, bottom, top, color=colour, alpha=0.75, lw=0.4, label=name)
            bottom = top
        axes.set(xlabel='time [s]', ylabel='share [%]', ylim=(0, 100), xlim=(time[0], time[-1]))
        figure.legend(loc='outside right center', reverse=True, handlelength=1.0)

    return draw(paint, 2.8)


def latency(ages: Scalars, quantiles: Mapping[str, float]) -> bytes:
    """Draw how old (N,) the fused messages were when another process got them [s]."""

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        shown = 1e3 * ages[ages > 0]
        low, high = float(shown.min()), max(float(np.quantile(shown, 0.999)), 2 * shown.min())
        axes.hist(shown, bins=np.geomspace(low, high, 80).tolist(), color=FUSED)
        axes.set_xscale('log')
        for height, (label, value) in zip((0.93, 0.8), quantiles.items(), strict=False):
            axes.axvline(1e3 * value, color='black', lw=1.0)
            left = 1e3 * value < np.sqrt(low * high)
            axes.annotate(
                f'{label}: {1e3 * value:.1f} ms',
                (1e3 * value, height),
                (4 if left else -4, 0),
                ha='left' if left else 'right',
                xycoords=('data', 'axes fraction'),
                textcoords='offset points',
            )
        for write in (axes.xaxis.set_major_formatter, axes.xaxis.set_minor_formatter):
            write('{x:g}')
        axes.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
        axes.set(xlabel='age of imu/data when another process got it [ms]', ylabel='messages')

    return draw(paint, 2.8)
