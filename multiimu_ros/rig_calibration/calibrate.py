"""One recording to one rig: the stages in their order.

    clocks, roughly -> rests -> intrinsics -> clocks, finely -> rotations -> lever arms, noise

Each stage adds to the rig what it found and leaves the rest as it was, so that one of them can be
repeated alone.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vector
from multiimu_ros.calibration.static_intervals import StaticIntervals
from multiimu_ros.errors import CalibrationError, ConfigError
from multiimu_ros.rig import Noise, PerTriad, Rig
from multiimu_ros.rig_calibration.board import Board, pose_means, take_board
from multiimu_ros.rig_calibration.imu_state import ROTATION
from multiimu_ros.rig_calibration.intrinsics_stage import (
    find_rests,
    fit_intrinsics,
    IntrinsicsFit,
)
from multiimu_ros.rig_calibration.lever_arm_stage import (
    as_extrinsics,
    fit_positions,
    LeverArmFit,
)
from multiimu_ros.rig_calibration.motion import common_motion
from multiimu_ros.rig_calibration.refinement import Refined
from multiimu_ros.rig_calibration.rotation_stage import fit_mountings, Mounting
from multiimu_ros.rig_calibration.time_stage import (
    align_coarsely,
    align_finely,
    Alignment,
    apply_offsets,
)
from multiimu_ros.samples import ImuSamples

STAGES = ('time', 'intrinsics', 'rotation', 'lever_arm', 'noise')
LEAST_DENSITY = 1e-9


@dataclass(frozen=True)
class Calibration:
    """All that a calibration found, for the rig file, the report and the verdicts.

    Parameters
    ----------
    before, after : Rig
        The rig that went in, and the one that comes out.
    board : Board
        The recording, cleaned, on one clock.
    intervals : StaticIntervals
        The rests.
    alignments : tuple of Alignment or None
        Per IMU; empty if the stage was not run.
    intrinsics : tuple of IntrinsicsFit
        Likewise.
    mountings : tuple of Mounting
        Likewise.
    lever_arms : LeverArmFit or None
    spread_before, spread_after : float
        Rms distance of the IMUs' mean forces in the rests from their common mean [m/s^2].
    notes : tuple of str
        What was noticed on the way, for the user.
    """

    before: Rig
    after: Rig
    board: Board
    intervals: StaticIntervals
    alignments: tuple[Alignment | None, ...] = ()
    intrinsics: tuple[IntrinsicsFit, ...] = ()
    mountings: tuple[Mounting, ...] = ()
    lever_arms: LeverArmFit | None = None
    spread_before: float = float('nan')
    spread_after: float = float('nan')
    notes: tuple[str, ...] = ()


def calibrate_rig(
    rig: Rig,
    samples: Sequence[ImuSamples],
    *,
    stages: Sequence[str] = STAGES,
    joint: bool = False,
    tell: Callable[[str], None] = lambda _: None,
) -> Calibration:
    """Calibrate the IMUs of one board from one recording.

    Parameters
    ----------
    rig : Rig
        What is known beforehand: gravity, drawn poses, or an earlier calibration.
    samples : sequence of K ImuSamples
        Raw readings, in the order of the rig's IMUs.
    stages : sequence of str
        Which of `STAGES` to run; the others keep what the rig says.
    joint : bool
        One fit of all IMUs' intrinsics and rotations.
    tell : callable
        Told the name of each step that begins.

    Raises
    ------
    CalibrationError
        If the recording cannot determine what was asked for.
    ConfigError
        If a stage is unknown.
    """
    unknown = sorted(set(stages) - set(STAGES))
    if unknown:
        msg = f'`only` must be one of {", ".join(STAGES)}, got `{unknown[0]}`.'
        raise ConfigError(msg)
    board = take_board(rig, samples)
    several = len(board.tracks) > 1
    alignments: tuple[Alignment | None, ...] = ()
    if several and 'time' in stages:
        tell('clocks, roughly')
        board, alignments = align_coarsely(board)
    else:
        board = apply_offsets(board)
    tell('rests')
    intervals = find_rests(board)
    intrinsics: tuple[IntrinsicsFit, ...] = ()
    refined: Refined | None = None
    if 'intrinsics' in stages:
        board, intrinsics, refined = fit_intrinsics(board, intervals, joint=joint, tell=tell)
    if alignments:
        tell('clocks, finely')
        board, alignments = align_finely(board, alignments)
    mountings: tuple[Mounting, ...] = ()
    lever_arms: LeverArmFit | None = None
    notes: list[str] = []
    if several and {'rotation', 'lever_arm'} & set(stages):
        tell('rotations and lever arms')
        board, mountings, lever_arms, notes = _place(board, intervals, stages, refined)
    if 'noise' in stages:
        board = _with_noise(board, intervals, keep_allan=len(stages) > 1)
    return Calibration(
        rig,
        board.rig,
        board,
        intervals,
        alignments,
        intrinsics,
        mountings,
        lever_arms,
        spread(Board(rig, board.tracks), intervals),
        spread(board, intervals),
        tuple(notes),
    )


def _place(
    board: Board, intervals: StaticIntervals, stages: Sequence[str], refined: Refined | None
) -> tuple[Board, tuple[Mounting, ...], LeverArmFit | None, list[str]]:
    motion = common_motion(board)
    if 'rotation' in stages:
        mountings = fit_mountings(board, intervals, motion)
        if refined is not None:
            mountings = _joint_mountings(refined, mountings)
    else:
        mountings = _known_mountings(board.rig)
    lever_arms, notes = None, []
    if 'lever_arm' in stages:
        try:
            lever_arms = fit_positions(board, mountings, motion)
        except CalibrationError as error:
            if set(stages) == {'lever_arm'}:
                raise
            notes.append(str(error))
    poses = as_extrinsics(board.rig, mountings, lever_arms)
    imus = [
        imu.model_copy(update={'extrinsics': pose})
        for imu, pose in zip(board.rig.imus, poses, strict=True)
    ]
    return board.with_imus(imus), mountings, lever_arms, notes


def _joint_mountings(refined: Refined, single: Sequence[Mounting]) -> tuple[Mounting, ...]:
    """Return the rotations of the joint fit; the disagreement stays that of the single fits."""
    return tuple(
        Mounting(state.R, refined.covariance_of(k)[ROTATION, ROTATION], one.disagreement)
        for k, (state, one) in enumerate(zip(refined.states, single, strict=True))
    )


def _known_mountings(rig: Rig) -> tuple[Mounting, ...]:
    missing = [imu.name for imu in rig.imus if imu.extrinsics is None]
    if missing:
        msg = f'The rig must say how `{missing[0]}` is mounted; fit `rotation`, too.'
        raise CalibrationError(msg)
    poses = [imu.extrinsics for imu in rig.imus if imu.extrinsics is not None]
    first = poses[0].R_bs.T
    return tuple(
        Mounting(first @ pose.R_bs, np.diag(np.square(pose.rotation_sigma or np.zeros(3))),
                 float('nan'))
        for pose in poses
    )  # fmt: skip


def _with_noise(board: Board, intervals: StaticIntervals, *, keep_allan: bool) -> Board:
    """Give every IMU the noise density that its scatter within the rests shows.

    What `multiimu allan` found of a longer record stays, unless the noise alone is asked for.
    """
    imus = []
    for k, imu in enumerate(board.rig.imus):
        if keep_allan and imu.noise is not None and 'noise' in imu.provenance:
            imus.append(imu)
            continue
        density, sigma = _rest_density(board.calibrated(k), intervals)
        update = {'noise_density': _per_triad(density), 'noise_density_sigma': _per_triad(sigma)}
        noise = imu.noise.model_copy(update=update) if imu.noise else Noise.model_validate(update)
        imus.append(imu.model_copy(update={'noise': noise}))
    return board.with_imus(imus)


def _rest_density(samples: ImuSamples, intervals: StaticIntervals) -> tuple[Vector, Vector]:
    """Return the density (6,) that one sample's scatter in the rests has, and its sigma."""
    readings = np.hstack([samples.angular_rate, samples.specific_force])
    square, freedom = np.zeros(6), 0
    for begin_ns, end_ns in zip(intervals.begin_ns, intervals.end_ns, strict=True):
        inside = slice(*np.searchsorted(samples.stamp_ns, [begin_ns, end_ns]))
        part = readings[inside]
        if len(part) > 2:
            square += np.square(part - part.mean(axis=0)).sum(axis=0)
            freedom += len(part) - 1
    density = np.sqrt(square / max(freedom, 1) / samples.rate_hz).clip(LEAST_DENSITY)
    sigma = density / np.sqrt(2 * max(freedom, 1))
    return density, sigma


def _per_triad(six: Vector) -> PerTriad:
    return PerTriad.model_validate(
        {'gyroscope': six[:3].tolist(), 'accelerometer': six[3:].tolist()}
    )


def spread(board: Board, intervals: StaticIntervals) -> float:
    """Return the rms distance of the IMUs' mean forces in the rests from their mean [m/s^2].

    The longer a rest, the more it counts: in a short one the noise of the means stands out.
    """
    apart = spread_per_imu(board, intervals)
    return rest_rms(np.sqrt(np.square(apart).mean(axis=1)), intervals.duration_s)


def rest_rms(values: Scalars, duration: Scalars) -> float:
    """Return the root mean square of values in P rests (P,), weighted by how long they last."""
    known = np.isfinite(values)
    if not known.any():
        return float('nan')
    return float(np.sqrt(np.average(np.square(values[known]), weights=duration[known])))


def spread_per_imu(board: Board, intervals: StaticIntervals) -> Matrix:
    """Return the distance of each IMU's mean force from that of all, in each rest (P, K)."""
    forces = []
    for k, imu in enumerate(board.rig.imus):
        R_bs = np.eye(3) if imu.extrinsics is None else imu.extrinsics.R_bs
        forces.append(pose_means(board.calibrated(k), intervals) @ R_bs.T)
    stacked = np.stack(forces, axis=1)
    return np.asarray(np.linalg.norm(stacked - stacked.mean(axis=1, keepdims=True), axis=2))
