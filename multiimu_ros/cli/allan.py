"""`multiimu allan`: a bag of IMUs at rest becomes the noise blocks of their rig file."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

from rich.console import Console
from rich.progress import Progress
import typer

from multiimu_ros.bags import find_imu_topics, ImuTrack, list_topics, read_imus, Topic
from multiimu_ros.calibration.allan_fit import TERMS
from multiimu_ros.calibration.noise import fit_noise, kalibr_yaml, NoiseModel, TRIADS
from multiimu_ros.calibration.sensor_model import calibrate
from multiimu_ros.cli.bag_facts import bag_facts, bag_sha256, temperature_span
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
from multiimu_ros.report.noise_page import (
    duration,
    model_hints,
    noise_rows,
    noise_sections,
    untold,
)
from multiimu_ros.report.page import write_page
from multiimu_ros.rig import Imu, Noise, Rig, save_rig

T = TypeVar('T')

app = typer.Typer(add_completion=False)


@dataclass(frozen=True)
class Finding:
    """The noise of one IMU of the rig, and the recording that told it."""

    name: str
    topic: str
    frame_id: str
    model: NoiseModel
    noise: Noise
    provenance: dict[str, Any]


@app.command(epilog='Example: `multiimu allan rest/ --rig ring8.yaml -o ring8.yaml --report out/`')
def allan(
    bag: Annotated[Path, typer.Argument(help='rosbag2 folder, .mcap or .db3 file.')],
    output: Annotated[Path, typer.Option('--output', '-o', help='Rig file to write.')],
    rig: Annotated[
        Path | None, typer.Option(help='Rig file to start from; may be the same.')
    ] = None,
    topics: Annotated[
        list[str], typer.Option(help='Topics of imu0, imu1 ...; default: `<imu>/data_raw`.')
    ] = [],  # noqa: B006 typer copies it
    report: Annotated[Path | None, typer.Option(help='Folder for allan.html.')] = None,
    kalibr: Annotated[
        Path | None, typer.Option(help="kalibr's IMU file; several get their names added.")
    ] = None,
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Tell the noise of IMUs from a recording of them at rest, and write it to the rig file."""
    present = list_topics(bag)
    board, wanted = start_rig(rig, output, present, split_names(topics))
    names = find_imu_topics(present, board.names, wanted)
    findings = _findings(bag, [(board.imus[k], topic) for k, topic in names.items()], present)
    if report is not None:
        _write_report(report, bag, findings)
    if kalibr is not None:
        _write_kalibr(kalibr, findings)
    save_rig(_with_noise(board, findings, bare=rig is None), output)
    if as_json:
        print_json({finding.name: _as_json(finding) for finding in findings})
    else:
        _print(findings, output)


def _findings(
    bag: Path, topics: Sequence[tuple[Imu, str]], present: Sequence[Topic]
) -> list[Finding]:
    with _bar() as progress:
        progress.add_task('Reading the bag', total=None)
        tracks = read_imus(bag, [topic for _, topic in topics]).tracks
        sha256 = bag_sha256(bag)
    findings = []
    for (imu, _), track in _steps(list(zip(topics, tracks, strict=True)), 'Allan deviation'):
        facts = bag_facts(bag, track, sha256)
        findings.append(_finding(imu, track, facts, temperature_span(bag, track.topic, present)))
    return findings


def _bar() -> Progress:
    console = Console(stderr=True)
    return Progress(console=console, transient=True, disable=not console.is_terminal)


def _steps(items: Sequence[T], what: str) -> Iterator[T]:
    """Yield the items, each of which takes about a second, under a bar on a terminal's stderr."""
    with _bar() as bar:
        yield from bar.track(items, description=what)


def _finding(
    imu: Imu, track: ImuTrack, facts: dict[str, Any], span: tuple[float, float] | None
) -> Finding:
    model = fit_noise(calibrate(track.samples, imu.intrinsics), track.topic)
    facts |= {'duration_s': round(model.record.duration, 3)}
    if span is not None:
        facts |= {'temperature': list(span)}
    return Finding(imu.name, track.topic, track.frame_id, model, model.noise, facts)


def _with_noise(board: Rig, findings: Sequence[Finding], *, bare: bool) -> Rig:
    """Return the rig with the new noise blocks; a bare one gets the frames of the messages too."""
    found = {finding.name: finding for finding in findings}
    imus = []
    for imu in board.imus:
        if imu.name not in found:
            imus.append(imu)
            continue
        new = found[imu.name]
        update: dict[str, Any] = {'noise': new.noise}
        update['provenance'] = imu.provenance | {'noise': new.provenance}
        if bare and new.frame_id:
            update['frame_id'] = new.frame_id
        imus.append(imu.model_copy(update=update))
    return board.model_copy(update={'imus': tuple(imus)})


def _write_report(folder: Path, bag: Path, findings: Sequence[Finding]) -> None:
    make_folder(folder)
    sections = [
        part for f in _steps(findings, 'Drawing') for part in noise_sections(f.name, f.model)
    ]
    lead = f'What {len(findings)} IMUs say at rest, and how sure that is.'
    write_page(folder / 'allan.html', f'Noise: {bag.resolve().name}', lead, sections)


def _write_kalibr(path: Path, findings: Sequence[Finding]) -> None:
    """Write one file, or one per IMU with its name before the suffix: kalibr reads one each."""
    for finding in findings:
        single = len(findings) == 1
        place = path if single else path.with_stem(f'{path.stem}_{finding.name}')
        try:
            place.write_text(kalibr_yaml(finding.model, finding.topic), encoding='utf-8')
        except OSError as error:
            msg = f'Cannot write `{place}`: {error.strerror}; choose a writable place.'
            raise ConfigError(msg) from error


def _print(findings: Sequence[Finding], output: Path) -> None:
    for finding in findings:
        for triad in TRIADS:
            print_table(f'{finding.name}, {triad}', noise_rows(finding.model, triad))
        record = finding.model.record
        typer.echo(f'{duration(record.duration)} of rest at {record.rate_hz:.4g} Hz')
        if 'temperature' in finding.provenance:
            low, high = finding.provenance['temperature']
            typer.echo(f'temperature: {low:.1f} to {high:.1f} deg C')
        for sentence in untold(finding.model):
            typer.echo(sentence)
    typer.echo(f'Written to {output}')


def _as_json(finding: Finding) -> dict[str, Any]:
    model = finding.model
    hints = model_hints(model)
    result: dict[str, Any] = {
        'topic': finding.topic,
        'duration_s': model.record.duration,
        'rate_hz': model.record.rate_hz,
        'lost': model.record.lost,
        'provenance': finding.provenance,
        'noise': finding.noise.model_dump(mode='json', exclude_none=True),
    }
    for triad in TRIADS:
        noise = model.triad(triad)
        result[triad] = {
            'terms': {letter: [vars(t) for t in noise.axes(letter)] for letter in TERMS},
            'fitted_from_s': [fit.from_s for fit in noise.fits],
            'model': [vars(hint) for hint in hints[triad]],
        }
    return result
