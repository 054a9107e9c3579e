"""Stage 5: where each IMU sits, and the base frame that all of it is told in."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.errors import CalibrationError
from multiimu_ros.registration.lever_arms import (
    fit_lever_arms,
    lever_arm_matrices,
    LeverArms,
    weakest_axis,
)
from multiimu_ros.rig import Extrinsics, Rig
from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.rig_calibration.motion import CommonMotion, MOVING
from multiimu_ros.rig_calibration.rotation_stage import Mounting
from multiimu_ros.synchronization.resampling import smooth

LEAST_S = 3.0  # of motion


@dataclass(frozen=True)
class LeverArmFit:
    """What the stage found.

    Parameters
    ----------
    arms : LeverArms
        In the frame of the first IMU.
    excitation : (3,) array
        Eigenvalues of the mean of L'L, ascending [1/s^4].
    weakest : (3,) array
        Axis, in the frame of the first IMU, along which lever arms are known worst.
    moving_s : float
        How much motion all IMUs saw [s].
    """

    arms: LeverArms
    excitation: Scalars
    weakest: Vector
    moving_s: float


def fit_positions(
    board: Board, mountings: Sequence[Mounting], motion: CommonMotion
) -> LeverArmFit:
    """Fit the lever arms of all IMUs relative to the first.

    Raises
    ------
    CalibrationError
        If there is too little motion that all IMUs saw.
    """
    R = np.stack([mounting.R for mounting in mountings])
    registered = np.einsum('kij,nkcj->nkci', R, motion.readings.reshape(-1, len(R), 2, 3))
    rate = registered[:, :, 0].mean(axis=1)
    products = smooth(np.einsum('ni,nj->nij', rate, rate), motion.grid)
    acceleration = smooth(rate, motion.grid, order=1)
    force = smooth(registered[:, :, 1], motion.grid)
    known = np.isfinite(rate).all(axis=1) & np.isfinite(force).all(axis=(1, 2))
    turning = known & (np.trace(products, axis1=1, axis2=2) > MOVING**2)
    moving_s = float(turning.sum() * motion.grid.step)
    if moving_s < LEAST_S:
        msg = (
            f'Lever arms need at least {LEAST_S:g} s of motion that all IMUs saw, got '
            f'{moving_s:.1f} s; wave the board about for a minute.'
        )
        raise CalibrationError(msg)
    L = lever_arm_matrices(products[turning], acceleration[turning])
    arms = fit_lever_arms(force[turning], L, motion.second()[turning], _drawn(board.rig, R))
    values, axes = weakest_axis(L)
    return LeverArmFit(arms, values, axes[:, 0], moving_s)


def _drawn(rig: Rig, R: Matrix) -> Vectors | None:
    """Return what the rig file says of the lever arms (K, 3), in the frame of the first IMU."""
    if any(imu.extrinsics is None for imu in rig.imus):
        return None
    poses = [imu.extrinsics for imu in rig.imus if imu.extrinsics is not None]
    turn = base_rotation(poses, R)
    arms = np.stack([pose.lever_arm_b for pose in poses])
    return np.asarray((arms - arms[0]) @ turn)


def base_rotation(poses: Sequence[Extrinsics], R: Matrix) -> Matrix:
    """Return the rotation (3, 3) from the first IMU's frame into the base that suits all best.

    Minimises sum |R_drawn,k - R_base R_k|^2 over the IMUs: errors of single mountings average out.
    """
    total = np.sum([pose.R_bs @ own.T for pose, own in zip(poses, R, strict=True)], axis=0)
    left, _, right = np.linalg.svd(total)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def as_extrinsics(
    rig: Rig, mountings: Sequence[Mounting], found: LeverArmFit | None
) -> tuple[Extrinsics, ...]:
    """Return the poses in the base frame.

    The base frame stays where the rig file's poses put it, as well as all IMUs together tell;
    without poses it is the frame of the first IMU.  Lever arms stay where `found` is None.
    """
    R = np.stack([mounting.R for mounting in mountings])
    drawn = [imu.extrinsics or Extrinsics() for imu in rig.imus]
    placed = all(imu.extrinsics is not None for imu in rig.imus)
    turn = base_rotation(drawn, R) if placed else np.eye(3)
    if found is None:
        arms = np.stack([pose.lever_arm_b for pose in drawn])
        sigma = [pose.lever_arm_sigma for pose in drawn]
    else:
        arms = found.arms.position @ turn.T
        if placed:
            arms += np.mean([pose.lever_arm_b for pose in drawn] - arms, axis=0)
        turned = np.einsum('ij,kjl,ml->kim', turn, found.arms.covariance, turn)
        roots = np.sqrt(np.diagonal(turned, axis1=1, axis2=2))
        sigma = [tuple(row) for row in roots.tolist()]
    return tuple(
        Extrinsics(
            rotation=tuple(Rotation.from_matrix(turn @ mounting.R).as_quat().tolist()),
            rotation_sigma=tuple(np.sqrt(np.diag(mounting.covariance)).tolist()),
            lever_arm=tuple(arm.tolist()),
            lever_arm_sigma=spread,
        )
        for mounting, arm, spread in zip(mountings, arms, sigma, strict=True)
    )
