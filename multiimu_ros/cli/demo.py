"""`multiimu demo`: eight emulated IMUs become one, live over ROS 2, and what that gains."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, ExitStack, nullcontext
from pathlib import Path
import shutil
import tempfile
import time
from typing import Annotated, Any, cast

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table
from rich.text import Text
import typer

from multiimu_ros.cli.demo_live import (
    carry,
    compile_filters,
    domain_id,
    Glance,
    IMUS,
    live,
    LiveRun,
    NODES,
    RATE,
)
from multiimu_ros.cli.demo_report import Outcome, write_report
from multiimu_ros.cli.options import AsJson, print_json
from multiimu_ros.pipeline_config import ProfileName
from multiimu_ros.report.comparison import ARRAY, rerun, score
from multiimu_ros.report.recorded import read_run
from multiimu_ros.report.scores import as_json, not_won, Row
from multiimu_ros.report.truth import as_truth
from multiimu_ros.rig import load_rig
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.simulation.truth import load_truth

PROFILES = {'foot': 'foot'}  # the other motions are a hand's or gentler
BARS = ' ▁▂▃▄▅▆▇█'
LINE_EVERY = 5.0  # [s] where the output is no terminal
SHORTEST = 12.0  # [s] 4 of rest, 2 of settling, and some motion

app = typer.Typer(add_completion=False)


@app.command(epilog='Example: `multiimu demo --motion foot --duration 60 -o walk --keep`')
def demo(
    duration: Annotated[float, typer.Option(min=SHORTEST, help='Of the motion [s].')] = 45.0,
    motion: Annotated[str, typer.Option(help='hand, foot, turntable, slider or static.')] = 'hand',
    output: Annotated[Path, typer.Option('--output', '-o', help='Folder for the report.')] = Path(
        'multiimu_demo'
    ),
    keep: Annotated[
        bool, typer.Option('--keep', help='Keep bag, rig file, truth and logs there, too.')
    ] = False,
    seed: Annotated[int, typer.Option(help='Draws the IMUs, their noise and the motion.')] = 1,
    as_machine: AsJson = False,
) -> None:
    """Carry an emulated board of 8 IMUs about, fuse it live, and hold the result against truth.

    Exit code 0 means that the array beat its best single IMU in rate, force and attitude.
    """
    console = Console(stderr=as_machine)
    trajectory(motion, duration, seed)  # refuses what it does not know before anything starts
    output.mkdir(parents=True, exist_ok=True)
    with _folder(output, keep) as folder:
        run = LiveRun(
            folder=folder,
            motion=motion,
            duration=duration,
            profile=PROFILES.get(motion, 'hand'),
            seed=seed,
        )
        try:
            last = _run_live(run, console)
        except KeyboardInterrupt:
            console.print('Interrupted: all processes have ended, nothing is kept.')
            raise SystemExit(130) from None
        outcome = _evaluate(run, last, console)
        report = output / 'report.html'
        write_report(report, outcome)
    _tell(outcome, report, console, as_machine)
    raise SystemExit(1 if not_won(outcome.comparison.rows) else 0)


@contextmanager
def _folder(output: Path, keep: bool) -> Iterator[Path]:
    """Yield where the run's files go: a fresh folder beside the report, or one that vanishes."""
    if keep:
        folder = output / 'run'
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        yield folder.resolve()
        return
    with tempfile.TemporaryDirectory(prefix='multiimu_demo_') as name:
        yield Path(name)


def _run_live(run: LiveRun, console: Console) -> dict[str, Any]:
    """Run the graph for the length of the motion; return the monitor's last figures."""
    console.print(
        f'[bold]{IMUS} emulated BMI160[/] in a ring of 16 cm, {RATE} Hz each, '
        f'{run.duration:g} s of the motion [bold]{run.motion}[/]'
    )
    with console.status('compiling the filters, once on this machine'):
        compile_filters()
    begin = time.monotonic()
    with ExitStack() as stack:
        with console.status('starting the board and the nodes'):
            children = stack.enter_context(live(run))
        _done(
            console,
            f'{", ".join(NODES)}: a process each, ready after {time.monotonic() - begin:.1f} s '
            f'(ROS_DOMAIN_ID {domain_id()}, loopback only)',
        )
        glance = _watch(carry(run, children), run.duration, console)
    received = glance.figures.get('received', 0)
    _done(console, f'{received} fused messages reached another process; all processes have ended')
    return glance.figures


def _done(console: Console, text: str) -> None:
    console.print(f'[green]✓[/] {text}', highlight=False)


def _watch(glances: Iterator[Glance], duration: float, console: Console) -> Glance:
    """Show every glance on one line; on what is no terminal, a line now and then."""
    glance, told = Glance(0.0, {}), 0.0
    status = console.status('') if console.is_terminal else nullcontext()
    with status as line:
        for glance in glances:
            if line is not None:
                line.update(_line(glance, duration))
            elif glance.elapsed - told >= LINE_EVERY:
                told = glance.elapsed
                console.print(_line(glance, duration))
    return glance


def _line(glance: Glance, duration: float) -> Text:
    """Return the live line: time, rate, stillness, weights, latency."""
    figures = glance.figures
    imus = figures.get('figures', {})
    weights = [float(imus.get(f'fusion: imu{k}', {}).get('weight', 0.0)) for k in range(IMUS)]
    bars = ''.join(BARS[min(round(4 * IMUS * weight), 8)] for weight in weights)
    text = Text(f'  {min(glance.elapsed, duration):4.0f} of {duration:.0f} s  ')
    text.append(f'{figures.get("rate_hz", 0.0):5.1f} Hz fused', style='bold blue')
    still = figures.get('still', False)
    text.append(f'  {"still " if still else "moving"}', style='green' if still else 'yellow')
    text.append('  weights ')
    text.append(bars, style='cyan')
    if figures.get('age_p50_s') is not None:
        p50, p99 = 1e3 * figures['age_p50_s'], 1e3 * figures['age_p99_s']
        text.append(f'  {p50:.1f} ms old, p99 {p99:.1f}')
    return text


def _evaluate(run: LiveRun, last: dict[str, Any], console: Console) -> Outcome:
    """Run each IMU alone through the pipeline, and hold everything against the truth."""
    rig = load_rig(run.rig)
    recorded = read_run(run.bag, rig.names)
    tracks = {}
    shown = console.is_terminal
    with Progress(console=console, transient=True, disable=not shown) as progress:
        task = progress.add_task('the same pipeline, one IMU at a time', total=len(rig.imus) + 2)
        for name, track in rerun(rig, recorded.raw, cast('ProfileName', run.profile)):
            tracks[name] = track
            progress.advance(task)
    weights = tracks[ARRAY]
    tracks[ARRAY] = recorded.track
    truth = as_truth(*load_truth(run.truth))
    comparison = score(rig, recorded.raw, tracks, truth)
    _done(console, f'{IMUS} IMUs alone and their plain mean have been through the same pipeline')
    return Outcome(run.motion, run.duration, rig, recorded, weights, comparison, last)


def _tell(outcome: Outcome, report: Path, console: Console, as_machine: bool) -> None:
    """Print the table and the verdict."""
    comparison = outcome.comparison
    lost = not_won(comparison.rows)
    if as_machine:
        figures = {'passed': not lost, 'report': str(report), **outcome.figures()}
        print_json({'errors': as_json(comparison.rows), **figures})
        return
    console.print(_table(comparison.rows))
    console.print(outcome.footnote(), style='dim', highlight=False)
    if lost:
        console.print(f'[red]✗[/] The array did not beat its best IMU in {" and ".join(lost)}.')
    else:
        console.print('[green]✓[/] The array beats its best IMU in rate, force and attitude.')
    console.print(f'  report: [bold]{report}[/]', highlight=False, soft_wrap=True)


def _table(rows: Sequence[Row]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, title='rms error against the truth', title_justify='left')
    table.add_column('', no_wrap=True)
    for head in ('best IMU', 'plain mean', 'array', 'gain', 'ideal'):
        table.add_column(head, justify='right', style='bold blue' if head == 'array' else None)
    for row in rows:
        scale = row.quantity.per_si
        best, mean, fused, ideal = (
            f'{scale * value:.1f}' for value in (row.best, row.mean, row.fused, row.ideal)
        )
        name = f'{row.quantity.name} [dim]{escape(f"[{row.quantity.unit}]")}[/]'
        gain = f'{row.gain:.2f} ×'
        table.add_row(name, f'[dim]{row.best_imu}[/] {best}', mean, fused, gain, ideal)
    return table
