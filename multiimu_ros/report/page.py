"""One HTML file with everything in it: text, tables, pictures; it needs no network."""

import base64
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
import os
from pathlib import Path
from string import Template

from multiimu_ros.errors import ConfigError
from multiimu_ros.report.scores import Row


def picture(title: str, caption: str, png: bytes) -> str:
    """Return a section with one figure; the caption may hold markup."""
    data = base64.b64encode(png).decode('ascii')
    image = f'<img alt="{escape(title)}" src="data:image/png;base64,{data}">'
    return f'<section><h2>{escape(title)}</h2><p class="soft">{caption}</p>{image}</section>'


def score_table(rows: Sequence[Row], imus: int, note: str) -> str:
    """Return a section with the scores, in the units of the quantities."""
    heads = ('rms error', 'best single IMU', 'plain mean', 'array', 'gain', f'ideal 1/√{imus}')
    lines = []
    for row in rows:
        scale = row.quantity.per_si
        cells = [f'{scale * value:.1f}' for value in (row.best, row.mean, row.fused, row.ideal)]
        lines.append(
            f'<tr><td>{escape(row.quantity.name)} '
            f'<small>[{escape(row.quantity.unit)}]</small></td>'
            f'<td>{cells[0]} <small>{escape(row.best_imu)}</small></td><td>{cells[1]}</td>'
            f'<td class="array">{cells[2]}</td><td>{row.gain:.2f} ×</td><td>{cells[3]}</td></tr>'
        )
    head = ''.join(f'<th>{text}</th>' for text in heads)
    table = f'<table><thead><tr>{head}</tr></thead><tbody>{"".join(lines)}</tbody></table>'
    return f'<section><div class="scroll">{table}</div><p class="soft">{note}</p></section>'


def facts(values: Mapping[str, str]) -> str:
    """Return a section of short figures with their names."""
    pairs = ''.join(
        f'<div><dt>{escape(name)}</dt><dd>{escape(value)}</dd></div>'
        for name, value in values.items()
    )
    return f'<section><dl>{pairs}</dl></section>'


def notes(title: str, lines: Sequence[str]) -> str:
    """Return a section with a list; the lines may hold markup."""
    items = ''.join(f'<li>{line}</li>' for line in lines)
    return f'<section><h2>{escape(title)}</h2><ul>{items}</ul></section>'


def write_page(
    path: str | os.PathLike[str], title: str, lead: str, sections: Sequence[str]
) -> None:
    """Write the page; `lead` and `sections` are HTML.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    template = Template(files(__package__).joinpath('page.html').read_text(encoding='utf-8'))
    page = template.substitute(title=escape(title), lead=lead, sections='\n'.join(sections))
    try:
        Path(path).write_text(page, encoding='utf-8')
    except OSError as error:
        msg = f'Cannot write the report `{path}`: {error.strerror}; choose a writable place.'
        raise ConfigError(msg) from error
