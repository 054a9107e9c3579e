"""The gyro biases that a rest taught the filter, put back into the rig file.

At rest the rate is zero, so the attitude filter sees the bias of the fused rate, and the fusion
stage what each IMU reads beside it.  The bias of an accelerometer cannot be told from tilt and
scale in one pose: it stays as the calibration left it, and so does its sigma.
"""

import math
from typing import Any

import numpy as np

from multiimu_ros.arrays import NANOSECONDS, Vector, Vectors
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion.age import LAST_REST, SAVED, utc_text
from multiimu_ros.pipeline import Rest
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import Imu, Intrinsics, Rig

SOURCE, REST_S = 'biases_source', 'biases_rest_s'  # keys of the provenance


def with_biases(rig: Rig, biases: Vectors, variances: Vectors, rest: Rest, now_s: float) -> Rig:
    """Return the rig with the gyro bias of each IMU that rested corrected.

    Calibrated readings are A @ (raw - b); to take a bias d off them, b grows by A^-1 d.

    Parameters
    ----------
    rig : Rig
        As the pipeline was built with.
    biases, variances : (K, 6) arrays
        What is left of the bias of rate and force, in the base frame, and its variance; NaN for
        an IMU that has not rested.
    rest : Rest
        What they were learnt from.
    now_s : float
        Instant that the provenance shall name [s since 1970].

    Raises
    ------
    ConfigError
        If the rig has not rested.
    """
    known = np.asarray(np.isfinite(biases[:, :3]).all(axis=1))
    if not (rest.seconds > 0.0 and known.any()):
        msg = (
            'The biases are not known before the rig has rested; lay it down for a few seconds '
            'and call `save_biases` again.'
        )
        raise ConfigError(msg)
    history = {
        SAVED: utc_text(math.floor(now_s) * NANOSECONDS),
        SOURCE: 'attitude filter at rest, gyroscope only',
        REST_S: round(rest.seconds, 2),
        LAST_REST: utc_text(rest.last_ns),
    }
    corrected = tuple(
        _corrected(imu, bias[:3], variance[:3], history) if rested else imu
        for imu, bias, variance, rested in zip(rig.imus, biases, variances, known, strict=True)
    )
    return rig.model_copy(update={'imus': corrected})


def _corrected(imu: Imu, bias_b: Vector, variance_b: Vector, history: dict[str, Any]) -> Imu:
    # The force enters the rate through the g-sensitivity, the rate never enters the force.
    A, R = affine(imu.intrinsics)[0][:3, :3], mounting(imu)[0][:3, :3]
    to_raw = np.linalg.inv(A) @ R.T
    intrinsics = imu.intrinsics or Intrinsics()
    gyroscope = intrinsics.gyroscope.model_copy(
        update={
            'bias': tuple((np.array(intrinsics.gyroscope.bias) + to_raw @ bias_b).tolist()),
            'bias_sigma': tuple(np.sqrt(np.square(to_raw) @ variance_b).tolist()),
        }
    )
    return imu.model_copy(
        update={
            'intrinsics': intrinsics.model_copy(update={'gyroscope': gyroscope}),
            'provenance': imu.provenance | history,
        }
    )
