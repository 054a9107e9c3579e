"""Bring calibrated readings into the rig's frame and time.

Rotation and time offset are applied here, sample by sample; the lever arm needs the rate and the
angular acceleration of the whole rig, so the fusion stage takes it out.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, NANOSECONDS
from multiimu_ros.calibration.sensor_model import apply_affine
from multiimu_ros.rig import Extrinsics, Imu
from multiimu_ros.samples import ImuSamples


def mounting(imu: Imu) -> tuple[Matrix, int]:
    """Return what registration does to a reading of this IMU.

    Returns
    -------
    A : (6, 6) array
        [w; f]_b = A @ [w; f]_s, the mounting rotation R_bs on both.
    offset_ns : int
        Added to the stamp [ns].
    """
    extrinsics = Extrinsics() if imu.extrinsics is None else imu.extrinsics
    A = np.asarray(np.kron(np.eye(2), extrinsics.R_bs), dtype=np.float64)
    return A, round(imu.time_offset * NANOSECONDS)


def register(samples: ImuSamples, imu: Imu) -> ImuSamples:
    """Rotate a batch into the base frame and put it on the rig's time."""
    A, offset_ns = mounting(imu)
    turned = apply_affine(samples, A, np.zeros(6))
    return ImuSamples(turned.stamp_ns + offset_ns, turned.angular_rate, turned.specific_force)
