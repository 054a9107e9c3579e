"""The figures of the experiments: what is drawn, as data, and one function that draws it.

An experiment says what its figure shows and knows nothing of how; matplotlib stays here.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator
import numpy as np

from multiimu_ros.arrays import Scalars
from multiimu_ros.report.figures import draw, FUSED, IMU_COLOURS, MEAN, OTHER, SINGLE

COLOURS = {'array': FUSED, 'single': SINGLE, 'mean': MEAN, 'other': OTHER, 'ideal': 'black'}
DASHES = (0, (4, 3))
PANEL_HEIGHT = 3.6  # [in]


@dataclass(frozen=True, kw_only=True)
class Line:
    """One curve.

    Parameters
    ----------
    label : str
        For the legend; empty for none.
    x, y : (N,) arrays
        In the units of the panel's labels; NaN leaves a gap.
    role : str
        A key of `COLOURS`; by default the curves of a panel get colours in turn.
    dashed, dots, joined : bool
        Broken line; a dot at every point; a line between the points.
    """

    label: str
    x: Scalars
    y: Scalars
    role: str = ''
    dashed: bool = False
    dots: bool = False
    joined: bool = True


@dataclass(frozen=True, kw_only=True)
class Panel:
    """Curves on common axes.

    Parameters
    ----------
    title, x_label, y_label : str
        With units.
    lines : tuple of Line
        In drawing order.
    names : mapping of str to (x, y)
        Points with their names beside them.
    log_x, log_y : bool
        Logarithmic axes.
    y_limits : (low, high), optional
        Where a curve that runs away would hide the others.
    x_ticks : tuple of float
        Ticks to show, instead of matplotlib's.
    x_names : tuple of str
        What 0, 1, 2 ... on the x axis are, where they are no numbers.
    equal : bool
        A unit is as long on one axis as on the other, as on a map.
    """

    title: str
    x_label: str
    y_label: str
    lines: tuple[Line, ...] = ()
    names: Mapping[str, tuple[float, float]] | None = None
    log_x: bool = False
    log_y: bool = False
    y_limits: tuple[float, float] | None = None
    x_ticks: tuple[float, ...] = ()
    x_names: tuple[str, ...] = ()
    equal: bool = False


@dataclass(frozen=True, kw_only=True)
class Boxes:
    """Boxes from quartile to quartile with their medians, one for each set of values.

    Parameters
    ----------
    title, y_label : str
        With units.
    values : mapping of str to (N,) array
        The sets, in order; equal roles in equal colours.
    roles : tuple of str
        A key of `COLOURS` for each.
    marks : mapping of str to float
        Where the paper's own value is, for those sets that have one.
    """

    title: str
    y_label: str
    values: Mapping[str, Scalars]
    roles: tuple[str, ...]
    marks: Mapping[str, float] | None = None
    log_y: bool = False


@dataclass(frozen=True, kw_only=True)
class Picture:
    """One figure of a page: its panels stand side by side, `columns` to a row."""

    title: str
    caption: str
    panels: tuple[Panel | Boxes, ...]
    columns: int = 2
    same_y: bool = False


def draw_picture(picture: Picture) -> bytes:
    """Return the picture as PNG."""
    columns = min(picture.columns, len(picture.panels))
    rows = -(-len(picture.panels) // columns)

    def paint(figure: Figure) -> None:
        grid = figure.subplots(rows, columns, squeeze=False, sharey=picture.same_y).flat
        for axes, panel in zip(grid, picture.panels, strict=False):
            if isinstance(panel, Panel):
                _paint_lines(axes, panel)
            else:
                _paint_boxes(axes, panel)
        for axes in list(grid)[len(picture.panels) :]:
            axes.axis('off')

    return draw(paint, PANEL_HEIGHT * rows)


def _paint_lines(axes: Axes, panel: Panel) -> None:
    turn = iter(np.resize(np.array(IMU_COLOURS), len(panel.lines)).tolist())
    for line in panel.lines:
        colour = COLOURS[line.role] if line.role else next(turn)
        axes.plot(line.x, line.y, color=colour, ls=_dashes(line),
                  marker='o' if line.dots else '', ms=4, label=line.label or None)  # fmt: skip
    for name, (x, y) in (panel.names or {}).items():
        axes.plot([x], [y], 'o', color=COLOURS['array'], ms=5)
        axes.annotate(name, (x, y), (3, 4), textcoords='offset points', fontsize=8, rotation=40)
    axes.set(xlabel=panel.x_label, ylabel=panel.y_label)
    axes.set_title(panel.title)
    if panel.names:
        axes.margins(0.12, 0.25)  # room for the names
    _scale(axes, log_x=panel.log_x, log_y=panel.log_y)
    if panel.equal:
        axes.set_aspect('equal', 'datalim')
    if panel.y_limits is not None:
        axes.set_ylim(panel.y_limits)
    if panel.x_ticks:
        axes.set_xticks(panel.x_ticks, [f'{tick:g}' for tick in panel.x_ticks])
        axes.xaxis.set_minor_formatter('')
    if panel.x_names:
        _name_ticks(axes, range(len(panel.x_names)), panel.x_names)
    if any(line.label for line in panel.lines):
        axes.legend(fontsize=8, handlelength=1.6)


def _dashes(line: Line) -> Any:
    if not line.joined:
        return ''
    return DASHES if line.dashed else '-'


def _name_ticks(axes: Axes, places: Sequence[int], names: Sequence[str]) -> None:
    axes.set_xticks(places, names, fontsize=8, rotation=35, ha='right', rotation_mode='anchor')


def _paint_boxes(axes: Axes, panel: Boxes) -> None:
    black: dict[str, Any] = {'color': 'black', 'lw': 1.0}
    drawn = axes.boxplot(list(panel.values.values()), patch_artist=True, widths=0.6,
                         medianprops=black, flierprops={'ms': 2.5, 'mec': '#888888'})  # fmt: skip
    for box, role in zip(drawn['boxes'], panel.roles, strict=True):
        box.set(facecolor=COLOURS[role], lw=0.8)
    for place, name in enumerate(panel.values, start=1):
        if name in (panel.marks or {}):
            axes.plot([place], [(panel.marks or {})[name]], 'D', color='black', ms=5)
    if panel.marks:
        axes.plot([], [], 'D', color='black', ms=5, label='in the paper')
        axes.legend(fontsize=9)
    _name_ticks(axes, range(1, len(panel.values) + 1), list(panel.values))
    axes.set_title(panel.title)
    axes.set_ylabel(panel.y_label)
    _scale(axes, log_x=False, log_y=panel.log_y)


def _scale(axes: Axes, *, log_x: bool, log_y: bool) -> None:
    """Write 0.1, 1, 10 on logarithmic axes, and where they are short 0.2 and 0.5 too."""
    for wanted, axis, set_scale, limits in (
        (log_x, axes.xaxis, axes.set_xscale, axes.get_xlim),
        (log_y, axes.yaxis, axes.set_yscale, axes.get_ylim),
    ):
        if wanted:
            set_scale('log')
            low, high = limits()
            subs = (1.0, 2.0, 5.0) if high < 100 * low else (1.0,)
            axis.set_major_locator(LogLocator(subs=subs))
            axis.set_major_formatter('{x:g}')
            axis.set_minor_formatter('')
