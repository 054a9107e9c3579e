"""The rotation between two sets of vectors that were seen in two frames, in closed form.

Minimises sum_i w_i |a_i - R b_i|^2 over rotations (Wahba's problem; Kabsch's algorithm [1]_).
Gravity in several poses gives the rotation between accelerometers (thesis (6.2)), rates that
between gyroscopes (thesis (6.5), TUM report 2.2.2), corners of a board that of the board.

With S = sum_i w_i b_i (R' a_i)' the curvature of the cost is H = tr(S) I - S.  Noise in either
set is uncorrelated with the other, so it leaves H unbiased, while sum_i w_i b_i b_i' would grow
with the noise of b.  Residuals of variance s^2 / w_i per axis make the covariance s^2 H^-1; they
are taken for independent, so the caller thins or weighs down what is not.  Parallel vectors leave
the rotation about them free: that direction of H is zero, or no larger than noise.  Derivation:
docs/derivations/registration_other_ways.md.

.. [1] W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta
   Crystallographica A32(5), 1976.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import as_vectors, Matrix, Scalars, Vector, Vectors
from multiimu_ros.errors import CalibrationError

MIN_SPREAD = np.sin(np.deg2rad(3.0))  # below it, errors of scale pass for a turn
MIN_SIGNAL = 5.0  # by which H must stand out of what pure noise makes of it


@dataclass(frozen=True)
class RotationFit:
    """A rotation with a = R b, and how well it is known.

    Parameters
    ----------
    rotation : Rotation
        Maps vectors of set b into the frame of set a.
    covariance : (3, 3) array
        Of theta in R = R_hat exp(theta), a turn about the axes of b [rad^2].
    residual_rms : float
        Weighted root mean square of |a - R b| [unit of the vectors].
    """

    rotation: Rotation
    covariance: Matrix
    residual_rms: float

    @property
    def sigma(self) -> Vector:
        """Standard deviation (3,) about the axes of b [rad]."""
        return np.sqrt(np.diag(self.covariance))


def fit_rotation(
    vectors_a: Vectors, vectors_b: Vectors, weights: Scalars | None = None
) -> RotationFit:
    """Fit the rotation with vectors_a = R vectors_b.

    Parameters
    ----------
    vectors_a, vectors_b : (N, 3) arrays
        The same N vectors in frames a and b, in one unit.
    weights : (N,) array, optional
        Above zero, proportional to the inverse variance of each a - R b; equal by default.

    Raises
    ------
    CalibrationError
        If the vectors are nearly parallel, or fewer than two (names the axis), or if one set is
        the mirror image of the other.
    """
    a, b, w = _checked(vectors_a, vectors_b, weights)
    left, singular, right = np.linalg.svd((a * w[:, np.newaxis]).T @ b)
    if np.linalg.det(left) * np.linalg.det(right) < 0:
        _refuse_mirrored(singular, float(np.sum(w[:, np.newaxis] * (a**2 + b**2))), len(a))
        singular[2] *= -1
    largest, free = singular[0], singular[1] + singular[2]
    if len(a) < 2 or not free > MIN_SPREAD**2 * largest:
        raise CalibrationError(_parallel(right[0]))
    rotation, _ = Rotation.align_vectors(a, b, w)
    residuals = rotation.inv().apply(a) - b
    square = float(np.sum(w[:, np.newaxis] * residuals**2))
    variance = square / (3 * len(a) - 3)
    if free < MIN_SIGNAL * variance * np.sqrt(len(a)):
        raise CalibrationError(_parallel(right[0]))
    # In the frame of b, S = V diag(singular) V', so H^-1 has the same axes.
    covariance = variance * (right.T / (singular.sum() - singular)) @ right
    return RotationFit(rotation, covariance, float(np.sqrt(square / w.sum())))


def _checked(
    vectors_a: Vectors, vectors_b: Vectors, weights: Scalars | None
) -> tuple[Vectors, Vectors, Scalars]:
    a, b = as_vectors(vectors_a, 'vectors_a'), as_vectors(vectors_b, 'vectors_b')
    w = np.ones(len(a)) if weights is None else np.asarray(weights, dtype=np.float64)
    if not (len(a) == len(b) and w.shape == (len(a),)):
        msg = '`vectors_a`, `vectors_b` and `weights` must have one row for each vector, got '
        msg += f'{len(a)}, {len(b)} and {w.shape}.'
        raise ValueError(msg)
    if not (np.isfinite(a).all() and np.isfinite(b).all() and np.isfinite(w).all()):
        msg = '`vectors_a`, `vectors_b` and `weights` must be finite; drop what was not measured.'
        raise ValueError(msg)
    if not (w > 0).all():
        msg = f'`weights` must be positive, got {w.min()}.'
        raise ValueError(msg)
    return a, b, w


def _refuse_mirrored(singular: Vector, power: float, count: int) -> None:
    """Refuse sets whose third singular value, negative, stands out of the noise."""
    variance = (power - 2 * singular.sum()) / max(3 * count - 3, 1)
    if singular[2] > max(
        MIN_SPREAD**2 * singular[0], MIN_SIGNAL * max(variance, 0.0) * np.sqrt(count)
    ):
        msg = 'The vectors are mirror images of each other, so one frame is left-handed: check '
        msg += 'the sign and order of the axes of both sensors.'
        raise CalibrationError(msg)


def _parallel(axis: Vector) -> str:
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    components = ', '.join(f'{x:.2f}' for x in axis)
    return (
        f'The vectors are nearly parallel to [{components}] (nearest axis '
        f'{"xyz"[int(np.argmax(axis))]}), so the rotation about it stays unknown; record vectors '
        'in at least two clearly different directions.'
    )
