"""A gyroscope's intrinsics from static poses and the moves between them, without a turntable [1]_.

Integrated over each move, it must turn the gravity of one pose into that of the next:

    min sum_k |u_k+1 - R_k(E, b, G)' u_k|^2,    all of E = M S in the accelerometer's frame.

Bias and g-sensitivity are read off the poses, where the true rate is zero: raw = b + E^-1 G f.

.. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU
   calibration without external equipments", ICRA 2014; TUM-I1976, 2.1; thesis 4.3 (4.8)-(4.10).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.calibration.poses import PoseReadings, Transition
from multiimu_ros.calibration.preintegration import preintegrate
from multiimu_ros.calibration.variance import fit_components, walk_covariance
from multiimu_ros.errors import CalibrationError

LEAST_MOVES = 5  # two equations each for nine parameters
WEAKEST = 1e-5  # smallest eigenvalue of the moves' information, beside the largest


@dataclass(frozen=True)
class GyroscopeModel:
    """What poses and moves say about a gyroscope; w = E (raw - bias) - G f.

    Parameters
    ----------
    E : (3, 3) array
        Misalignment times scale [rad/s per reading].
    bias : (3,) array
        [reading].
    G : (3, 3) array
        g-sensitivity [rad/s per m/s^2].
    residual : (T,) array
        Angle between the gravity that each move predicts and the one that was measured [rad].
    pose_variance, walk : float
        As those of the accelerometer, in raw readings.
    """

    E: Matrix
    bias: Vector
    G: Matrix
    residual: Scalars
    pose_variance: float
    walk: float


def fit_rest_rate(
    poses: PoseReadings, force: Vectors, with_g_sensitivity: bool = True
) -> tuple[Vector, Matrix, float, float]:
    """Read bias and g-sensitivity of a gyroscope off the poses.

    Parameters
    ----------
    poses : PoseReadings
        Raw means of P poses.
    force : (P, 3) array
        Calibrated specific force of the poses [m/s^2].
    with_g_sensitivity : bool
        False takes it as zero.

    Returns
    -------
    bias : (3,) array
        [reading].
    H : (3, 3) array
        E^-1 G: reading per specific force [reading per m/s^2].
    pose_variance, walk : float
        Variance components [reading^2], [reading^2/s].
    """
    ones = np.ones((len(force), 1))
    A = np.hstack((ones, force)) if with_g_sensitivity else ones
    white = np.square(poses.rate_density) / poses.duration[:, np.newaxis]
    kernels = [np.eye(len(force)), walk_covariance(poses.time)]
    residuals = poses.angular_rate - A @ np.linalg.lstsq(A, poses.angular_rate, rcond=None)[0]
    pose_variance, walk = fit_components(residuals.T, A, white.T, kernels)
    shared = pose_variance * kernels[0] + walk * kernels[1]
    theta = np.stack(
        [
            _solve_weighted(A, poses.angular_rate[:, axis], np.diag(white[:, axis]) + shared)
            for axis in range(3)
        ]
    )
    H = theta[:, 1:] if with_g_sensitivity else np.zeros((3, 3))
    return theta[:, 0], H, float(pose_variance), float(walk)


def _solve_weighted(A: Matrix, y: Vector, V: Matrix) -> Vector:
    L = cholesky(V, lower=True)
    whitened = solve_triangular(L, np.column_stack((A, y)), lower=True)
    return np.asarray(np.linalg.lstsq(whitened[:, :-1], whitened[:, -1], rcond=None)[0])


def fit_gyroscope(
    time: Scalars,
    raw: Vectors,
    force: Vectors,
    up: Vectors,
    transitions: Sequence[Transition],
    rest: tuple[Vector, Matrix, float, float],
    scale: float = 1.0,
) -> GyroscopeModel:
    """Fit nine parameters to the moves between poses.

    Parameters
    ----------
    time, raw, force : (N,), (N, 3), (N, 3) arrays
        Instants [s], raw angular rate, and calibrated specific force [m/s^2].
    up : (P, 3) array
        Direction of the calibrated specific force in each pose [-].
    transitions : sequence of Transition
        The moves.
    rest : tuple
        What `fit_rest_rate` found.
    scale : float
        To begin with [rad/s per reading]; it may be far off.

    Raises
    ------
    CalibrationError
        If the moves cannot determine a parameter; names the axis to turn about.
    """
    bias, H, pose_variance, walk = rest
    before = up[[t.start for t in transitions]]
    after = up[[t.stop for t in transitions]]

    def turn(x: Vector) -> tuple[Vector, Matrix]:
        E = scale * x.reshape(3, 3)
        R, J = preintegrate(time, raw, force, transitions, (E, bias, E @ H))
        predicted = np.einsum('tji,tj->ti', R, before)  # u_end = R' u_begin
        # A turn by theta more at the end moves u_end by u_end x theta; E changes G along.
        along = J[:, :, :9] + np.einsum('tajk,ck->tajc', J[:, :, 12:].reshape(-1, 3, 3, 3), H
                                        ).reshape(-1, 3, 9)  # fmt: skip
        by_E = np.cross(predicted[:, :, None], along, axis=1) * scale
        return (predicted - after).ravel(), by_E.reshape(-1, 9)

    def misfit(x: Vector) -> Vector:
        return turn(x)[0]

    def slope(x: Vector) -> Matrix:
        return turn(x)[1]

    _refuse_few_turns(len(transitions))
    start = np.eye(3).ravel()
    fit = least_squares(misfit, start, jac=slope, method='lm', xtol=1e-12)
    J = np.asarray(fit.jac)
    values, vectors = np.linalg.eigh(J.T @ J)
    if values[0] < WEAKEST * values[-1]:
        axis = 'xyz'[int(np.argmax(np.linalg.norm(vectors[:, 0].reshape(3, 3), axis=0)))]
        msg = (
            f'The moves between the poses leave the gyroscope undetermined about {axis}; '
            f'turn the board by 90 degrees or more about its {axis} axis, lying sideways, too.'
        )
        raise CalibrationError(msg)
    E = scale * fit.x.reshape(3, 3)
    angle = np.linalg.norm(fit.fun.reshape(-1, 3), axis=1)
    return GyroscopeModel(E, bias, E @ H, angle, pose_variance, walk)


def _refuse_few_turns(count: int) -> None:
    if count < LEAST_MOVES:
        msg = (
            f'Nine gyroscope parameters need at least {LEAST_MOVES} unbroken moves between poses, '
            f'got {count}; turn the board more slowly, and record without gaps.'
        )
        raise CalibrationError(msg)
