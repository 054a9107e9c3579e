"""`multiimu register`: where the IMUs sit and how they are turned, without their intrinsics.

From the bag that `calibrate` takes, alone or with the poses of a tracker's target; from a
pointer's measurements of the boards' corners; or from a drawing.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from multiimu_ros.arrays import Vector
from multiimu_ros.bags import find_imu_topics, list_topics, read_imus
from multiimu_ros.calibration.cleaning import clean
from multiimu_ros.calibration.sensor_model import calibrate
from multiimu_ros.cli.calibrate import finish, refuse_unwritable
from multiimu_ros.cli.calibration_run import run_calibration
from multiimu_ros.cli.options import AsJson, OptionsFile, print_json, print_table, split_names
from multiimu_ros.errors import ConfigError
from multiimu_ros.registration.cad import load_cad
from multiimu_ros.registration.pose_file import load_poses
from multiimu_ros.registration.tip import fit_tip, load_tip
from multiimu_ros.registration.tracker import fit_tracker, TrackerFit
from multiimu_ros.rig import Extrinsics, load_rig, Rig, save_rig
from multiimu_ros.rig_calibration.wording import as_text, roll_pitch_yaw

STAGES = ('time', 'rotation', 'lever_arm')

app = typer.Typer(add_completion=False)


@app.command(epilog='Example: `multiimu register waved/ --rig ring8.yaml -o ring8.yaml`')
def register(
    rig: Annotated[Path, typer.Option(help='Rig file, whose intrinsics are used.')],
    output: Annotated[Path, typer.Option('--output', '-o', help='Rig file to write.')],
    bag: Annotated[Path | None, typer.Argument(help='rosbag2 folder, .mcap or .db3 file.')] = None,
    topics: Annotated[
        list[str], typer.Option(help='Topics of imu0, imu1 ...; default: `<imu>/data_raw`.')
    ] = [],  # noqa: B006 typer copies it
    tip: Annotated[
        Path | None, typer.Option(help='Corner points by a pointer (YAML), instead of a bag.')
    ] = None,
    cad: Annotated[Path | None, typer.Option(help='Drawn poses (YAML), instead of a bag.')] = None,
    tracker: Annotated[
        Path | None,
        typer.Option(help='Poses of a target on the board (CSV), beside the bag: its base frame.'),
    ] = None,
    report: Annotated[Path | None, typer.Option(help='Folder for calibration.html.')] = None,
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Find rotations, lever arms and delays of the IMUs, keeping everything else of the rig."""
    board = load_rig(rig)
    if sum(way is not None for way in (bag, tip, cad)) != 1:
        msg = 'One of BAG, `--tip` and `--cad` must say where the IMUs are; give just one of them.'
        raise ConfigError(msg)
    refuse_unwritable(output, report)
    if tracker is not None:
        _refuse_lone_tracker(bag, report)
        fits = _from_tracker(board, bag or Path(), split_names(topics), tracker)
        placed = {name: fit.extrinsics for name, fit in fits.items()}
        save_rig(_placed(_timed(board, fits), placed, 'tracker'), output)
        _print(placed, [], output, as_json=as_json)
        return
    if bag is not None:
        run = run_calibration(bag, board, list_topics(bag), split_names(topics), STAGES)
        finish(run, output, report, as_json=as_json)
        return
    if report is not None:
        msg = '`--report` must go with a BAG, as nothing else leaves something to plot; drop it.'
        raise ConfigError(msg)
    poses, warnings = _from_tip(board, tip) if tip is not None else (load_cad(cad or Path()), [])
    save_rig(_placed(board, poses, 'pointer' if tip is not None else 'drawing'), output)
    _print(poses, warnings, output, as_json=as_json)


def _refuse_lone_tracker(bag: Path | None, report: Path | None) -> None:
    if bag is None or report is not None:
        msg = '`--tracker` must come with the BAG recorded meanwhile, and without `--report`.'
        raise ConfigError(msg)


def _from_tracker(board: Rig, bag: Path, topics: list[str], path: Path) -> dict[str, TrackerFit]:
    """Return the pose of every IMU that was recorded, in the frame of the target."""
    found = find_imu_topics(list_topics(bag), board.names, topics)
    tracks = read_imus(bag, list(found.values())).tracks
    samples = {
        board.imus[k].name: calibrate(clean(track.samples).samples, board.imus[k].intrinsics)
        for k, track in zip(found, tracks, strict=True)
    }
    return fit_tracker(load_poses(path), samples)


def _timed(board: Rig, fits: dict[str, TrackerFit]) -> Rig:
    """Return the rig with the IMUs' delays against the first that was recorded."""
    first = next(iter(fits.values()))
    zero = {imu.name: imu.time_offset for imu in board.imus}[next(iter(fits))]
    imus = [
        imu.model_copy(
            update={
                'time_offset': zero + fits[imu.name].time_offset - first.time_offset,
                'time_offset_sigma': float(
                    np.hypot(fits[imu.name].time_offset_sigma, first.time_offset_sigma)
                ),
            }
        )
        if imu.name in fits and fits[imu.name] is not first
        else imu
        for imu in board.imus
    ]
    return board.model_copy(update={'imus': tuple(imus)})


def _from_tip(board: Rig, path: Path) -> tuple[dict[str, Extrinsics], list[str]]:
    """Return the poses in the base frame: the pointer tells them relative to the main IMU."""
    survey = load_tip(path)
    fit = fit_tip(survey)
    main = {imu.name: imu.extrinsics or Extrinsics() for imu in board.imus}.get(survey.main)
    if main is None:
        msg = (
            f'{path}: `main` must be one of {", ".join(board.names)}, the IMUs of the rig, got '
            f'`{survey.main}`; correct it.'
        )
        raise ConfigError(msg)
    poses = {name: _composed(main, pose) for name, pose in fit.extrinsics.items()}
    warnings = [
        f'{name}: its corners look alike when turned, so only gravity would tell a mix-up; '
        f'compare with `multiimu register BAG`.'
        for name in fit.symmetric
    ]
    return poses, warnings


def _composed(main: Extrinsics, own: Extrinsics) -> Extrinsics:
    """Return a pose told in the main IMU's frame, in the base frame."""
    from scipy.spatial.transform import Rotation  # noqa: PLC0415 half a second, rarely needed

    turn = Rotation.from_quat(main.rotation) * Rotation.from_quat(own.rotation)
    arm = main.lever_arm_b + main.R_bs @ own.lever_arm_b
    update = {'rotation': tuple(turn.as_quat().tolist()), 'lever_arm': tuple(arm.tolist())}
    return own.model_copy(update=update)


def _placed(board: Rig, poses: dict[str, Extrinsics], way: str) -> Rig:
    unknown = sorted(poses.keys() - set(board.names))
    if unknown:
        known = ', '.join(board.names)
        msg = f'`{unknown[0]}` must be one of {known}, the IMUs of the rig; correct its name.'
        raise ConfigError(msg)
    imus = [
        imu.model_copy(
            update={
                'extrinsics': poses[imu.name],
                'provenance': imu.provenance | {'extrinsics': way},
            }
        )
        if imu.name in poses
        else imu
        for imu in board.imus
    ]
    return board.model_copy(update={'imus': tuple(imus)})


def _rounded(values: Vector) -> str:
    return ' '.join(f'{x:.2f}' for x in np.round(values, 2) + 0.0)  # which has no -0.00


def _print(
    poses: dict[str, Extrinsics], warnings: list[str], output: Path, *, as_json: bool
) -> None:
    if as_json:
        dumped = {n: p.model_dump(mode='json', exclude_none=True) for n, p in poses.items()}
        print_json({'extrinsics': dumped, 'warnings': warnings})
        return
    rows = [
        {
            'imu': name,
            'roll, pitch, yaw [deg]': _rounded(roll_pitch_yaw(pose.R_bs)),
            'lever arm [mm]': _rounded(1e3 * pose.lever_arm_b),
            'sigma [mm]': as_text(1e3 * np.array(pose.lever_arm_sigma), 2)
            if pose.lever_arm_sigma
            else 'not stated',
        }
        for name, pose in poses.items()
    ]
    print_table('Poses in the base frame', rows)
    for warning in warnings:
        typer.echo(warning)
    typer.echo(f'Rig file: {output}')
