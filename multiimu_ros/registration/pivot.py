"""Pivot calibration: where the tip of a tracked pointer is, from turning it about that tip.

While the tip rests in a dimple at c, the pointer's body is seen at (R_k, p_k), and

    p_k + R_k t = c    for all k,                                                          (1)

is linear in the tip t (body frame) and c. With the mean rotation M = mean(R_k), eliminating c
leaves the information N (I - M'M) on t: nothing along an axis that all the turns share.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import as_vectors, Matrix, Vector, Vectors
from multiimu_ros.errors import CalibrationError

MIN_TURN = np.sin(np.deg2rad(3.0))  # of the body about every axis, rms: below it, noise is the tip


@dataclass(frozen=True)
class PivotFit:
    """The tip of a pointer.

    Parameters
    ----------
    tip : (3,) array
        In the frame of the pointer's body [m].
    covariance : (3, 3) array
        Of `tip` [m^2].
    pivot : (3,) array
        Where it rested, in the tracker's frame [m].
    point_sigma : float
        Of one coordinate of the tip as one pose gives it [m]: a `pointer_sigma` for `TipSurvey`.
    """

    tip: Vector
    covariance: Matrix
    pivot: Vector
    point_sigma: float

    @property
    def sigma(self) -> Vector:
        """Standard deviation (3,) of the tip [m]."""
        return np.sqrt(np.diag(self.covariance))


def fit_pivot(rotations: Rotation, positions: Vectors) -> PivotFit:
    """Fit the tip of a pointer that turns about it.

    Parameters
    ----------
    rotations : Rotation of N
        Map the body's vectors into the tracker's frame.
    positions : (N, 3) array
        Of the body in the tracker's frame [m]; a pose that was not seen is left out or NaN.

    Raises
    ------
    CalibrationError
        If the pointer turns too little about some axis; names the part of the tip lost by it.
    """
    p = as_vectors(positions, 'positions')
    if len(rotations) != len(p):
        msg = f'`rotations` must have one for each of {len(p)} positions, got {len(rotations)}.'
        raise ValueError(msg)
    seen = np.isfinite(p).all(axis=1)
    p, R = p[seen], rotations.as_matrix()[seen]
    if len(p) < 3:
        msg = f'A pivot calibration needs 3 poses or more, got {len(p)}; turn the pointer further.'
        raise CalibrationError(msg)
    mean = R.mean(axis=0)
    turned, axes = np.linalg.eigh(np.eye(3) - mean.T @ mean)
    if turned[0] < MIN_TURN**2:
        lost = ', '.join(f'{x:.2f}' for x in axes[:, 0] * np.sign(axes[:, 0].sum()))
        msg = f'The pointer hardly turns across [{lost}] of its body, so the tip along it stays '
        msg += 'unknown; swing the pointer by 30 degrees and more in all directions.'
        raise CalibrationError(msg)
    information = len(p) * np.eye(3) - len(p) * mean.T @ mean
    moments = np.einsum('nji,nj->i', R - mean, p - p.mean(axis=0))
    tip = -np.linalg.solve(information, moments)
    tips = p + R @ tip
    pivot = tips.mean(axis=0)
    variance = float(np.sum((tips - pivot) ** 2)) / (3 * len(p) - 6)
    covariance = variance * np.asarray(np.linalg.inv(information), dtype=np.float64)
    return PivotFit(tip, covariance, pivot, float(np.sqrt(variance)))
