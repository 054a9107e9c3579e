"""`multiimu fuse`: a bag of raw IMU topics becomes one IMU and an odometry, without ROS."""

from collections.abc import Iterator
from pathlib import Path
import shutil
import time
from typing import Annotated, Any, cast

import numpy as np
import typer

from multiimu_ros.arrays import NANOSECONDS, Vector
from multiimu_ros.bags import BagWriter, find_imu_topics, ImuRecording, list_topics, read_imus
from multiimu_ros.bags.cdr import encode_imus, encode_odometry
from multiimu_ros.cli.options import (
    AsJson,
    OptionsFile,
    print_json,
    print_table,
    split_names,
    with_progress,
)
from multiimu_ros.pipeline import (
    FusedFrame,
    ImuHealth,
    Local,
    Master,
    Pipeline,
    PipelineConfig,
    ProfileName,
)
from multiimu_ros.rig import load_rig, Rig
from multiimu_ros.samples import ImuSamples

BLOCK = 4096  # frames written at a time
COLUMNS = (
    'angular_rate',
    'angular_rate_covariance',
    'specific_force',
    'specific_force_covariance',
    'orientation',
    'orientation_covariance',
    'position_n',
    'odom_orientation',
    'pose_covariance',
    'velocity_b',
    'twist_covariance',
)

app = typer.Typer(add_completion=False)


@app.command(epilog='Example: `multiimu fuse walk/ --rig ring8.yaml -o walk_fused/`')
def fuse(
    bag: Annotated[Path, typer.Argument(help='rosbag2 folder, .mcap or .db3 file.')],
    rig: Annotated[Path, typer.Option(help='Rig file of the board.')],
    output: Annotated[Path, typer.Option('--output', '-o', help='Bag to make.')],
    topics: Annotated[
        list[str], typer.Option(help='Topics of imu0, imu1 ...; default: `<imu>/data_raw`.')
    ] = [],  # noqa: B006 typer copies it
    profile: Annotated[str, typer.Option(help='hand, foot or vehicle.')] = 'hand',
    local: Annotated[str, typer.Option(help='Local filter: kf.')] = 'kf',
    master: Annotated[str, typer.Option(help='Master filter: carlson.')] = 'carlson',
    storage: Annotated[str, typer.Option(help='mcap or sqlite3.')] = 'mcap',
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Fuse a bag of raw IMU topics into `imu/data` and `odom`, stamped with the measurement."""
    board = load_rig(rig)
    pipeline = Pipeline(board, _config(profile, local, master))
    names = find_imu_topics(list_topics(bag), board.names, split_names(topics))
    begin = time.perf_counter()
    recording = read_imus(bag, list(names.values()))
    still = write_fused(fused_frames(pipeline, recording, list(names)), output, board, storage)
    summary = _summary(pipeline, recording, still, time.perf_counter() - begin)
    if as_json:
        print_json(summary)
        return
    print_table(
        f'{summary["frames"]} frames, {summary["duration_s"]:.1f} s at {summary["speed"]:.0f} x '
        f'real time, {summary["still_share"]:.0%} still, to {output}',
        [_row(imu) for imu in summary['imus']],
    )
    for imu in summary['imus']:
        if imu['recalibrate']:
            typer.echo(f'{imu["name"]}: recalibrate it; its {imu["recalibrate"]} is off')


def _row(imu: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in imu.items() if not isinstance(value, dict)}


def _config(profile: str, local: str, master: str) -> PipelineConfig:
    return PipelineConfig(  # which refuses a name it does not know
        profile=cast('ProfileName', profile),
        local=cast('Local', local),
        master=cast('Master', master),
    )


def fused_frames(
    pipeline: Pipeline, recording: ImuRecording, imus: list[int]
) -> Iterator[FusedFrame]:
    """Push the samples in recorded order; `imus[j]` is the IMU in the rig of track j."""
    tracks = [track.samples for track in recording.tracks]
    readings = [zip(track.stamp_ns.tolist(), _readings(track), strict=True) for track in tracks]
    for track in with_progress(recording.order.tolist(), len(recording.order), 'Fusing'):
        stamp_ns, values = next(readings[track])
        yield from pipeline.push(imus[track], stamp_ns, values)


def _readings(samples: ImuSamples) -> Vector:
    return np.hstack([samples.angular_rate, samples.specific_force])


def write_fused(frames: Iterator[FusedFrame], path: Path, rig: Rig, storage: str) -> float:
    """Write the frames as a bag, which vanishes if that fails; return the share of still ones."""
    bag = BagWriter(path, storage)
    still: list[bool] = []
    block: list[FusedFrame] = []
    try:
        with bag:
            bag.add_topic('/imu/data', 'sensor_msgs/msg/Imu')
            bag.add_topic('/odom', 'nav_msgs/msg/Odometry')
            for frame in frames:
                block.append(frame)
                still.append(frame.still)
                if len(block) == BLOCK:
                    _write_block(bag, block, rig.rig.base_frame)
                    block.clear()
            _write_block(bag, block, rig.rig.base_frame)
    except BaseException:
        shutil.rmtree(path)
        raise
    return float(np.mean(still)) if still else float('nan')


def _write_block(bag: BagWriter, frames: list[FusedFrame], base_frame: str) -> None:
    finite = [frame for frame in frames if np.isfinite(frame.record).all()]  # as the nodes do
    if not finite:
        return
    column = {name: np.array([getattr(frame, name) for frame in finite]) for name in COLUMNS}
    stamp_ns = np.array([frame.stamp_ns for frame in finite])
    samples = ImuSamples(stamp_ns, column['angular_rate'], column['specific_force'])
    imus = encode_imus(
        base_frame,
        samples,
        rate_covariance=column['angular_rate_covariance'],
        force_covariance=column['specific_force_covariance'],
        orientation=column['orientation'],
        orientation_covariance=column['orientation_covariance'],
    )
    odometry = encode_odometry(
        ('odom', base_frame),
        samples.stamp_ns,
        (column['position_n'], column['odom_orientation'], column['pose_covariance']),
        (column['velocity_b'], column['angular_rate'], column['twist_covariance']),
    )
    for stamp_ns, imu, odom in zip(samples.stamp_ns.tolist(), imus, odometry, strict=True):
        bag.write('/imu/data', stamp_ns, imu)
        bag.write('/odom', stamp_ns, odom)


def _health(imu: ImuHealth) -> dict[str, Any]:
    """Return the state of one IMU: plain figures, and its gaps to the others under their names."""
    gaps = {name: gap._asdict() for name, gap in vars(imu.disagreement).items()}
    raised = ', '.join(name for name, gap in gaps.items() if gap['raised'])
    figures = {key: value for key, value in vars(imu).items() if key != 'disagreement'}
    return figures | {'recalibrate': raised, 'disagreement': gaps}


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
        'imus': [_health(imu) for imu in pipeline.health()],
    }
