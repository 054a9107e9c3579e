"""Stage 2: rests, then Tedaldi's fits of every IMU, then the joint refinement."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vectors
from multiimu_ros.calibration.poses import find_transitions, PoseReadings, read_poses
from multiimu_ros.calibration.preintegration import preintegrate
from multiimu_ros.calibration.static_intervals import (
    board_ratio,
    find_intervals,
    StaticConfig,
    StaticIntervals,
    THRESHOLDS,
)
from multiimu_ros.calibration.tedaldi import (
    AccelerometerModel,
    fit_accelerometer,
    predicted_spread,
)
from multiimu_ros.calibration.tedaldi_gyroscope import fit_gyroscope, fit_rest_rate, GyroscopeModel
from multiimu_ros.errors import CalibrationError
from multiimu_ros.registration.wahba import fit_rotation
from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.rig_calibration.imu_state import ImuState, ImuView, Weights
from multiimu_ros.rig_calibration.intrinsics_block import as_intrinsics
from multiimu_ros.rig_calibration.refinement import first_attitudes, refine, Refined

PLAUSIBLE = (0.5, 2.0)  # scale of a reading in SI at nominal scale
STRANGE = 0.2  # [rad] of gravity after a turn: the worst real boards reach 0.04
NEGLIGIBLE = 0.1  # of a sigma: no reason for a looser threshold
Progress = Callable[[str], None]


@dataclass(frozen=True)
class ImuFit:
    """Tedaldi's fits of one IMU, and what its refinement begins with."""

    accelerometer: AccelerometerModel
    gyroscope: GyroscopeModel
    view: ImuView
    state: ImuState
    weights: Weights
    R_k: Matrix


@dataclass(frozen=True)
class IntrinsicsFit:
    """What the stage found of one IMU.

    Parameters
    ----------
    poses : PoseReadings
        Raw means of the P rests.
    fit : ImuFit
        Tedaldi's two fits.
    state : ImuState
        After refinement.
    covariance : (33, 33) array
        Of its parameters; see `measurements`.
    turn_residual : (T,) array
        Angle between the gravity that each move predicts and the one measured [rad].
    residual_before, residual_after : (P,) arrays
        |f| - g of the nominal and of the calibrated readings [m/s^2].
    chi_square : float
        Weighted squared residual per degree of freedom [-].
    """

    poses: PoseReadings
    fit: ImuFit
    state: ImuState
    covariance: Matrix
    turn_residual: Scalars
    residual_before: Scalars
    residual_after: Scalars
    chi_square: float


def find_rests(board: Board) -> StaticIntervals:
    """Scan the thresholds of the detector; keep the strictest whose poses tell most (Tedaldi).

    Raises
    ------
    CalibrationError
        If the board never rests.
    """
    config, samples = StaticConfig(), [track.samples for track in board.tracks]
    stamp_ns, ratio = board_ratio(samples, config)
    candidates = [find_intervals(stamp_ns, ratio, threshold, config) for threshold in THRESHOLDS]
    scores = [_spread(board, intervals) for intervals in candidates]
    if np.isfinite(scores).any():
        # A looser threshold lets the rests reach into the moves, which the gyroscope resents.
        return candidates[int(np.argmax(scores <= np.min(scores) + NEGLIGIBLE))]
    most = max(candidates, key=len)
    if not len(most):
        msg = (
            f'The board never rests for {config.shortest_s:g} s, so nothing can be calibrated; '
            f'lay it down in 20 or more different poses for 3 s each.'
        )
        raise CalibrationError(msg)
    return most


def _spread(board: Board, intervals: StaticIntervals) -> float:
    """Return what a fit to these rests would leave unknown, mean of the IMUs."""
    scores = []
    for track in board.tracks:
        poses = read_poses(track.samples, intervals)
        scores.append(predicted_spread(poses.specific_force[poses.known], board.gravity))
    return float(np.mean(scores))


def fit_imu(board: Board, imu: int, intervals: StaticIntervals) -> ImuFit:
    """Fit accelerometer and gyroscope of one IMU by Tedaldi's method.

    Raises
    ------
    CalibrationError
        If its poses or moves cannot determine a parameter, or the units are wrong.
    """
    name, track = board.rig.imus[imu].name, board.tracks[imu]
    samples = track.samples
    poses = read_poses(samples, intervals)
    known = poses.known
    time = track.seconds_since(int(samples.stamp_ns[0]))
    try:
        accelerometer = fit_accelerometer(poses.select(known), board.gravity)
        force = accelerometer.apply(poses.specific_force)
        rest = fit_rest_rate(poses.select(known), force[known])
        moves = find_transitions(samples, intervals, track.usable, known)
        up = force / np.linalg.norm(force, axis=1, keepdims=True)
        felt = accelerometer.apply(samples.specific_force)
        gyroscope = fit_gyroscope(time, samples.angular_rate, felt, up, moves, rest)
    except CalibrationError as error:
        msg = f'`{name}`: {error}'
        raise CalibrationError(msg) from error
    _refuse_scale(name, gyroscope.E)
    _refuse_strangers(name, gyroscope)
    view = ImuView(poses, moves, time, samples.angular_rate, samples.specific_force)
    turns, _ = preintegrate(
        time, samples.angular_rate, felt, moves, (gyroscope.E, gyroscope.bias, gyroscope.G)
    )
    chain = [(move.start, move.stop, R) for move, R in zip(moves, turns, strict=True)]
    scale = float(np.mean(accelerometer.scale)) ** 2
    weights = Weights(
        (accelerometer.pose_variance / scale, accelerometer.walk / scale),
        (gyroscope.pose_variance, gyroscope.walk),
    )
    state = ImuState.of(accelerometer, gyroscope, np.eye(3))
    return ImuFit(accelerometer, gyroscope, view, state, weights, first_attitudes(up, chain))


def _refuse_scale(name: str, E: Matrix) -> None:
    scale = float(np.cbrt(abs(np.linalg.det(E))))
    if PLAUSIBLE[0] < scale < PLAUSIBLE[1]:
        return
    likely = 'deg/s' if 0.8 < scale * 180 / np.pi < 1.25 else 'another unit'
    msg = (
        f'`{name}` turned {scale:.3g} times what its rates say: they look like {likely}, and must '
        f'be rad/s; convert them in the driver and record again.'
    )
    raise CalibrationError(msg)


def _refuse_strangers(name: str, gyroscope: GyroscopeModel) -> None:
    """Refuse a gyroscope that turns another way than gravity, or about other axes.

    In the mirror a turn about x stays, those about y and z change sign: the diagonal tells.
    """
    off = float(np.sqrt(np.mean(np.square(gyroscope.residual))))
    if np.diag(gyroscope.E).min() > PLAUSIBLE[0] and off < STRANGE:
        return
    msg = (
        f'`{name}`: its rates do not carry gravity from pose to pose; check that the axes of '
        f'gyroscope and accelerometer have the same order and signs, and that both were alive.'
    )
    raise CalibrationError(msg)


def fit_intrinsics(
    board: Board, intervals: StaticIntervals, *, joint: bool = False, tell: Progress = print
) -> tuple[Board, tuple[IntrinsicsFit, ...], Refined | None]:
    """Calibrate every IMU: alone, or all in one fit.

    Parameters
    ----------
    intervals : StaticIntervals
        The rests.
    joint : bool
        Let all IMUs feel the same gravity and make the same moves.
    tell : callable
        Told the name of each step that begins.

    Returns
    -------
    Board
        With intrinsics and their sigmas.
    tuple of IntrinsicsFit
    Refined or None
        The joint fit, whose states hold the mutual rotations.
    """
    fits = []
    for k, imu in enumerate(board.rig.imus):
        tell(f'intrinsics of {imu.name}')
        fits.append(fit_imu(board, k, intervals))
    if joint:
        tell('all IMUs in one fit')
        together = _refine_together(fits, board.gravity)
        found = [
            _outcome(board, fit, together.states[k], together.covariance_of(k), together)
            for k, fit in enumerate(fits)
        ]
    else:
        together, found = None, []
        for fit, imu in zip(fits, board.rig.imus, strict=True):
            tell(f'refinement of {imu.name}')
            alone = refine([fit.view], [fit.state], [fit.weights], fit.R_k, board.gravity)
            found.append(_outcome(board, fit, alone.states[0], alone.covariance, alone))
    imus = [
        imu.model_copy(update={'intrinsics': as_intrinsics(one.state, one.covariance)})
        for imu, one in zip(board.rig.imus, found, strict=True)
    ]
    return board.with_imus(imus), tuple(found), together


def _refine_together(fits: Sequence[ImuFit], gravity: float) -> Refined:
    up = [fit.accelerometer.apply(fit.view.poses.specific_force) for fit in fits]
    states = [fits[0].state]
    for fit, own in zip(fits[1:], up[1:], strict=True):
        both = np.isfinite(own).all(axis=1) & np.isfinite(up[0]).all(axis=1)
        R = fit_rotation(up[0][both], own[both]).rotation.as_matrix()
        states.append(ImuState.of(fit.accelerometer, fit.gyroscope, R))
    views, weights = [fit.view for fit in fits], [fit.weights for fit in fits]
    return refine(views, states, weights, fits[0].R_k, gravity)


def _outcome(
    board: Board, fit: ImuFit, state: ImuState, covariance: Matrix, refined: Refined
) -> IntrinsicsFit:
    poses = fit.view.poses
    felt = (poses.specific_force - state.force_bias) @ state.E_a.T
    raw = np.linalg.norm(poses.specific_force, axis=1)
    return IntrinsicsFit(
        poses,
        fit,
        state,
        covariance,
        _turn_residual(fit.view, state, felt),
        raw - board.gravity,
        np.linalg.norm(felt, axis=1) - board.gravity,
        refined.chi_square,
    )


def _turn_residual(view: ImuView, state: ImuState, felt: Vectors) -> Scalars:
    """Return the angle (T,) between predicted and measured gravity after each move [rad]."""
    force = (view.raw_force - state.force_bias) @ state.E_a.T
    gyroscope = state.E, state.rate_bias, state.G
    turns, _ = preintegrate(view.time, view.raw_rate, force, view.transitions, gyroscope)
    up = felt / np.linalg.norm(felt, axis=1, keepdims=True)
    before = up[[move.start for move in view.transitions]]
    after = up[[move.stop for move in view.transitions]]
    predicted = np.einsum('tji,tj->ti', turns, before)
    across = np.linalg.norm(np.cross(predicted, after), axis=1)
    return np.asarray(np.arctan2(across, np.einsum('ti,ti->t', predicted, after)))
