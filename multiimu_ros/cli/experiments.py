"""`multiimu experiments`: the tables and figures of the sources, rerun beside what they print."""

from collections.abc import Sequence
from pathlib import Path
import time
from typing import Annotated, Any

from rich.console import Console
from rich.progress import Progress
import typer

from multiimu_ros.cli.options import AsJson, make_folder, OptionsFile, print_json, print_table
from multiimu_ros.errors import ConfigError
from multiimu_ros.experiments.registry import EXPERIMENTS
from multiimu_ros.report.experiment_page import in_words, Result, write_experiments

app = typer.Typer(add_completion=False)


@app.command(epilog='Example: `multiimu experiments count --seed 3 -o out/`')
def experiments(
    name: Annotated[
        str | None, typer.Argument(help=f'{", ".join(EXPERIMENTS)}; default: all of them.')
    ] = None,
    output: Annotated[
        Path, typer.Option('--output', '-o', help='Folder for experiments.html.')
    ] = Path('experiments'),
    seed: Annotated[int, typer.Option(help='All that is drawn follows from it.', min=0)] = 0,
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Rerun what the source documents measured, in simulation, and say what differs and why."""
    if name is not None and name not in EXPERIMENTS:
        msg = f'`name` must be one of {", ".join(EXPERIMENTS)}, got `{name}`; or leave it out.'
        raise ConfigError(msg)
    make_folder(output)  # which may fail, so before minutes of work
    begin = time.perf_counter()
    results = _run([name] if name else list(EXPERIMENTS), seed)
    page = output / 'experiments.html'
    write_experiments(page, results, time.perf_counter() - begin)
    if as_json:
        print_json({result.name: _as_json(result) for result in results})
        return
    for result in results:
        _print(result)
    typer.echo(f'Written to {page}')


def _run(names: Sequence[str], seed: int) -> list[Result]:
    console = Console(stderr=True)
    results = []
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        for name in names:
            task = bar.add_task(name, total=1.0)

            def tell(share: float, task: Any = task) -> None:
                bar.update(task, completed=share)

            results.append(EXPERIMENTS[name](seed, tell))
    return results


def _print(result: Result) -> None:
    typer.echo(f'\n{result.title} ({result.source})\n{result.answer}')
    for table in result.tables:
        rows = [{key: in_words(cell) for key, cell in row.items()} for row in table.rows]
        print_table(table.title, rows)
    for sentence in result.differs:
        typer.echo(f'* {sentence}')
    typer.echo(f'Repeat it: {result.command}')


def _as_json(result: Result) -> dict[str, Any]:
    return {
        'source': result.source,
        'question': result.question,
        'answer': result.answer,
        'setting': result.setting,
        'seed': result.seed,
        'tables': {table.title: [dict(row) for row in table.rows] for table in result.tables},
        'differs': list(result.differs),
        'command': result.command,
    }
