"""`multiimu fuse`: a bag of raw IMU topics becomes one IMU and an odometry, without ROS."""

from collections.abc import Iterator
from pathlib import Path
import time
from typing import Annotated, Any, cast

import numpy as np
import typer

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.bags import find_imu_topics, ImuRecording, list_topics, read_imus
from multiimu_ros.cli.fused_bag import fused_bag, FusedBag, write_fused
from multiimu_ros.cli.hindsight import smoothed_columns, solved, Tape
from multiimu_ros.cli.options import (
    AsJson,
    make_folder,
    OptionsFile,
    print_json,
    print_table,
    split_names,
    with_progress,
)
from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion.benefit import Benefit
from multiimu_ros.odometry.smoother import Closure
from multiimu_ros.pipeline import FusedFrame, ImuHealth, Pipeline, PipelineConfig
from multiimu_ros.pipeline_config import CHOICES, fused_frame_id
from multiimu_ros.report.walk import joined, smoothed_walk, Walk, WalkRecorder
from multiimu_ros.rig import load_rig

BLOCK = 4096  # readings fused at a time
DOUBTFUL = 5.0  # sigma: the height of a foot errs by twice of what it says, at times
NOISES = (('rate', 1e3 * np.rad2deg(1.0), 'mdeg/s'), ('force', 1e3, 'mm/s^2'))

app = typer.Typer(add_completion=False)


def _choice(name: str, what: str) -> Any:
    return typer.Option(help=f'{what}: {", ".join(CHOICES[name])}.')


@app.command(epilog='Example: `multiimu fuse walk/ --rig ring8.yaml -o walk_fused/`')
def fuse(
    bag: Annotated[Path, typer.Argument(help='rosbag2 folder, .mcap or .db3 file.')],
    rig: Annotated[Path, typer.Option(help='Rig file of the board.')],
    output: Annotated[Path, typer.Option('--output', '-o', help='Bag to make.')],
    topics: Annotated[
        list[str], typer.Option(help='Topics of imu0, imu1 ...; default: `<imu>/data_raw`.')
    ] = [],  # noqa: B006 typer copies it
    profile: Annotated[str, _choice('profile', 'What carries the rig')] = 'hand',
    local: Annotated[str, _choice('local', 'Filter of each IMU')] = 'kf',
    master: Annotated[str, _choice('master', 'What fuses the filters')] = 'carlson',
    reset: Annotated[str, _choice('reset', 'What carlson gives back to them')] = 'fusion',
    fuse_every: Annotated[int, typer.Option(help='Scans between two fusions of carlson.')] = 1,
    noise: Annotated[str, _choice('noise', 'Where the weights come from')] = 'rig',
    guard: Annotated[bool, typer.Option(help='Leave out IMUs that the others contradict.')] = True,
    prefilter: Annotated[str, _choice('prefilter', 'Filter before fusion; it lags')] = 'none',
    cutoff_hz: Annotated[float, typer.Option(help='Cutoff of the prefilter [Hz].')] = 40.0,
    virtual_imu: Annotated[
        tuple[float, float, float], typer.Option(help='Where the fused IMU sits, base frame [m].')
    ] = (0.0, 0.0, 0.0),
    virtual_imu_frame: Annotated[str, typer.Option(help='Name of the frame at that point.')] = '',
    zero_velocity: Annotated[str, _choice('zero_velocity', 'What tells of stillness')] = 'glrt',
    attitude: Annotated[str, _choice('attitude', 'Filter of the orientation')] = 'error_state',
    odometry: Annotated[str, _choice('odometry', 'Filter of the position')] = 'error_state',
    smooth: Annotated[
        bool, typer.Option('--smooth', help='Make `odom` anew, knowing the whole recording.')
    ] = False,
    closed: Annotated[
        float | None, typer.Option(help='With --smooth: it ended where it began, to this [m].')
    ] = None,
    report: Annotated[
        Path | None, typer.Option(help='Folder for `fuse.html`, with the path as pictures.')
    ] = None,
    storage: Annotated[str, typer.Option(help='mcap or sqlite3.')] = 'mcap',
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Fuse a bag of raw IMU topics into `imu/data` and `odom`, stamped with the measurement."""
    _check_closed(closed, smooth=smooth)
    board = load_rig(rig)
    config = PipelineConfig(  # which refuses what it does not know
        profile=cast('Any', profile), local=cast('Any', local), master=cast('Any', master),
        reset=cast('Any', reset), fuse_every=fuse_every, noise=cast('Any', noise), guard=guard,
        prefilter=cast('Any', prefilter), cutoff_hz=cutoff_hz, virtual_imu=virtual_imu,
        zero_velocity=cast('Any', zero_velocity), attitude=cast('Any', attitude),
        odometry=cast('Any', odometry),
    )  # fmt: skip
    frame_id = fused_frame_id(board.rig.base_frame, virtual_imu, virtual_imu_frame)
    pipeline = Pipeline(board, config)
    names = find_imu_topics(list_topics(bag), board.names, split_names(topics))
    if report is not None:
        make_folder(report)
    begin = time.perf_counter()
    recording = read_imus(bag, list(names.values()))
    frames = fused_frames(pipeline, recording, list(names))
    recorder = WalkRecorder()
    walk: Walk | None = None
    closure: Closure | None = None
    with fused_bag(output, storage, frame_id) as fused:
        if report is not None:
            frames = recorder.watch(frames)
        if smooth:
            still, walk, closure = _write_smoothed(fused, pipeline, frames, recorder, closed)
        else:
            still = write_fused(fused, frames)
    summary = _summary(pipeline, recording, still, time.perf_counter() - begin)
    if closure is not None:
        summary['closure'] = closure._asdict()
    if report is not None:
        about = bag.resolve().name, board.rig.name, profile, _closing(closure)
        summary['report'] = _write_page(report, about, pipeline, recorder.walk(), walk)
    if as_json:
        print_json(summary)
        return
    print_table(
        f'{summary["frames"]} frames, {summary["duration_s"]:.1f} s at {summary["speed"]:.0f} x '
        f'real time, {summary["still_share"]:.0%} still, to {output}',
        [_row(imu) for imu in summary['imus']],
    )
    typer.echo(_gain(pipeline.benefit()))
    if closure is not None:
        typer.echo(_closing(closure))
    if report is not None:
        typer.echo(f'The path as pictures: {summary["report"]}')
    for imu in summary['imus']:
        if imu['recalibrate']:
            typer.echo(f'{imu["name"]}: recalibrate it; its {imu["recalibrate"]} is off')


def _check_closed(closed: float | None, *, smooth: bool) -> None:
    if closed is not None and not smooth:
        msg = 'A closed path is known in hindsight only: `--closed` needs `--smooth`.'
        raise ConfigError(msg)
    if closed is not None and not 0.0 < closed < np.inf:
        msg = f'`--closed` must be a positive length [m], got {closed}.'
        raise ConfigError(msg)


def _closing(closure: Closure | None) -> str:
    """Say in a sentence how well the recording closed by itself, if it was said to close."""
    if closure is None:
        return ''
    ending = ': did it really end where it began?' if closure.surprise > DOUBTFUL else '.'
    return (
        f'Before it was closed, the path ended {closure.gap:.3g} m from its start, '
        f'{closure.surprise:.1f} sigma{ending}'
    )


def _write_smoothed(
    bag: FusedBag,
    pipeline: Pipeline,
    frames: Iterator[FusedFrame],
    recorder: WalkRecorder,
    closed: float | None,
) -> tuple[float, Walk | None, Closure | None]:
    """Write the frames with the odometry in hindsight.

    Returns
    -------
    float
        Share of still frames.
    Walk or None
        The odometry in hindsight, where `recorder` has watched the frames.
    Closure or None
        How well it closed, where that was said to be known.
    """
    tape = Tape(frames)
    live = recorder.walk() if recorder.watches else None
    walks = []
    smoother = solved(pipeline, tape, closed)
    for block in smoother.blocks():
        bag.write(*smoothed_columns(tape, block))
        if live is not None:
            walks.append(smoothed_walk(live, block))
    still = float(np.mean(tape.flags[:, 0]))
    return still, joined(walks) if walks else None, smoother.closure


def _write_page(
    folder: Path,
    about: tuple[str, str, str, str],
    pipeline: Pipeline,
    live: Walk,
    best: Walk | None,
) -> str:
    """Write the report; `about` are the names of recording, rig and profile, and the closing."""
    # matplotlib takes a second
    from multiimu_ros.report.walk_page import WalkFacts, write_walk_page  # noqa: PLC0415

    recording, rig, profile, closing = about
    facts = WalkFacts(
        recording=recording, rig=rig, profile=cast('Any', profile), imus=pipeline.health(),
        benefit=_gain(pipeline.benefit()), closing=closing,
    )  # fmt: skip
    return str(write_walk_page(folder, live, facts, best))


def _row(imu: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in imu.items() if not isinstance(value, dict)}


def fused_frames(
    pipeline: Pipeline, recording: ImuRecording, imus: list[int]
) -> Iterator[FusedFrame]:
    """Push the samples in recorded order; `imus[j]` is the IMU in the rig of track j."""
    order = recording.order
    stamps_ns, values = np.empty(len(order), np.int64), np.empty((len(order), 6))
    for j, track in enumerate(recording.tracks):
        own = order == j
        stamps_ns[own] = track.samples.stamp_ns
        values[own] = np.hstack([track.samples.angular_rate, track.samples.specific_force])
    streams = np.array(imus, np.int64)[order]
    starts = range(0, len(order), BLOCK)
    for start in with_progress(starts, len(starts), 'Fusing'):
        part = slice(start, start + BLOCK)
        yield from pipeline.push_block(streams[part], stamps_ns[part], values[part])


def _health(imu: ImuHealth) -> dict[str, Any]:
    """Return the state of one IMU: plain figures, and its gaps to the others under their names."""
    gaps = {name: gap._asdict() for name, gap in vars(imu.disagreement).items()}
    raised = ', '.join(name for name, gap in gaps.items() if gap['raised'])
    figures = {k: v for k, v in vars(imu).items() if k not in ('disagreement', 'fault')}
    figures |= {'exclusions': imu.fault.exclusions, 'fault': imu.fault.reason}
    return figures | {'recalibrate': raised, 'disagreement': gaps}


def _gain(noise: Benefit) -> str:
    """Say in a sentence what the array gains over one IMU."""
    if np.isnan(noise.fused_noise).any():
        return 'The gain in noise is unknown: it is measured while the rig rests.'
    words = []
    for k, (what, factor, unit) in enumerate(NOISES):
        fused, single, ideal = noise.fused_noise[k], noise.best_single[k], noise.ideal[k]
        word = f'{what} {factor * fused:.3g} {unit}'
        if single != noise.mean_single[k]:  # there are several IMUs
            gain = f'{single / fused:.2f} x quieter than the best single IMU'
            word += f', {gain} (ideal {single / ideal:.2f} x)'
        words.append(word)
    return f'Noise at rest: {"; ".join(words)}.'


def _summary(
    pipeline: Pipeline, recording: ImuRecording, still: float, seconds: float
) -> dict[str, Any]:
    stamps = np.concatenate([track.samples.stamp_ns for track in recording.tracks])
    duration = float(np.ptp(stamps)) / NANOSECONDS
    return {
        'frames': pipeline.frames,
        'empty_scans': pipeline.empty_scans,
        'time_jumps': pipeline.time_jumps,
        'duration_s': duration,
        'speed': duration / seconds,
        'still_share': still,
        'benefit': {name: noise.tolist() for name, noise in pipeline.benefit()._asdict().items()},
        'imus': [_health(imu) for imu in pipeline.health()],
    }
