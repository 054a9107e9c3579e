"""An accelerometer's intrinsics from static poses, without a turntable [1]_.

The accelerometer must read gravity in every pose, whatever the pose:

    min sum_k (|M S (f_k - b)| - g)^2,    M upper triangular: this defines the sensor frame.

Residuals are in [m/s^2] rather than squared as in print (TUM (2)), which weighs the poses alike.
`tedaldi_gyroscope` goes on from here; `rig_calibration.refinement` takes both, and all IMUs, as
one.

.. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU
   calibration without external equipments", ICRA 2014; TUM-I1976, 2.1; thesis 4.3 (4.8)-(4.10).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular
from scipy.optimize import least_squares

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.calibration.coverage import missing_poses, pose_jacobian
from multiimu_ros.calibration.poses import PoseReadings
from multiimu_ros.calibration.variance import fit_components, walk_covariance
from multiimu_ros.errors import CalibrationError

LEAST_POSES = 9  # for nine parameters
UPPER = (np.array([0, 0, 1]), np.array([1, 2, 2]))  # the free entries of M, row by row
FLATTEST = 1e-3  # smallest singular value of the poses' Jacobian, beside the largest


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
