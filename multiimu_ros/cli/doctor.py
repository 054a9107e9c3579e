"""`multiimu doctor`: why nothing arrives in a running graph, or what is wrong with what does."""

from collections.abc import Sequence
from importlib import import_module
import os
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.text import Text
import typer

from multiimu_ros.cli.graph_symptoms import domains_in_use, environment, judge
from multiimu_ros.cli.options import AsJson, OptionsFile, print_json, print_table
from multiimu_ros.cli.symptoms import ERROR, Figures, Finding, HINT, name_axis, WARNING
from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.heard import Graph
from multiimu_ros.rig import load_rig

STYLES = {ERROR: 'bold red', WARNING: 'yellow', HINT: 'cyan'}
NAMED = 8  # subjects of one finding; there are up to 16 IMUs with 3 topics each
UDP_TABLE = Path('/proc/net/udp')

app = typer.Typer(add_completion=False)


@app.command(epilog='Example: `multiimu doctor --rig ring8.yaml --seconds 5`')
def doctor(
    rig: Annotated[Path | None, typer.Option(help='Rig file of the board; judges more.')] = None,
    seconds: Annotated[float, typer.Option(min=0.5, max=60.0, help='How long to listen.')] = 3.0,
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Listen to the running graph and say what is wrong and what to do; 1 if anything fails."""
    board = None if rig is None else load_rig(rig)
    variables = environment(os.environ)
    graph = _listen(seconds)
    domains = domains_in_use(UDP_TABLE.read_text('ascii')) if UDP_TABLE.exists() else []
    figures, findings = judge(graph, board, variables, domains)
    if as_json:
        print_json(_report(graph, variables, figures, findings))
    else:
        _print(graph, variables, figures, findings)
    raise SystemExit(any(finding.level == ERROR for finding in findings))


def _listen(seconds: float) -> Graph:
    """Listen in a process that has ROS; a terminal shows that it takes its time."""
    try:
        listener: Any = import_module('multiimu_ros.nodes.doctor')
    except ModuleNotFoundError as error:
        msg = f'`doctor` must have ROS 2, but `{error.name}` is missing; source its setup file.'
        raise ConfigError(msg) from error
    console = Console(stderr=True)
    if not console.is_terminal:
        return listener.listen(seconds)  # type: ignore[no-any-return]
    with console.status(f'Listening for {seconds:g} s ...'):
        return listener.listen(seconds)  # type: ignore[no-any-return]


def _report(
    graph: Graph,
    variables: dict[str, str],
    figures: Sequence[Figures],
    findings: Sequence[Finding],
) -> dict[str, Any]:
    return {
        'environment': variables,
        'domain_id': graph.domain_id,
        'nodes': graph.nodes,
        'imus': [{key: value for key, value in f.items() if key != 'complaints'} for f in figures],
        'odometries': graph.odometries,
        'findings': [finding._asdict() for finding in findings],
        'healthy': not any(finding.level == ERROR for finding in findings),
    }


def _print(
    graph: Graph,
    variables: dict[str, str],
    figures: Sequence[Figures],
    findings: Sequence[Finding],
) -> None:
    console = Console(soft_wrap=True, highlight=False)
    console.print(' '.join(f'{name}={value}' for name, value in variables.items() if value))
    nodes = ', '.join(graph.nodes) or 'none'
    console.print(Text(f'Nodes in domain {graph.domain_id}: {nodes}'))
    if figures:
        print_table('IMUs', [_row(figure) for figure in figures])
    for topic, count in graph.odometries.items():
        console.print(Text(f'{topic}: {count} messages'))
    for level, subject, text in findings:
        named = _shortened(subject)
        console.print(Text.assemble((f'{level}: ', STYLES[level]), (named, 'bold'), f': {text}'))
    counts = [(level, sum(f.level == level for f in findings)) for level in STYLES]
    summary = ', '.join(f'{count} {level}{"s" * (count != 1)}' for level, count in counts if count)
    console.print(summary or 'Nothing is wrong.')


def _shortened(subjects: str) -> str:
    names = subjects.split(', ')
    more = len(names) - NAMED
    return subjects if more <= 0 else f'{", ".join(names[:NAMED])} and {more} more'


def _row(figures: Figures) -> dict[str, Any]:
    up = figures['up']
    return {
        'topic': figures['topic'],
        'subs': figures['subscribers'],
        'Hz': figures['rate_hz'],
        'age [ms]': 1e3 * figures['age_s'],
        'rad/s': round(figures['median_rate'], 4),
        'm/s^2': figures['median_force'],
        'at rest': 'moving' if up is None else name_axis(up),
    }
