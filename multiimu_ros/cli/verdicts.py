"""How the preflight's verdicts look on a terminal."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from multiimu_ros.cli.preflight import NO, POOR, YES

STYLES = {YES: 'green', POOR: 'yellow', NO: 'bold red'}
NAMED = 4  # of the things to record instead; the rest follows when these are done


@contextmanager
def waiting(text: str) -> Iterator[None]:
    """Show on a terminal that something takes its time."""
    console = Console(stderr=True)
    if not console.is_terminal:
        yield
        return
    with console.status(Text(text)):
        yield


def shortened(names: Sequence[str], most: int = NAMED) -> list[str]:
    """Return the first names, and how many more there are."""
    more = len(names) - most
    return list(names) if more <= 1 else [*names[:most], f'and {more} more like these']


def print_verdicts(board: Mapping[str, Any]) -> None:
    """Print what the recording of one board suffices for, and what to record instead."""
    console = Console(soft_wrap=True, highlight=False)
    count = len(board['topics'])
    alike = min(board['correlations'].values(), default=1.0)
    others = f' and {count - 1} more that move alike (correlation {alike:.3g})' * (count > 1)
    table = Table(
        title=Text(f'What {board["topics"][0]}{others} suffices for'), title_justify='left'
    )
    for name in ('task', '', 'why'):
        table.add_column(name)
    for verdict in board['suffices']:
        answer = verdict['answer']
        table.add_row(verdict['task'], Text(answer, STYLES[answer]), Text(verdict['why']))
    console.print(table, soft_wrap=False)
    for verdict in board['suffices']:
        for text in shortened(verdict['instead']):
            console.print(Text.assemble((f'{verdict["task"]}: ', 'bold'), text))
