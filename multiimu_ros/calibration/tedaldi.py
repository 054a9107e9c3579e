"""Intrinsics from static poses and the moves between them, without a turntable [1]_.

The accelerometer must read gravity in every pose, whatever the pose:

    min sum_k (|M S (f_k - b)| - g)^2,    M upper triangular: this defines the sensor frame,

the gyroscope, integrated over each move, must turn the gravity of one pose into that of the next:

    min sum_k |u_k+1 - R_k(E, b, G)' u_k|^2,    all of E = M S in the accelerometer's frame.

Bias and g-sensitivity of the gyroscope are read off the poses, where the true rate is zero:
raw = b + E^-1 G f.  Residuals are in [m/s^2] and [rad] rather than squared as in print (TUM (2)),
which weighs the poses alike.  `refinement` then takes both fits, and all IMUs, as one.

.. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU
   calibration without external equipments", ICRA 2014; TUM-I1976, 2.1; thesis 4.3 (4.8)-(4.10).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import least_squares

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.calibration.coverage import missing_poses, pose_jacobian
from multiimu_ros.calibration.poses import PoseReadings, Transition
from multiimu_ros.calibration.preintegration import preintegrate
from multiimu_ros.calibration.variance import fit_components, walk_covariance
from multiimu_ros.errors import CalibrationError

LEAST_POSES = 9  # for nine parameters
LEAST_MOVES = 5  # two equations each for nine parameters
UPPER = (np.array([0, 0, 1]), np.array([1, 2, 2]))  # the free entries of M, row by row
FLATTEST = 1e-3  # smallest singular value of the poses' Jacobian, beside the largest
WEAKEST = 1e-5  # smallest eigenvalue of the moves' information, beside the largest


@dataclass(frozen=True)
class AccelerometerModel:
    """What the poses say about an accelerometer; f = M diag(scale) (raw - bias).

    Parameters
    ----------
    scale, shear, bias : (3,) arrays
        [m/s^2 per reading], M_01, M_02, M_12 [rad], [reading].
    covariance : (9, 9) array
        Of scale, shear, bias in that order.
    residual, drift : (P,) arrays
        |f| - g of each pose, and what of it a walking bias explains [m/s^2].
    pose_variance, walk : float
        What poses disagree by beyond white noise [(m/s^2)^2], and how fast the bias walks
        [(m/s^2)^2/s].
    """

    scale: Vector
    shear: Vector
    bias: Vector
    covariance: Matrix
    residual: Scalars
    drift: Scalars
    pose_variance: float
    walk: float

    @property
    def E(self) -> Matrix:  # noqa: D102 see the class
        M = np.eye(3)
        M[UPPER] = self.shear
        return np.asarray(M * self.scale)

    def apply(self, raw: Vectors) -> Vectors:
        """Return the calibrated specific force (N, 3) [m/s^2] of raw readings (N, 3)."""
        return np.asarray((raw - self.bias) @ self.E.T)


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


def fit_accelerometer(
    poses: PoseReadings, gravity: float, start: tuple[float, float] = (1.0, 0.0)
) -> AccelerometerModel:
    """Fit nine parameters to the means of P poses (all finite).

    Parameters
    ----------
    poses : PoseReadings
        Of one IMU.
    gravity : float
        Local gravity [m/s^2].
    start : (float, float)
        Scale [m/s^2 per reading] and bias [reading] to begin with, alike for all axes; the
        defaults are those of readings in SI at nominal scale.

    Raises
    ------
    CalibrationError
        If the poses cannot determine a parameter; names the poses that are missing.
    """
    raw = poses.specific_force
    up = (raw - start[1]) / np.linalg.norm(raw - start[1], axis=1, keepdims=True).clip(1e-300)
    if len(raw) < LEAST_POSES:
        msg = (
            f'Nine accelerometer parameters need at least {LEAST_POSES} still poses, got '
            f'{len(raw)}; {_advice(up)}.'
        )
        raise CalibrationError(msg)
    _refuse_flat(up)
    theta = _fit_norms(raw, gravity, _unit(gravity, start[0]), start, None)
    J = _slope_of_norm(theta, raw)
    residual = np.linalg.norm(_felt(theta, raw), axis=1) - gravity
    V, drift, components = _weigh(poses, J, residual, theta)
    L = cholesky(V, lower=True)
    theta = _fit_norms(raw, gravity, _unit(gravity, start[0]), theta, L)
    A = solve_triangular(L, _slope_of_norm(theta, raw), lower=True)
    residual = np.asarray(np.linalg.norm(_felt(theta, raw), axis=1) - gravity)
    return AccelerometerModel(
        theta[:3],
        theta[3:6],
        theta[6:],
        np.asarray(np.linalg.inv(A.T @ A)),
        residual,
        np.asarray(drift @ cho_solve((L, True), residual)),
        *components,
    )


def predicted_spread(
    raw: Vectors, gravity: float, start: tuple[float, float] = (1.0, 0.0)
) -> float:
    """Return the log of what a fit to these poses (P, 3) would leave unknown of a parameter.

    Half the mean log eigenvalue of the covariance that the residuals imply, for comparing choices
    of poses; infinite where nine parameters are too many.
    """
    if len(raw) <= LEAST_POSES:
        return float('inf')
    theta = _fit_norms(raw, gravity, _unit(gravity, start[0]), start, None)
    J = _slope_of_norm(theta, raw) * _unit(gravity, start[0])
    square = np.sum((np.linalg.norm(_felt(theta, raw), axis=1) - gravity) ** 2)
    sign, logarithm = np.linalg.slogdet(J.T @ J)
    if sign <= 0:
        return float('inf')
    return float(0.5 * np.log(square / (len(raw) - 9)) - logarithm / 18)


def _unit(gravity: float, scale: float) -> Vector:
    """Return the sizes (9,) of scale, shear, bias that change |f| alike."""
    return np.asarray(np.r_[np.full(3, scale), np.ones(3), np.full(3, gravity / scale)])


def _fit_norms(
    raw: Vectors,
    gravity: float,
    unit: Vector,
    start: Vector | tuple[float, float],
    L: Matrix | None,
) -> Vector:
    """Return scale, shear, bias (9,) with |f| closest to gravity, by Levenberg-Marquardt."""
    begin = np.asarray(start)
    if len(begin) == 2:
        begin = np.r_[np.full(3, begin[0]), np.zeros(3), np.full(3, begin[1])]

    def whiten(rows: Matrix) -> Matrix:
        return np.asarray(rows if L is None else solve_triangular(L, rows, lower=True))

    def residual(x: Vector) -> Vector:
        return whiten(np.linalg.norm(_felt(x * unit, raw), axis=1) - gravity)

    def slope(x: Vector) -> Matrix:
        return whiten(_slope_of_norm(x * unit, raw) * unit)

    fit = least_squares(
        residual, begin / unit, slope, method='lm', x_scale='jac', xtol=1e-12, max_nfev=2000
    )
    return np.asarray(fit.x * unit)


def _felt(theta: Vector, raw: Vectors) -> Vectors:
    """Return the specific force (P, 3) under scale, shear, bias (9,)."""
    f = (raw - theta[6:]) * theta[:3]
    return np.column_stack(
        (f[:, 0] + theta[3] * f[:, 1] + theta[4] * f[:, 2], f[:, 1] + theta[5] * f[:, 2], f[:, 2])
    )


def _slope_of_norm(theta: Vector, raw: Vectors) -> Matrix:
    """Return the derivative (P, 9) of |f| with respect to scale, shear, bias."""
    f = _felt(theta, raw)
    u = f / np.linalg.norm(f, axis=1, keepdims=True)
    M = np.eye(3)
    M[UPPER] = theta[3:6]
    back = u @ M  # per axis: what a change of s (raw - b) changes |f| by
    centred = raw - theta[6:]
    scaled = centred * theta[:3]
    shear = np.column_stack(
        (u[:, 0] * scaled[:, 1], u[:, 0] * scaled[:, 2], u[:, 1] * scaled[:, 2])
    )
    return np.hstack((back * centred, shear, -back * theta[:3]))


def _refuse_flat(up: Vectors) -> None:
    """Refuse poses under which some mix of the parameters hardly changes |f|."""
    values = np.linalg.svd(pose_jacobian(up, 1.0), compute_uv=False)
    if not values[-1] > FLATTEST * values[0]:
        msg = f'The {len(up)} still poses are too much alike for an accelerometer; {_advice(up)}.'
        raise CalibrationError(msg)


def _advice(up: Vectors) -> str:
    missing = missing_poses(up[up.any(axis=1)])  # a dead sensor has no direction
    return f'record it lying still with {", ".join(missing[:6])}' if missing else 'record more'


def _weigh(
    poses: PoseReadings, J: Matrix, residual: Vector, theta: Vector
) -> tuple[Matrix, Matrix, tuple[float, float]]:
    """Return the covariance (P, P) of the residuals, that of the drift in it, and components."""
    f = _felt(theta, poses.specific_force)
    u = f / np.linalg.norm(f, axis=1, keepdims=True)
    density = poses.force_density * theta[:3]
    white = np.square(u) @ np.square(density) / poses.duration
    kernels = [np.eye(len(u)), walk_covariance(poses.time) * (u @ u.T)]
    pose_variance, walk = fit_components(residual[np.newaxis], J, white[np.newaxis], kernels)
    drift = walk * kernels[1]
    return np.diag(white + pose_variance) + drift, drift, (float(pose_variance), float(walk))


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
