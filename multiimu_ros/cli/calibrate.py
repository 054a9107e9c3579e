"""`multiimu calibrate`: one recording of N IMUs becomes the rig file that the nodes load."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console
from rich.progress import Progress
from rich.text import Text
import typer

from multiimu_ros.bags import find_imu_topics, ImuTrack, list_topics, read_imus, Topic
from multiimu_ros.cli.bag_facts import bag_facts, bag_sha256, temperature_span
from multiimu_ros.cli.options import AsJson, OptionsFile, print_json, print_table, split_names
from multiimu_ros.cli.rig_start import start_rig
from multiimu_ros.errors import ConfigError
from multiimu_ros.rig import Rig, save_rig
from multiimu_ros.rig_calibration.calibrate import calibrate_rig, Calibration, rest_rms, STAGES
from multiimu_ros.rig_calibration.verdicts import GOOD, judge, REDO, USABLE, Verdict, worst

STYLES = {GOOD: 'green', USABLE: 'yellow', REDO: 'bold red'}
KINDS = {
    'accelerometer': 'accel',
    'gyroscope': 'gyro',
    'rotation': 'rotation',
    'lever arm': 'arm',
    'time offset': 'time',
}
STEPS_PER_IMU, STEPS = 2, 5  # what the progress bar counts to

app = typer.Typer(add_completion=False)


@app.command(
    epilog='Example: `multiimu calibrate waved/ -o ring8.yaml --latitude 59.3 --report out/`'
)
def calibrate(
    bag: Annotated[Path, typer.Argument(help='rosbag2 folder, .mcap or .db3 file.')],
    output: Annotated[Path, typer.Option('--output', '-o', help='Rig file to write.')],
    rig: Annotated[
        Path | None,
        typer.Option(help='Rig file to start from: drawn poses, noise; may be the same.'),
    ] = None,
    topics: Annotated[
        list[str], typer.Option(help='Topics of imu0, imu1 ...; default: `<imu>/data_raw`.')
    ] = [],  # noqa: B006 typer copies it
    gravity: Annotated[float | None, typer.Option(help='Local gravity [m/s^2].')] = None,
    latitude: Annotated[
        float | None, typer.Option(help='Gives gravity, with --height [deg].')
    ] = None,
    height: Annotated[float, typer.Option(help='Above the sea [m].')] = 0.0,
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

    Finds bias, scale, misalignment and g-sensitivity of every IMU, its noise, how it is turned
    and where it sits, and the delay of its stamps, each with its standard deviation and a verdict.
    The exit code is 0 when a rig was written; what is not good enough is named with the remedy.
    """
    present = list_topics(bag)
    board, wanted = start_rig(rig, output, present, split_names(topics))
    stages = split_names(only) or list(STAGES)
    if only and rig is None:
        msg = '`--only` must come with `--rig`, whose other content it keeps.'
        raise ConfigError(msg)
    board = with_gravity(board, gravity, latitude, height)
    run = run_calibration(bag, board, present, wanted, stages, joint=joint)
    finish(run, output, report, as_json=as_json)


class Run:
    """A calibration, and the recording that it came from."""

    def __init__(
        self, bag: Path, calibration: Calibration, facts: Sequence[dict[str, Any]]
    ) -> None:
        self.bag = bag
        self.calibration = calibration
        self.verdicts = judge(calibration)
        imus = zip(calibration.after.imus, facts, strict=True)
        noted = [
            imu.model_copy(
                update={'provenance': imu.provenance | fact | self._residuals(k, imu.name)}
            )
            for k, (imu, fact) in enumerate(imus)
        ]
        self.rig = calibration.after.model_copy(update={'imus': tuple(noted)})

    def _residuals(self, k: int, name: str) -> dict[str, Any]:
        own = tuple(verdict for verdict in self.verdicts if verdict.imu == name)
        noted: dict[str, Any] = {'verdict': worst(own)}
        if self.calibration.intrinsics:
            fit = self.calibration.intrinsics[k]
            rms = rest_rms(fit.residual_after, fit.poses.duration)
            noted |= {'poses': int(fit.poses.known.sum()), 'residual_rms': round(rms, 6)}
        alignment = self.calibration.alignments[k] if self.calibration.alignments else None
        if alignment is not None and alignment.fine is not None and alignment.fine.skew:
            noted |= {'clock_skew_ppm': round(1e6 * alignment.fine.skew, 4)}
        return noted


def with_gravity(board: Rig, gravity: float | None, latitude: float | None, height: float) -> Rig:
    """Return the rig with the gravity that the user states, if any.

    Raises
    ------
    ConfigError
        If both ways are used at once, or a figure is out of range.
    """
    if gravity is None and latitude is None:
        return board
    if gravity is not None and latitude is not None:
        msg = '`--gravity` or `--latitude` must be given, got both; leave one out.'
        raise ConfigError(msg)
    stated = {'gravity': gravity, 'latitude': latitude, 'height': height}
    frame = board.rig.model_dump() | stated
    try:
        return board.model_copy(update={'rig': type(board.rig).model_validate(frame)})
    except ValueError as error:
        name, value = ('gravity', gravity) if latitude is None else ('latitude', latitude)
        msg = f'`--{name}` must be plausible for a place on earth, got {value}.'
        raise ConfigError(msg) from error


def run_calibration(
    bag: Path,
    board: Rig,
    present: Sequence[Topic],
    wanted: list[str],
    stages: Sequence[str],
    *,
    joint: bool = False,
) -> Run:
    """Read the bag and run the stages, under a progress bar on a terminal's stderr."""
    found = find_imu_topics(present, board.names, wanted)
    absent = [name for k, name in enumerate(board.names) if k not in found]
    if absent:
        msg = (
            f'The bag must hold all IMUs of the rig, but nothing was recorded of '
            f'`{"`, `".join(absent)}`; record it again, or take them out of the rig file.'
        )
        raise ConfigError(msg)
    with _steps(STEPS + STEPS_PER_IMU * len(found)) as tell:
        tell('reading the bag')
        tracks = read_imus(bag, [found[k] for k in range(len(found))]).tracks
        facts = _facts(bag, tracks, present)
        board = _with_frames(board, tracks)
        samples = [track.samples for track in tracks]
        calibration = calibrate_rig(board, samples, stages=stages, joint=joint, tell=tell)
    return Run(bag, calibration, facts)


@contextmanager
def _steps(total: int) -> Iterator[Callable[[str], None]]:
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task('calibrating', total=total)

        def tell(step: str) -> None:
            bar.update(task, description=step, advance=1)

        yield tell


def _facts(
    bag: Path, tracks: Sequence[ImuTrack], present: Sequence[Topic]
) -> list[dict[str, Any]]:
    sha256 = bag_sha256(bag)
    facts = []
    for track in tracks:
        fact = bag_facts(bag, track, sha256)
        stamps = track.samples.stamp_ns
        if len(stamps):
            fact |= {'duration_s': round(float(stamps[-1] - stamps[0]) * 1e-9, 3)}
        span = temperature_span(bag, track.topic, present)
        facts.append(fact if span is None else fact | {'temperature': list(span)})
    return facts


def _with_frames(board: Rig, tracks: Sequence[ImuTrack]) -> Rig:
    """Give IMUs that nobody calibrated the frames that their messages name."""
    imus = [
        imu.model_copy(update={'frame_id': track.frame_id})
        if track.frame_id and not imu.provenance and imu.extrinsics is None
        else imu
        for imu, track in zip(board.imus, tracks, strict=True)
    ]
    return board.model_copy(update={'imus': tuple(imus)})


def finish(run: Run, output: Path, report: Path | None, *, as_json: bool) -> None:
    """Write report and rig file, and print the verdicts."""
    if report is not None:
        _write_report(run, report)
    save_rig(run.rig, output)
    if as_json:
        print_json(as_dict(run))
        return
    _print(run, output, report)


def _write_report(run: Run, folder: Path) -> None:
    # Only here: matplotlib takes a second to import.
    from multiimu_ros.report.calibration_page import write_calibration_page  # noqa: PLC0415

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        msg = f'Cannot make the folder `{folder}`: {error.strerror}; choose a writable place.'
        raise ConfigError(msg) from error
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


def _print(run: Run, output: Path, report: Path | None) -> None:
    console = Console(soft_wrap=True, highlight=False)
    calibration = run.calibration
    print_table(
        f'{len(calibration.intervals)} rests; grade of each figure by its sigma',
        [_row(run, name) for name in calibration.after.names],
    )
    if len(calibration.after.imus) > 1:
        before, after = 1e3 * calibration.spread_before, 1e3 * calibration.spread_after
        console.print(
            f'at rest the IMUs differ by {before:.3g} mm/s^2 before and {after:.3g} after'
        )
    for note in calibration.notes:
        console.print(Text(note, style=STYLES[REDO]))
    for grade, quantity, imus, why in grouped(run.verdicts):
        everybody = len(imus) == len(calibration.after.imus) > 2
        named = f' {quantity} of {"all IMUs" if everybody else ", ".join(imus)}: {why}'
        console.print(Text.assemble((grade, STYLES[grade]), named))
    where = '' if report is None else f', the report to {report / "calibration.html"}'
    console.print(f'Written to {output}{where}')


def grouped(verdicts: Sequence[Verdict]) -> list[tuple[str, str, list[str], str]]:
    """Return what is not good: grade, quantity, its IMUs, and the reason of the worst of them."""
    groups: dict[tuple[str, str], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.grade != GOOD:
            groups.setdefault((verdict.grade, verdict.quantity), []).append(verdict)
    return [
        (grade, quantity, [v.imu for v in group], max(group, key=lambda v: v.size).why)
        for (grade, quantity), group in sorted(groups.items(), key=lambda item: item[0][0])
    ]


def _row(run: Run, name: str) -> dict[str, Any]:
    """Return the line of one IMU: what the worst figure of each kind is worth."""
    own = {verdict.quantity: verdict for verdict in run.verdicts if verdict.imu == name}
    row: dict[str, Any] = {'imu': name}
    for kind, head in KINDS.items():
        grades = tuple(v for quantity, v in own.items() if quantity.startswith(kind))
        row[head] = worst(grades) if grades else '-'
    for quantity, head in (
        ('|f| - g at rest', '|f|-g mm/s2'),
        ('gravity after a turn', 'turn mdeg'),
    ):
        row[head] = own[quantity].value if quantity in own else '-'
    return row
