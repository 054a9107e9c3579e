"""What an experiment found, and the page that shows several: paper and rerun side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
import math
import os

from multiimu_ros.report.experiment_figures import draw_picture, Picture
from multiimu_ros.report.page import notes, picture, write_page

Cell = str | float
UNKNOWN = '–'


@dataclass(frozen=True, kw_only=True)
class Table:
    """Rows of equal keys; NaN where the source, or the experiment, has no number."""

    title: str
    rows: tuple[Mapping[str, Cell], ...]


@dataclass(frozen=True, kw_only=True)
class Result:
    """What one experiment found.

    Parameters
    ----------
    name, title : str
        How it is called on the command line, and on the page.
    source : str
        Table, figure or section of the source document.
    question, answer : str
        One sentence each; the answer is made of the numbers found.
    setting : str
        What was simulated, in one paragraph.
    seed : int
        All that was drawn follows from it.
    tables : tuple of Table
        `paper` and `ours` side by side.
    pictures : tuple of Picture
        What the figures show.
    differs : tuple of str
        What differs from the source, and why; a sentence each.
    """

    name: str
    title: str
    source: str
    question: str
    answer: str
    setting: str
    seed: int
    tables: tuple[Table, ...]
    pictures: tuple[Picture, ...]
    differs: tuple[str, ...]

    @property
    def command(self) -> str:
        """What repeats it."""
        return f'multiimu experiments {self.name} --seed {self.seed}'


def in_words(cell: Cell) -> str:
    """Return a cell as it is shown: three digits, and a dash for what is not known."""
    if isinstance(cell, str):
        return cell
    if math.isnan(cell):
        return UNKNOWN
    return f'{cell:.0f}' if 1e3 <= abs(cell) < 1e5 else f'{cell:.3g}'


def write_experiments(
    path: str | os.PathLike[str], results: Sequence[Result], seconds: float
) -> None:
    """Draw all pictures and write the page.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    lead = (
        'The tables and figures of the documents that this package builds on, rerun in '
        'simulation, with the printed numbers beside ours. All of it took '
        f'{seconds:.0f} s and repeats exactly from its seeds, but for the times of a step, '
        'which are those of the machine.'
    )
    sections = [_contents(results)]
    for result in results:
        sections += _sections(result)
    write_page(path, 'The experiments of the sources, repeated', lead, sections)


def _contents(results: Sequence[Result]) -> str:
    items = ''.join(
        f'<li><a href="#{escape(r.name)}">{escape(r.title)}</a>: {escape(r.answer)}</li>'
        for r in results
    )
    return f'<section><h2>In short</h2><ul>{items}</ul></section>'


def _sections(result: Result) -> list[str]:
    tables = ''.join(_table(table) for table in result.tables)
    head = (
        f'<section id="{escape(result.name)}"><h2>{escape(result.title)}</h2>'
        f'<p class="soft">{escape(result.source)}</p><p><b>{escape(result.question)}</b></p>'
        f'<p>{escape(result.answer)}</p><p class="soft">{escape(result.setting)}</p>{tables}'
        f'<p class="soft">Repeat it: <code>{escape(result.command)}</code></p></section>'
    )
    pictures = [picture(p.title, escape(p.caption), draw_picture(p)) for p in result.pictures]
    return [head, *pictures, notes('What differs, and why', [escape(s) for s in result.differs])]


def _table(table: Table) -> str:
    head = ''.join(f'<th>{escape(key)}</th>' for key in table.rows[0])
    body = ''.join(_row(row) for row in table.rows)
    return (
        f'<p><b>{escape(table.title)}</b></p><div class="scroll"><table>'
        f'<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
    )


def _row(row: Mapping[str, Cell]) -> str:
    """Return a row; our own numbers stand out, whether a column or the whole row is ours."""
    cells = []
    for key, cell in row.items():
        ours = 'ours' in key or ('ours' in str(row.get('whose', '')) and not isinstance(cell, str))
        kind = ' class="array"' if ours else ''
        cells.append(f'<td{kind}>{escape(in_words(cell))}</td>')
    return f'<tr>{"".join(cells)}</tr>'
