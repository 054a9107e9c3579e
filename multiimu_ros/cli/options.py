"""What the verbs share: options from a file, a progress bar, a table or JSON at the end."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
import json
from pathlib import Path
import sys
import time
from typing import Annotated, TypeVar

from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from rich.text import Text
import typer
import yaml

from multiimu_ros.errors import ConfigError

T = TypeVar('T')
Cell = str | int | float

SILENT_S = 1.0  # what takes no longer needs no progress bar


def _from_file(ctx: typer.Context, path: Path | None) -> None:
    """Make the file's entries the defaults of the command line, which may override them."""
    if path is None:
        return
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = ' '.join(str(error).split())
        msg = f'`--options` must name a YAML file, got `{path}`: {reason}.'
        raise ConfigError(msg) from error
    names = [str(parameter.name) for parameter in ctx.command.params]
    given = content if isinstance(content, Mapping) else {str(content): None}
    unknown = [key for key in given if str(key).replace('-', '_') not in names]
    if unknown:
        known = ', '.join(sorted(name.replace('_', '-') for name in names if name != 'options'))
        msg = f'{path}: `{unknown[0]}` must be one of {known}; correct the key.'
        raise ConfigError(msg)
    ctx.default_map = {str(key).replace('-', '_'): value for key, value in given.items()}


OptionsFile = Annotated[
    Path | None,
    typer.Option(
        '--options',
        callback=_from_file,
        is_eager=True,
        help='YAML file with any of these options.',
    ),
]
AsJson = Annotated[bool, typer.Option('--json', help='Print the result as JSON.')]


def split_names(texts: Sequence[str]) -> list[str]:
    """Return the names in `texts`, each of which may hold several with commas between."""
    return [name.strip() for text in texts for name in text.split(',') if name.strip()]


def with_progress(items: Iterable[T], total: int, what: str, stride: int = 1) -> Iterator[T]:
    """Yield the items; after a second, show on a terminal's stderr how many are done.

    The clock is looked at every `stride` items: often for slow ones, rarely for quick ones.
    """
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as progress:
        task = progress.add_task(what, total=total, visible=False)
        begin = time.monotonic()
        for count, item in enumerate(items):
            if count % stride == 0:
                late = time.monotonic() - begin > SILENT_S
                progress.update(task, completed=count, visible=late)
            yield item


def make_folder(folder: Path) -> None:
    """Make a folder for a report, where there is none.

    Raises
    ------
    ConfigError
        If that is not possible.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f'Cannot make the folder `{folder}`: {error.strerror}; choose a writable place.'
        raise ConfigError(msg) from error


def print_table(title: str, rows: Sequence[Mapping[str, Cell]]) -> None:
    """Print rows of equal keys as a table, without columns that are empty in all of them."""
    table = Table(title=Text(title), title_justify='left')
    told = [name for name in (rows[0] if rows else ()) if any(row[name] != '' for row in rows)]
    for name in told:
        table.add_column(Text(name), justify='left' if isinstance(rows[0][name], str) else 'right')
    for row in rows:
        cells = (f'{x:.4g}' if isinstance(x, float) else str(x) for x in map(row.get, told))
        table.add_row(*map(Text, cells))
    Console().print(table)


def print_json(result: object) -> None:
    """Print a result for machines; NaN, which JSON does not know, becomes null."""
    text = json.dumps(_finite(result), indent=2, allow_nan=False)
    sys.stdout.write(f'{text}\n')


def _finite(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not abs(value) < float('inf'):
        return None
    return value
