"""Figures as people read them."""

import numpy as np
from numpy.typing import ArrayLike

from multiimu_ros.arrays import Matrix, Vector

DIGITS = 4


def as_text(values: ArrayLike, digits: int = DIGITS) -> str:
    """Return numbers with some digits, and with no exponent unless they are tiny."""
    return ' '.join(_number(x, digits) for x in np.atleast_1d(np.asarray(values)).tolist())


def _number(x: float, digits: int) -> str:
    size = abs(x)
    if not np.isfinite(x):
        return 'unknown'
    if size < 1e-3:
        return f'{x:.{digits}g}'
    decimals = max(0, digits - 1 - int(np.floor(np.log10(size))))
    return f'{x:.{decimals}f}'


def roll_pitch_yaw(R: Matrix) -> Vector:
    """Return the angles (3,) of R = Rz(yaw) Ry(pitch) Rx(roll) [deg]; no yaw if x is upright."""
    level = np.hypot(R[0, 0], R[1, 0])
    if level < 1e-9:
        roll, yaw = np.arctan2(-R[1, 2], R[1, 1]), 0.0
    else:
        roll, yaw = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    return np.rad2deg([roll, np.arctan2(-R[2, 0], level), yaw])
