"""Figures of where a walk went: plan and height.

Where a smoothed walk is there, it is blue, and what the filter knew live is grey beneath it.
"""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse
from mpl_toolkits.axes_grid1.anchored_artists import (  # type: ignore[import-untyped]
    AnchoredSizeBar,
)
import numpy as np

from multiimu_ros.arrays import Scalars
from multiimu_ros.report.figures import draw, FUSED, OTHER, WIDTH
from multiimu_ros.report.noise_figures import COLOURS
from multiimu_ros.report.walk import Walk
from multiimu_ros.report.walk_axes import (
    BINS,
    DEGREES,
    legend,
    lines,
    mark_size,
    SIGMAS,
    time_axis,
)
from multiimu_ros.report.walk_summary import find_stances, position_sigma, still_runs

STANCE, UNSURE, TINT = '#D55E00', '#CC79A7', '#CC79A740'
ELLIPSES = 6


def plan(walk: Walk, *, foot: bool, live: Walk | None = None) -> bytes:
    """Draw the path from above, to one scale along both axes.

    Parameters
    ----------
    walk : Walk
        What is drawn in blue.
    foot : bool
        Whether to mark stances.
    live : Walk, optional
        What the filter knew live, if `walk` is smoothed.
    """
    low, high = _extent(walk, live)
    span = high - low
    height = float(np.clip(WIDTH * span[1] / span[0], 2.2, 6.5)) + 1.0

    def paint(figure: Figure) -> None:
        axes = figure.subplots()
        if live is not None:
            _, path = lines(live, live.position_n[:, :2], 4 * BINS)
            axes.plot(*path.T, color=OTHER, lw=0.9, label='as known live')
        _, path = lines(walk, walk.position_n[:, :2], 4 * BINS)
        axes.plot(*path.T, color=FUSED, lw=1.1, label='path' if live is None else 'smoothed')
        _mark_still(axes, walk, foot=foot)
        _ellipses(axes, walk)
        for index, marker, size, label in ((0, 'o', 12, 'start'), (-1, 's', 6, 'end')):
            axes.plot(*walk.position_n[index, :2], marker, color='black', mfc='none', mew=1.6,
                      ms=size, label=label, zorder=5)  # fmt: skip
        axes.set(xlabel='x [m]', ylabel='y [m]')
        axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
        axes.set_aspect('equal', adjustable='box')
        _scale_bar(axes, float(span.max()))
        legend(figure, axes, 3)

    return draw(paint, height)


def _extent(walk: Walk, live: Walk | None) -> tuple[Scalars, Scalars]:
    """Return two corners (2,) of the plan [m]: the paths, and what ellipses add within reason."""
    path = np.vstack([each.position_n[:, :2] for each in (walk, live) if each is not None])
    low, high = path.min(axis=0), path.max(axis=0)
    size = max(float((high - low).max()), 0.02)  # a rig that never moved still gets a picture
    room = min(SIGMAS * float(position_sigma(walk)[:, 0].max()), 0.3 * size) + 0.05 * size
    least = [0.6 * size, 0.35 * size]  # of a corridor
    room = room + np.maximum(least - (high - low), 0.0) / 2
    return low - room, high + room


def _mark_still(axes: Axes, walk: Walk, *, foot: bool) -> None:
    if foot:
        places, label = find_stances(walk).place, 'stance'
    else:
        places, label = walk.position_n[still_runs(walk.still)[1]], 'rest'
    if len(places):
        axes.plot(*places[:, :2].T, '.', color=STANCE, ms=mark_size(len(places)), label=label)


def _ellipses(axes: Axes, walk: Walk) -> None:
    """Draw the uncertainty of the position at a few instants, and at the end."""
    covariance = walk.position_covariance[:, :2, :2]
    for k in np.unique(np.linspace(0, len(walk) - 1, ELLIPSES + 1).astype(int))[1:]:
        values, vectors = np.linalg.eigh(covariance[k])
        axis = 2 * SIGMAS * np.sqrt(np.maximum(values, 0.0))
        angle = float(DEGREES * np.arctan2(vectors[1, 1], vectors[0, 1]))
        ellipse = Ellipse(tuple(walk.position_n[k, :2]), axis[1], axis[0], angle=angle,
                          fc=TINT, ec=UNSURE, lw=1.0, zorder=1)  # fmt: skip
        axes.add_artist(ellipse)
    axes.plot([], [], 'o', mfc=TINT, mec=UNSURE, ms=9, label='2σ')


def _scale_bar(axes: Axes, span: float) -> None:
    """Put a bar of a round length above the right corner."""
    decade = 10.0 ** np.floor(np.log10(span / 3))
    length = decade * max(factor for factor in (1, 2, 5) if factor * decade <= span / 3)
    name = f'{length:g} m' if length >= 1 else f'{100 * length:g} cm'
    bar = AnchoredSizeBar(axes.transData, length, name, 'lower right', pad=0.4, sep=4)
    bar.patch.set(ec='none', alpha=0.8)
    axes.add_artist(bar)


def height(walk: Walk, *, foot: bool, live: Walk | None = None) -> bytes:
    """Draw the height over time with its band, and how uncertain the position is."""

    def paint(figure: Figure) -> None:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(1.6, 1.0))
        sigma = position_sigma(walk)
        if live is not None:
            upper.plot(*lines(live, live.position_n[:, 2:]), color=OTHER, lw=0.9,
                       label='as known live')  # fmt: skip
        time, rows = lines(walk, np.column_stack([walk.position_n[:, 2], sigma[:, 1]]))
        reach = SIGMAS * rows[:, 1]
        upper.fill_between(time, rows[:, 0] - reach, rows[:, 0] + reach, color=FUSED, alpha=0.2,
                           lw=0, label='2σ')  # fmt: skip
        upper.plot(time, rows[:, 0], color=FUSED, lw=1.0,
                   label='height' if live is None else 'smoothed')  # fmt: skip
        _mark_heights(upper, walk, foot=foot)
        upper.set_ylabel('height z [m]')
        for column, colour, label in ((0, COLOURS[0], 'horizontal'), (1, COLOURS[1], 'height')):
            lower.plot(*lines(walk, SIGMAS * sigma[:, [column]]), color=colour, label=label)
        lower.set_ylabel('2σ [m]')
        lower.set_ylim(0, None)
        lower.legend(ncols=2, loc='upper left')
        time_axis(lower, walk)
        legend(figure, upper, 4)

    return draw(paint, 4.8)


def _mark_heights(axes: Axes, walk: Walk, *, foot: bool) -> None:
    at = find_stances(walk).end if foot else still_runs(walk.still)[1]
    if len(at):
        axes.plot(walk.seconds[at], walk.position_n[at, 2], '.', color=STANCE,
                  ms=mark_size(len(at)), label='stance' if foot else 'rest')  # fmt: skip
