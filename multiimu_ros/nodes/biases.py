"""The biases that the filters found, put back into the rig file."""

from datetime import datetime, UTC
from typing import Any

import numpy as np

from multiimu_ros.arrays import Vector, Vectors
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import Imu, Intrinsics, Rig


def with_biases(rig: Rig, biases: Vectors, variances: Vectors, now_s: float) -> Rig:
    """Return the rig with each IMU's bias corrected.

    Calibrated readings are A @ (raw - b); to take a bias d off them, b grows by A^-1 d.

    Parameters
    ----------
    rig : Rig
        As the pipeline was built with.
    biases, variances : (K, 6) arrays
        What is left of the bias of rate and force, in the base frame, and its variance.
    now_s : float
        Instant that the provenance shall name [s since 1970].
    """
    imus = zip(rig.imus, biases, variances, strict=True)
    date = datetime.fromtimestamp(now_s, UTC).isoformat(timespec='seconds')
    corrected = tuple(_corrected(imu, d, v, date) for imu, d, v in imus)
    return rig.model_copy(update={'imus': corrected})


def _corrected(imu: Imu, bias_b: Vector, variance_b: Vector, date: str) -> Imu:
    R = mounting(imu)[0]
    to_raw = np.linalg.inv(affine(imu.intrinsics)[0]) @ R.T
    change = to_raw @ bias_b
    sigma = np.sqrt(np.square(to_raw) @ variance_b)
    intrinsics = imu.intrinsics or Intrinsics()
    triads: dict[str, Any] = {}
    for name, part in (('gyroscope', slice(0, 3)), ('accelerometer', slice(3, 6))):
        triad = getattr(intrinsics, name)
        update = {
            'bias': tuple((np.array(triad.bias) + change[part]).tolist()),
            'bias_sigma': tuple(sigma[part].tolist()),
        }
        triads[name] = triad.model_copy(update=update)
    return imu.model_copy(
        update={
            'intrinsics': intrinsics.model_copy(update=triads),
            'provenance': imu.provenance | {'biases_saved': date},
        }
    )
