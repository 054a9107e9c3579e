"""Stage 4: how each IMU is turned against the first.

Gravity in the poses (thesis (6.2)) and the rate while moving (6.5) each give a rotation in closed
form; both carry what the intrinsics left unknown, which is no noise that averages out.  So each
covariance is that of the residuals plus the answers to every intrinsic parameter moved by its
sigma, and the two rotations are averaged with the inverse of these as weights.  What an error of
the accelerometers does to gravity it does to the gyroscopes too, whose axes were found by gravity:
that share is common to both rotations and does not average out.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, Scalars, Vector, Vectors
from multiimu_ros.calibration.static_intervals import StaticIntervals
from multiimu_ros.errors import CalibrationError
from multiimu_ros.registration.wahba import fit_rotation
from multiimu_ros.rig import Imu, Intrinsics, Triad
from multiimu_ros.rig_calibration.board import Board, pose_means
from multiimu_ros.rig_calibration.motion import CommonMotion, MOVING
from multiimu_ros.synchronization.delay import FREEDOM, MEDIAN_OF_THREE

LEAST_POSES = 3
FORGOTTEN = 3.2  # sigmas of the smoothing's kernel between rates that count as independent
LEAST_RATES = 50


@dataclass(frozen=True)
class Mounting:
    """Rotation of one IMU into the frame of the first, v_0 = R v_i.

    Parameters
    ----------
    R : (3, 3) array
    covariance : (3, 3) array
        Of a turn about the IMU's own axes [rad^2].
    disagreement : float
        Angle between what gravity says and what the rates say [rad]; NaN with one of them only.
    """

    R: Matrix
    covariance: Matrix
    disagreement: float


@dataclass(frozen=True)
class _Fit:
    """One rotation, and which part (3, 3) of its covariance (3, 3) the intrinsics make [rad^2]."""

    rotation: Rotation
    covariance: Matrix
    systematic: Matrix


def fit_mountings(
    board: Board, intervals: StaticIntervals, motion: CommonMotion
) -> tuple[Mounting, ...]:
    """Register every IMU to the first.

    Raises
    ------
    CalibrationError
        If neither poses nor motion tell how an IMU is turned.
    """
    forces = [pose_means(board.calibrated(k), intervals) for k in range(len(board.tracks))]
    rates = motion.smoothed()[:, :, :3]
    apart = int(np.ceil(FORGOTTEN * motion.grid.sigma / motion.grid.step))
    mountings = [Mounting(np.eye(3), np.zeros((3, 3)), float('nan'))]
    for k in range(1, len(board.tracks)):
        imus = board.rig.imus[0], board.rig.imus[k]
        fits = [
            fit
            for fit in (
                _from_gravity(forces[0], forces[k], imus),
                _from_rates(rates[:, 0], rates[:, k], imus, apart),
            )
            if fit is not None
        ]
        if not fits:
            msg = (
                f'Nothing tells how `{imus[1].name}` is turned against `{imus[0].name}`; record '
                f'three or more poses, or turn the board about two axes.'
            )
            raise CalibrationError(msg)
        mountings.append(_averaged(fits))
    return tuple(mountings)


def _averaged(fits: list[_Fit]) -> Mounting:
    """Return the mean of rotations near each other, weighted by their information."""
    anchor = fits[0].rotation
    turns = [(anchor.inv() * fit.rotation).as_rotvec() for fit in fits]
    information = [np.linalg.inv(fit.covariance) for fit in fits]
    covariance = np.linalg.inv(np.sum(information, axis=0))
    share = [covariance @ one for one in information]
    mean = np.sum([w @ turn for w, turn in zip(share, turns, strict=True)], axis=0)
    apart = float('nan')
    if len(fits) > 1:
        apart = float(np.linalg.norm(turns[-1]))
        common = share[0] @ fits[0].systematic @ share[1].T
        covariance = covariance + common + common.T
    return Mounting((anchor * Rotation.from_rotvec(mean)).as_matrix(), covariance, apart)


def _from_gravity(first: Vectors, own: Vectors, imus: tuple[Imu, Imu]) -> _Fit | None:
    both = np.isfinite(first).all(axis=1) & np.isfinite(own).all(axis=1)
    if both.sum() < LEAST_POSES:
        return None
    return _fit(first[both], own[both], None, imus, 'accelerometer')


def _from_rates(first: Vectors, own: Vectors, imus: tuple[Imu, Imu], apart: int) -> _Fit | None:
    known: Flags = np.asarray(np.isfinite(first).all(axis=1) & np.isfinite(own).all(axis=1))
    turning = known & (np.linalg.norm(np.where(known[:, None], first, 0.0), axis=1) > MOVING)
    chosen = np.flatnonzero(turning)[::apart]
    if len(chosen) < LEAST_RATES:
        return None
    a, b = first[chosen], own[chosen]
    weights = np.ones(len(a))
    for _ in range(3):
        R, _ = Rotation.align_vectors(a, b, weights)
        weights = _robust(np.square(a - R.apply(b)).sum(axis=1))
    return _fit(a, b, weights, imus, 'gyroscope')


def _robust(square: Scalars) -> Scalars:
    """Return weights (n,) that a few bad samples, as at the end of the range, cannot dominate."""
    scale = max(float(np.median(square)) / MEDIAN_OF_THREE, 1e-300)
    return (FREEDOM + 3) / (FREEDOM + square / scale)


def _fit(
    a: Vectors, b: Vectors, weights: Scalars | None, imus: tuple[Imu, Imu], triad: str
) -> _Fit | None:
    try:
        fit = fit_rotation(a, b, weights)
    except CalibrationError:  # parallel vectors: the other kind may still tell
        return None
    systematic = np.zeros((3, 3))
    for imu, first in zip(imus, (True, False), strict=True):
        known = getattr(imu.intrinsics or Intrinsics(), triad)
        for D, d in error_modes(known):
            moved = (a + a @ D.T + d, b) if first else (a, b + b @ D.T + d)
            R, _ = Rotation.align_vectors(*moved, weights)
            turn = (fit.rotation.inv() * R).as_rotvec()
            systematic += np.outer(turn, turn)
    return _Fit(fit.rotation, fit.covariance + systematic, systematic)


def error_modes(triad: Triad) -> Iterator[tuple[Matrix, Vector]]:
    """Yield what each parameter, off by its sigma, adds to a calibrated reading v: D v + d."""
    M, s = np.array(triad.misalignment), np.array(triad.scale)
    inverse = np.linalg.inv(M * s)
    zero = np.zeros(3)
    for j, sigma in enumerate(triad.scale_sigma or zero):
        dE = np.zeros((3, 3))
        dE[:, j] = M[:, j] * sigma
        yield dE @ inverse, zero
    for (i, j), sigma in np.ndenumerate(np.array(triad.misalignment_sigma or np.zeros((3, 3)))):
        if sigma > 0.0:
            dE = np.zeros((3, 3))
            dE[i, j] = s[j] * sigma
            yield dE @ inverse, zero
    for j, sigma in enumerate(triad.bias_sigma or zero):
        yield np.zeros((3, 3)), -(M * s)[:, j] * sigma
