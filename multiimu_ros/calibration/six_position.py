"""Calibration on a jig: the six-position test, thesis 4.1, with uncertainties.

The jig holds the IMU with each axis up and down, so the input of position k is known: +-a along
one axis, where a is gravity for the accelerometer and the turntable's rate for the gyroscope. An
axis that points up reads +g at rest, and +a on a table that turns counterclockwise seen from
above. The readings are raw = T true + B (4.1-4.2). Their least-squares fit over the six columns,

    [T|B] = U P A' (A P A')^-1,                                                        (4.4), (4.7)

with U (4.5) the readings and A (4.6) the inputs under a row of ones, takes P = 1, or weights of
each axis' six readings from their variances. The rig file has the inverse, true = T^-1 (raw - B).

A jig that places the IMU anew with a tilt t adds a t to the two axes across, far more than the
noise of the means. Where it is not given, its variance is what makes chi-squared equal its 6
degrees of freedom (Mandel and Paule [1]_); it enters weights and sigmas. What stays unseen, above
all a gyroscope's g-sensitivity, is in docs/derivations/registration_other_ways.md.

.. [1] R. C. Paule, J. Mandel, "Consensus values and weighting factors", J. Res. NBS 87(5), 1982.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, inv
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import as_matrix, as_vector, Matrix, Scalars, Vector, Vectors
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig import Triad

POSITIONS = ('+x', '-x', '+y', '-y', '+z', '-z')  # which axis points up, row by row
DEGREES_OF_FREEDOM = 6  # 18 readings, 12 parameters
EXACT = np.zeros((3, 3))
INPUTS = np.kron(np.eye(3), [[1.0], [-1.0]])  # (6, 3), in units of the reference
DESIGN = np.hstack([INPUTS, np.ones((6, 1))])  # A' of (4.6), likewise


@dataclass(frozen=True)
class SixPositionFit:
    """The sensor model of one triad, in the frame of the jig unless asked otherwise.

    Parameters
    ----------
    triad : Triad
        calibrated = misalignment @ (scale * (raw - bias)), with sigmas.
    residual_rms : float
        Root mean square of the 18 residuals, unweighted [unit of the readings].
    tilt_sigma : float
        Given or found; 0 where noise explains the residuals, NaN without variances [rad].
    R_js : Rotation
        From the frame of the calibrated triad to the jig's; the identity in general.
    rotation_covariance : (3, 3) array
        Of theta in R_js = R_hat exp(theta) [rad^2].
    """

    triad: Triad
    residual_rms: float
    tilt_sigma: float
    R_js: Rotation
    rotation_covariance: Matrix


def fit_two_position(
    up: Vector, down: Vector, reference: float, variances: Vectors | None = None
) -> Triad:
    """Fit bias and scale of each axis from two readings, taking the axes for aligned (4.3).

    Parameters
    ----------
    up, down : (3,) arrays
        What axis k reads while it points up, and down [m/s^2]; or while a turntable about it
        turns one way, and the other [rad/s].
    reference : float
        Gravity [m/s^2], or the turntable's rate [rad/s].
    variances : (2, 3) array, optional
        Of `up` and of `down`, squared units; without them there are no sigmas.
    """
    plus, minus = as_vector(up, 'up'), as_vector(down, 'down')
    _check_positive(reference, 'reference')
    for k, half in enumerate((plus - minus) / 2):
        if not half > reference / 2:
            msg = f'Axis {"xyz"[k]} reads {plus[k]:.4g} up and {minus[k]:.4g} down, which must be '
            msg += f'about {2 * reference:.4g} apart; check whether a position is upside down.'
            raise CalibrationError(msg)
    scale = 2 * reference / (plus - minus)
    found = {'bias': (plus + minus) / 2, 'scale': scale}
    if variances is not None:
        sigma = np.sqrt(as_matrix(variances, 'variances', (2, 3)).sum(axis=0)) / 2
        found |= {'bias_sigma': sigma, 'scale_sigma': scale**2 * sigma / reference}
    return Triad.model_validate(found)


def fit_accelerometer(
    readings: Vectors,
    gravity: float,
    variances: Vectors | None = None,
    *,
    tilt_sigma: float | None = None,
    upper_triangular: bool = False,
) -> SixPositionFit:
    """Fit an accelerometer from six rests.

    Parameters
    ----------
    readings : (6, 3) array
        Mean raw readings with +x, -x, +y, -y, +z, -z up, in this order [m/s^2].
    gravity : float
        Local gravity [m/s^2].
    variances : (6, 3) array, optional
        Of these means [m^2/s^4]: makes the fit weighted, (4.7) instead of (4.4).
    tilt_sigma : float, optional
        How far the jig tilts from placement to placement, per axis [rad]; needs `variances`.
        Found from the residuals by default: then sigmas are up to a half wide if it is small.
    upper_triangular : bool
        Whether to leave the jig's frame for the sensor's own, in which z is the sensor's z axis
        and x lies in the plane that makes the misalignment upper triangular; `R_js` leads back.

    Raises
    ------
    CalibrationError
        If a position is missing, repeated, upside down or tilted; names it.
    """
    choose = _own_frame if upper_triangular else _jig_frame
    return _finish(_fit(readings, gravity, variances, tilt_sigma), choose)


def fit_gyroscope(
    readings: Vectors,
    rate: float,
    variances: Vectors | None = None,
    *,
    tilt_sigma: float | None = None,
    accelerometer: SixPositionFit | None = None,
) -> SixPositionFit:
    """Fit a gyroscope from six steady turns.

    Parameters
    ----------
    readings : (6, 3) array
        Mean raw readings with +x, -x, +y, -y, +z, -z up, in this order [rad/s].
    rate : float
        The turntable's rate, counterclockwise from above, the earth's vertical rate added [rad/s].
    variances : (6, 3) array, optional
        Of these means [rad^2/s^2]: makes the fit weighted, (4.7) instead of (4.4).
    tilt_sigma : float, optional
        How far the jig tilts from placement to placement, per axis [rad]; needs `variances`.
        Found from the residuals by default: then sigmas are up to a half wide if it is small.
    accelerometer : SixPositionFit, optional
        In whose frame the rates are wanted; the jig's otherwise. The misalignment is full.

    Raises
    ------
    CalibrationError
        If a position is missing, repeated, turns the other way or is tilted; names it.
    """
    fit = _fit(readings, rate, variances, tilt_sigma)
    if accelerometer is None:
        return _finish(fit, _jig_frame)
    R_js, turn = accelerometer.R_js, accelerometer.rotation_covariance
    return _finish(fit, lambda linear: (R_js.inv().as_matrix() @ linear, R_js), turn)


@dataclass(frozen=True)
class _LinearFit:
    T: Matrix
    B: Vector
    covariance: Matrix  # (12, 12) of [T|B], row by row
    residual_rms: float
    tilt_sigma: float


def _fit(
    readings: Vectors, reference: float, variances: Vectors | None, tilt_sigma: float | None
) -> _LinearFit:
    U = as_matrix(readings, 'readings', (6, 3))
    _check_positive(reference, 'reference')
    _check_positions(U, reference)
    if variances is None:
        if tilt_sigma is not None:
            msg = '`tilt_sigma` needs `variances`, to be weighed against them.'
            raise ValueError(msg)
        solution, blocks = _solve(U, np.ones((6, 3)))
        blocks *= np.sum((U - DESIGN @ solution) ** 2) / DEGREES_OF_FREEDOM
        tilt = float('nan')
    else:
        noise = as_matrix(variances, 'variances', (6, 3))
        _check_positive(noise.min(), 'variances')
        tilt = _tilt_sigma(U, reference, noise) if tilt_sigma is None else tilt_sigma
        solution, blocks = _solve(U, 1 / _with_tilt(noise, reference * tilt))
    units = np.array([reference, reference, reference, 1.0])
    blocks /= np.outer(units, units)
    residual_rms = float(np.sqrt(np.mean((U - DESIGN @ solution) ** 2)))
    T, B = np.split((solution / units[:, np.newaxis]).T, [3], axis=1)
    return _LinearFit(T, B[:, 0], block_diag(*blocks), residual_rms, tilt)


def _solve(U: Vectors, weights: Vectors) -> tuple[Matrix, Matrix]:
    """Return (4.7) for each axis i with P = diag(weights[:, i]): (4, 3), and (A P A')^-1."""
    blocks = np.array([inv(DESIGN.T * w @ DESIGN) for w in weights.T])  # (3, 4, 4)
    return np.einsum('imn,kn,ki->mi', blocks, DESIGN, weights * U), blocks


def _with_tilt(noise: Vectors, sway: float) -> Vectors:
    """Add the variance of a tilt to those of the axes across the input (6, 3)."""
    return np.asarray(noise + sway**2 * (INPUTS == 0))


def _tilt_sigma(U: Vectors, reference: float, noise: Vectors) -> float:
    def excess(sway: float) -> float:
        weights = 1 / _with_tilt(noise, sway)
        residuals = U - DESIGN @ _solve(U, weights)[0]
        return float(np.sum(weights * residuals**2)) - DEGREES_OF_FREEDOM

    if excess(0.0) <= 0.0:
        return 0.0
    # With a sway as large as the reference no residual is surprising: positions are checked.
    return float(brentq(excess, 0.0, reference, xtol=1e-9 * reference)) / reference


def _check_positive(value: float, name: str) -> None:
    if not 0 < value < np.inf:
        msg = f'`{name}` must be positive and finite, got {value}.'
        raise ValueError(msg)


def _check_positions(U: Vectors, reference: float) -> None:
    for name in np.array(POSITIONS)[~np.isfinite(U).all(axis=1)]:
        msg = f'Position `{name}` is missing; record the IMU with {name} up.'
        raise CalibrationError(msg)
    # One or two wrong positions do not move the median of the six from the bias.
    scores = (U - np.median(U, axis=0)) @ INPUTS.T / reference  # (6, 6)
    shown = np.argmax(scores, axis=1)
    for k, face in enumerate(shown):
        others = np.delete(np.abs(scores[k]), [face, face ^ 1])
        if scores[k, face] < 0.5 or others.max() > 0.5:
            msg = f'Position `{POSITIONS[k]}` points no axis straight up, got {U[k].round(4)}; '
            msg += 'seat the IMU with its axes along the jig.'
            raise CalibrationError(msg)
    for k, face in enumerate(shown):
        if face != k:
            raise CalibrationError(_misplaced(k, int(face), repeated=shown[face] == face))


def _misplaced(k: int, face: int, *, repeated: bool) -> str:
    name, seen, order = POSITIONS[k], POSITIONS[face], ', '.join(POSITIONS)
    fault = f'repeats `{seen}`' if repeated else f'shows {seen}'
    if face == k ^ 1:
        fault = f'is upside down, or turned the other way: it shows {seen}'
    return f'Position `{name}` {fault}; record {name} up there, in the order {order}.'


def _jig_frame(linear: Matrix) -> tuple[Matrix, Rotation]:
    return linear, Rotation.identity()


def _own_frame(linear: Matrix) -> tuple[Matrix, Rotation]:
    """Split linear = Q C with C upper triangular and of positive diagonal."""
    Q, C = np.linalg.qr(linear)
    signs = np.sign(np.diag(C))
    return signs[:, np.newaxis] * C, Rotation.from_matrix(Q * signs)


def _finish(
    fit: _LinearFit,
    choose: Callable[[Matrix], tuple[Matrix, Rotation]],
    frame_covariance: Matrix = EXACT,
) -> SixPositionFit:
    """Invert raw = T true + B, choose a frame, and carry the covariance along."""
    R_js = choose(inv(fit.T))[1]

    def parameters(x: Scalars) -> Scalars:
        solution = x[:12].reshape(3, 4)
        linear, rotation = choose(inv(solution[:, :3]))
        linear = Rotation.from_rotvec(-x[12:]).as_matrix() @ linear
        scale = np.diag(linear)
        theta = (R_js.inv() * rotation).as_rotvec() + x[12:]
        return np.concatenate([(linear / scale).ravel(), scale, solution[:, 3], theta])

    at: Scalars = np.concatenate([np.column_stack([fit.T, fit.B]).ravel(), np.zeros(3)])
    J = _jacobian(parameters, at)
    covariance = J @ block_diag(fit.covariance, frame_covariance) @ J.T
    sigmas = _named(np.sqrt(np.diag(covariance)), '_sigma')
    triad = Triad.model_validate(_named(parameters(at), '') | sigmas)
    return SixPositionFit(triad, fit.residual_rms, fit.tilt_sigma, R_js, covariance[-3:, -3:])


def _named(values: Matrix, suffix: str) -> dict[str, object]:
    return {
        f'misalignment{suffix}': values[:9].reshape(3, 3).tolist(),
        f'scale{suffix}': values[9:12].tolist(),
        f'bias{suffix}': values[12:15].tolist(),
    }


def _jacobian(function: Callable[[Scalars], Scalars], at: Scalars, step: float = 1e-5) -> Matrix:
    """Return central differences; T is near 1, B enters linearly, so one step serves all."""
    steps: Matrix = step * np.eye(len(at), dtype=np.float64)
    return np.column_stack([(function(at + h) - function(at - h)) / (2 * step) for h in steps])
