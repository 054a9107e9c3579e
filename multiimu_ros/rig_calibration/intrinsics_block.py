"""The parameters of the joint fit as the block of a rig file."""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.calibration.tedaldi import UPPER
from multiimu_ros.rig import GyroscopeTriad, Intrinsics, Table, Triad
from multiimu_ros.rig_calibration.imu_state import (
    FORCE_BIAS,
    ImuState,
    RATE_BIAS,
    RATE_E,
    SCALE,
    SENSITIVITY,
    SHEAR,
    UNKNOWNS,
)


def as_intrinsics(state: ImuState, covariance: Matrix) -> Intrinsics:
    """Return the block of a rig file, with sigmas; E of the gyroscope becomes M diag(scale)."""
    sigma = np.sqrt(np.diag(covariance)[:UNKNOWNS])
    upper = np.zeros((3, 3))
    upper[UPPER] = sigma[SHEAR]
    scale = np.diag(state.E)
    M = state.E / scale
    # M_ij = E_ij / E_jj: to first order its variance is that of E_ij, as M_ij is small.
    crossed = sigma[RATE_E].reshape(3, 3) / np.abs(scale)
    np.fill_diagonal(crossed, 0.0)
    accelerometer = Triad(
        misalignment=_table(state.M_a),
        misalignment_sigma=_table(upper),
        scale=_triple(state.scale),
        scale_sigma=_triple(sigma[SCALE]),
        bias=_triple(state.force_bias),
        bias_sigma=_triple(sigma[FORCE_BIAS]),
    )
    gyroscope = GyroscopeTriad(
        misalignment=_table(M),
        misalignment_sigma=_table(crossed),
        scale=_triple(scale),
        scale_sigma=_triple(np.diag(sigma[RATE_E].reshape(3, 3))),
        bias=_triple(state.rate_bias),
        bias_sigma=_triple(sigma[RATE_BIAS]),
        g_sensitivity=_table(state.G),
        g_sensitivity_sigma=_table(sigma[SENSITIVITY].reshape(3, 3)),
    )
    return Intrinsics(accelerometer=accelerometer, gyroscope=gyroscope)


def _triple(values: Vector) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def _table(matrix: Matrix) -> Table:
    x, y, z = (_triple(row) for row in matrix)
    return x, y, z
