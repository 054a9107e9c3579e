"""`multiimu calibrate`: one recording of N IMUs becomes the rig file that the nodes load."""

from collections.abc import Sequence
import os
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.text import Text
import typer

from multiimu_ros.bags import list_topics
from multiimu_ros.cli.calibration_run import Run, run_calibration
from multiimu_ros.cli.options import (
    AsJson,
    make_folder,
    OptionsFile,
    print_json,
    print_table,
    split_names,
)
from multiimu_ros.cli.rig_start import start_rig
from multiimu_ros.errors import ConfigError
from multiimu_ros.rig import Rig, save_rig
from multiimu_ros.rig_calibration.calibrate import STAGES
from multiimu_ros.rig_calibration.verdicts import (
    AT_REST,
    GOOD,
    GRADES,
    LIMITS,
    REDO,
    TURN,
    USABLE,
    Verdict,
    worst,
)

STYLES = {GOOD: 'green', USABLE: 'yellow', REDO: 'bold red'}
KINDS = {
    'accelerometer': 'accel',
    'gyroscope': 'gyro',
    'noise': 'noise',
    'rotation': 'rotation',
    'lever arm': 'arm',
    'time offset': 'time',
}

app = typer.Typer(add_completion=False)


@app.command(
    epilog='Example: `multiimu calibrate waved/ -o ring8.yaml --latitude 59.3 --report out/`'
)
def calibrate(
    bag: Annotated[Path, typer.Argument(help='rosbag2 folder, .mcap or .db3 file.')],
    output: Annotated[Path, typer.Option('--output', '-o', help='Rig file to write.')],
    rig: Annotated[
        Path | None,
        typer.Option(help='Rig file to start from: drawn poses, noise; may be the same as -o.'),
    ] = None,
    topics: Annotated[
        list[str], typer.Option(help='Topics of imu0, imu1 ...; default: `<imu>/data_raw`.')
    ] = [],  # noqa: B006 typer copies it
    gravity: Annotated[float | None, typer.Option(help='Local gravity in m/s^2.')] = None,
    latitude: Annotated[
        float | None, typer.Option(help='In degrees; gives gravity, with --height.')
    ] = None,
    height: Annotated[
        float | None, typer.Option(help='Above the sea in m; default: 0.', show_default=False)
    ] = None,
    only: Annotated[
        list[str], typer.Option(help=f'Repeat only: {", ".join(STAGES)}; needs --rig.')
    ] = [],  # noqa: B006 typer copies it
    joint: Annotated[
        bool, typer.Option('--joint', help='One fit of all IMUs: same gravity, same moves.')
    ] = False,
    report: Annotated[Path | None, typer.Option(help='Folder for calibration.html.')] = None,
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Calibrate a board from one bag: a rest, 20 or more still poses, then waving about.

    Finds biases, scales, misalignments, g-sensitivity, noise, rotations, lever arms and delays.

    Each comes with its sigma and a verdict; what to record better is said where it is not good.

    The exit code is 0 when a rig file was written; a file that was there is kept as `.old`.
    """
    stages = _stages(only, rig)
    refuse_unwritable(output, report)
    present = list_topics(bag)
    board, wanted = start_rig(rig, output, present, split_names(topics))
    board = with_gravity(board, gravity, latitude, height)
    run = run_calibration(bag, board, present, wanted, stages, joint=joint, bare=rig is None)
    finish(run, output, report, as_json=as_json)


def _stages(only: Sequence[str], rig: Path | None) -> tuple[str, ...]:
    """Return the stages to run, in their order."""
    names = split_names(only)
    unknown = [name for name in names if name not in STAGES]
    if unknown:
        msg = f'`--only` must be one of {", ".join(STAGES)}, got `{unknown[0]}`.'
        raise ConfigError(msg)
    if names and rig is None:
        msg = '`--only` must come with `--rig`, whose other content it keeps.'
        raise ConfigError(msg)
    return tuple(stage for stage in STAGES if not names or stage in names)


def refuse_unwritable(output: Path, report: Path | None) -> None:
    """Find out before a minute of calculation, not after it, that a place is no place to write.

    Raises
    ------
    ConfigError
        If the rig file cannot be written, or the folder of the report cannot be made.
    """
    if output.is_dir() or not os.access(output.absolute().parent, os.W_OK | os.X_OK):
        msg = f'`-o {output}` must be a file in a writable folder, and is not; choose another.'
        raise ConfigError(msg)
    if report is None:
        return
    beneath = next(place for place in (report, *report.absolute().parents) if place.exists())
    if not beneath.is_dir() or not os.access(beneath, os.W_OK | os.X_OK):
        msg = f'`--report {report}` must be a writable folder, and is not; choose another.'
        raise ConfigError(msg)


def with_gravity(
    board: Rig, gravity: float | None, latitude: float | None, height: float | None
) -> Rig:
    """Return the rig with the gravity that the user states, if any.

    Raises
    ------
    ConfigError
        If both ways are used at once or half of one, or a figure is out of range.
    """
    if height is not None and latitude is None:
        msg = '`--height` must come with `--latitude`, as gravity follows from both; add it.'
        raise ConfigError(msg)
    if gravity is None and latitude is None:
        return board
    if gravity is not None and latitude is not None:
        msg = '`--gravity` or `--latitude` must be given, got both; leave one out.'
        raise ConfigError(msg)
    stated = {'gravity': gravity, 'latitude': latitude, 'height': height or 0.0}
    frame = board.rig.model_dump() | stated
    try:
        return board.model_copy(update={'rig': type(board.rig).model_validate(frame)})
    except ValueError as error:
        name, value = ('gravity', gravity) if latitude is None else ('latitude', latitude)
        msg = f'`--{name}` must be plausible for a place on earth, got {value}.'
        raise ConfigError(msg) from error


def finish(run: Run, output: Path, report: Path | None, *, as_json: bool) -> None:
    """Write rig file and report, and print the verdicts."""
    replaced = output.exists()
    save_rig(run.rig, output)
    if report is not None:
        _write_report(run, report)
    if as_json:
        print_json(as_dict(run))
        return
    _print(run)
    kept = f'; what was there before is in {output.name}.old' if replaced else ''
    typer.echo(f'Rig file: {output}{kept}')
    if report is not None:
        typer.echo(f'Report: {report / "calibration.html"}')


def _write_report(run: Run, folder: Path) -> None:
    # Only here: matplotlib takes a second to import.
    from multiimu_ros.report.calibration_page import write_calibration_page  # noqa: PLC0415

    make_folder(folder)
    title = f'Calibration: {run.bag.resolve().name}'
    write_calibration_page(folder / 'calibration.html', run.calibration, run.verdicts, title)


def as_dict(run: Run) -> dict[str, Any]:
    """Return what `--json` prints."""
    calibration = run.calibration
    return {
        'verdict': worst(run.verdicts),
        'poses': len(calibration.intervals),
        'spread_before': calibration.spread_before,
        'spread_after': calibration.spread_after,
        'notes': list(calibration.notes),
        'verdicts': [vars(verdict) for verdict in run.verdicts],
        'rig': run.rig.model_dump(mode='json', exclude_none=True),
    }


def _print(run: Run) -> None:
    # Sentences are wrapped by the terminal, so that a copied one is whole.
    console = Console(soft_wrap=True, highlight=False)
    calibration = run.calibration
    rows = [_row(run, name) for name in calibration.after.names]
    print_table(f'{len(calibration.intervals)} rests; the worst verdict of each kind', rows)
    if calibration.intrinsics:
        console.print(
            f'|f|-g: error of the force at rest in mm/s^2, good up to {LIMITS[AT_REST][0]:g}\n'
            f'turn: error of gravity after a turn in mdeg, good up to {LIMITS[TURN][0]:g}'
        )
    if len(calibration.after.imus) > 1:
        before, after = 1e3 * calibration.spread_before, 1e3 * calibration.spread_after
        console.print(
            f'forces of the IMUs at rest: {before:.0f} mm/s^2 apart before, now {after:.1f}'
        )
    for note in calibration.notes:
        console.print(Text.assemble(('note', STYLES[REDO]), f' {note}'))
    for grade, quantity, imus, why in grouped(run.verdicts):
        everybody = len(imus) == len(calibration.after.imus) > 2
        named = f' {quantity} of {"all IMUs" if everybody else ", ".join(imus)}: {why}'
        console.print(Text.assemble((grade, STYLES[grade]), named))


def grouped(verdicts: Sequence[Verdict]) -> list[tuple[str, str, list[str], str]]:
    """Return what is not good, the worst first: grade, quantity, IMUs, reason of the worst IMU."""
    groups: dict[tuple[str, str], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.grade != GOOD:
            groups.setdefault((verdict.grade, verdict.quantity), []).append(verdict)
    ranked = sorted(groups.items(), key=lambda item: -GRADES.index(item[0][0]))
    return [
        (grade, quantity, [v.imu for v in group], max(group, key=lambda v: v.size).why)
        for (grade, quantity), group in ranked
    ]


def _row(run: Run, name: str) -> dict[str, Any]:
    """Return the line of one IMU: what the worst figure of each kind is worth."""
    own = {verdict.quantity: verdict for verdict in run.verdicts if verdict.imu == name}
    row: dict[str, Any] = {'imu': name}
    for kind, head in KINDS.items():
        grades = tuple(v for quantity, v in own.items() if quantity.startswith(kind))
        row[head] = worst(grades) if grades else '-'
    for quantity, head in ((AT_REST, '|f|-g'), (TURN, 'turn')):
        row[head] = own[quantity].value if quantity in own else '-'
    return row
