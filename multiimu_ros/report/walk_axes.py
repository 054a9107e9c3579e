"""What the figures of a walk have in common: thinned lines, shading, legends.

However long the recording, a line has at most two points of each of `BINS` bins: of the samples
of a bin the lowest and the highest of every column stay, so that no peak is lost.
"""

from matplotlib.axes import Axes
from matplotlib.figure import Figure
import numpy as np

from multiimu_ros.arrays import Matrix, NANOSECONDS, Scalars, Stamps
from multiimu_ros.odometry.attitude import OUTAGE
from multiimu_ros.report.figures import STILL
from multiimu_ros.report.walk import Walk
from multiimu_ros.report.walk_summary import still_runs

BINS = 1500  # more than the columns of pixels of a panel
SIGMAS = 2.0  # of bands and ellipses
DEGREES = 180 / np.pi
MARKS = 300  # stances beyond which the marks shrink


def thinned(values: Matrix, bins: int = BINS) -> Stamps:
    """Return the indices (M,) of at most `bins` bins' lowest and highest of each column.

    Parameters
    ----------
    values : (N, C) array
        What is drawn over one axis.
    """
    count = len(values)
    width = -(-count // bins)
    if width <= 2:
        return np.arange(count)
    padded = np.minimum(np.arange(-(-count // width) * width), count - 1)
    blocks = np.nan_to_num(values[padded]).reshape(-1, width, values.shape[1])
    first = width * np.arange(len(blocks))[:, np.newaxis]
    extremes = [first + blocks.argmin(axis=1), first + blocks.argmax(axis=1)]
    kept = np.concatenate([[0, count - 1], *(found.ravel() for found in extremes)])
    return np.unique(np.minimum(kept, count - 1))


def lines(walk: Walk, values: Matrix, bins: int = BINS) -> tuple[Scalars, Matrix]:
    """Return instants [s] and values, thinned, with a break wherever frames are missing."""
    kept = thinned(values, bins)
    after = np.flatnonzero(np.diff(walk.stamp_ns) > OUTAGE * NANOSECONDS) + 1
    kept = np.unique(np.concatenate([kept, after, after - 1]).astype(np.int64))
    breaks = np.searchsorted(kept, after)
    return (
        np.insert(walk.seconds[kept], breaks, np.nan),
        np.insert(values[kept], breaks, np.nan, axis=0),
    )


def shade(axes: Axes, walk: Walk, label: str = '') -> None:
    """Shade the spans in which the rig was still and which are wide enough to be seen."""
    seconds = walk.seconds
    begin, end = still_runs(walk.still)
    first, lasts = seconds[begin], seconds[end] - seconds[begin]
    seen = lasts > 2 * seconds[-1] / BINS
    if seen.any():
        spans = np.column_stack([first, lasts])[seen]
        axes.broken_barh(spans.tolist(), (0, 1), transform=axes.get_xaxis_transform(),
                         color=STILL, lw=0, zorder=0, label=label)  # fmt: skip


def legend(figure: Figure, axes: Axes, columns: int) -> None:
    """Put the legend of `axes` above the figure, if there is one."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc='outside upper right', ncols=columns,
                      handlelength=1.4, columnspacing=1.2)  # fmt: skip


def time_axis(axes: Axes, walk: Walk) -> None:
    """Name the axis of time, and let it end with the walk."""
    axes.set(xlabel='time [s]', xlim=(0, walk.seconds[-1]))


def mark_size(stances: int) -> float:
    """Return the size of a mark [pt], so that hundreds still are apart."""
    return 5.0 if stances < MARKS else 2.5
