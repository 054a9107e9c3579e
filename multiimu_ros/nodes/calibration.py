"""ROS 2 node: raw readings to calibrated ones, with covariances from the rig's noise model.

The covariance of a message is that of what is unknown of it: white noise at the measured rate,
what calibration left of the bias, and of scale and axes at this reading.
"""

from collections.abc import Sequence

import numpy as np

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fusion.rig_model import rig_model
from multiimu_ros.nodes.convert import decode_imu, FORCE, imu_numbers, RATE
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.stage import Message, StageNode
from multiimu_ros.rig import Extrinsics, Rig

ALIGNED = Extrinsics(rotation_sigma=(0.0, 0.0, 0.0))  # the mounting is the next stage's business
EMPTY = imu_numbers(np.zeros((3, 3)), np.zeros((3, 3)))  # REP 145: zeros are unknown
RATE_DIAGONAL, FORCE_DIAGONAL = slice(16, 25, 4), slice(28, 37, 4)


class Calibrator:
    """The stage: stamp and frame stay."""

    def __init__(self, rig: Rig) -> None:
        sensors = [imu.model_copy(update={'extrinsics': ALIGNED}) for imu in rig.imus]
        self._model = rig_model(rig.model_copy(update={'imus': tuple(sensors)}))
        self._maps = [affine(imu.intrinsics) for imu in rig.imus]

    def convert(
        self, k: int, stamp_ns: int, frame_id: str, reading: Sequence[float], rate_hz: float
    ) -> Message:
        """Calibrate one reading."""
        A, c = self._maps[k]
        values = A @ reading + c
        numbers = EMPTY.copy()
        if rate_hz > 0:  # NaN until the rate is known
            variance = self._model.density[k] ** 2 * rate_hz + self._model.bias_variance[k]
            variance += self._model.scale_variance[k] @ values**2
            numbers[RATE_DIAGONAL], numbers[FORCE_DIAGONAL] = variance[:3], variance[3:]
        numbers[RATE], numbers[FORCE] = values[:3], values[3:]
        return stamp_ns, frame_id, numbers


class CalibrationNode(StageNode):
    """Hear `imu<k>/data_raw`; say `imu<k>/data_calibrated` with the same stamp and frame."""

    def __init__(self) -> None:
        super().__init__('calibration', 'data_raw', 'data_calibrated', decode_imu, Calibrator)


def main() -> int:
    """Run until shutdown."""
    return run(CalibrationNode)
