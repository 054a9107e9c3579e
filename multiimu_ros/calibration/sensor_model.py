"""The sensor model of one IMU: an affine map of its six readings.

    f = M_a (s_a * (f_raw - b_a))
    w = M_g (s_g * (w_raw - b_g)) - G f

with misalignment M (unit diagonal), scale s, bias b and the gyroscope's g-sensitivity G (Tedaldi
[1]_; TUM report (1)-(4), where row 1 of M_w repeats beta_zx for beta_zy).  Both lines are one
affine map of [w_raw; f_raw], which is how the live path applies it.

.. [1] D. Tedaldi, A. Pretto, E. Menegatti, "A robust and easy to implement method for IMU
   calibration without external equipments", ICRA 2014.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.rig import Intrinsics, Triad
from multiimu_ros.samples import ImuSamples


def affine(intrinsics: Intrinsics | None) -> tuple[Matrix, Vector]:
    """Return the map from raw to calibrated readings; None means nominal, the identity.

    Returns
    -------
    A : (6, 6) array
    c : (6,) array
        [w; f]_calibrated = A @ [w; f]_raw + c, in [rad/s], [m/s^2].
    """
    model = Intrinsics() if intrinsics is None else intrinsics
    A = np.zeros((6, 6))
    A[:3, :3] = _linear(model.gyroscope)
    A[3:, 3:] = _linear(model.accelerometer)
    A[:3, 3:] = -np.array(model.gyroscope.g_sensitivity) @ A[3:, 3:]
    bias = np.array([*model.gyroscope.bias, *model.accelerometer.bias])
    return A, -A @ bias


def _linear(triad: Triad) -> Matrix:
    return np.array(triad.misalignment) @ np.diag(triad.scale)


def calibrate(samples: ImuSamples, intrinsics: Intrinsics | None) -> ImuSamples:
    """Apply the sensor model to a batch; NaN stays NaN."""
    A, c = affine(intrinsics)
    return apply_affine(samples, A, c)


def apply_affine(samples: ImuSamples, A: Matrix, c: Vector) -> ImuSamples:
    """Return the batch with every reading [w; f] mapped to A @ [w; f] + c."""
    # One product per output column sums in the order of the live path's A @ v.
    readings = np.hstack([samples.angular_rate, samples.specific_force]) @ A.T + c
    return ImuSamples(samples.stamp_ns, readings[:, :3], readings[:, 3:])
