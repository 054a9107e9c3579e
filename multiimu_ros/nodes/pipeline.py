"""ROS 2 node: all stages in one process, from raw readings to odometry.

The stages are calls, not hops.  `imu<k>/data_calibrated` and `imu<k>/data_registered` are made
only while somebody subscribes to them.
"""

from collections.abc import Sequence

import numpy as np
from sensor_msgs.msg import Imu

from multiimu_ros.nodes.calibration import Calibrator
from multiimu_ros.nodes.convert import imu_numbers, RATE_AND_FORCE
from multiimu_ros.nodes.diagnostics import Status
from multiimu_ros.nodes.fusion import FusionNode, run_fusion
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.registration import Registrar
from multiimu_ros.nodes.serial_input import declare_port, SerialInput
from multiimu_ros.nodes.stage import send_finite
from multiimu_ros.wire.board import RawSample


class PipelineNode(FusionNode):
    """Hear `imu<k>/data_raw`; say what calibration, registration and fusion would."""

    def __init__(self) -> None:
        super().__init__('pipeline', 'data_raw', 'raw')

    def open_inputs(self, suffix: str) -> Sequence[ImuInput]:
        """Open the port, or subscribe; prepare the topics of the stages between."""
        names = self.rig.names
        self._calibrator, self._registrar = Calibrator(self.rig), Registrar(self.rig)
        self._calibrated = [Output(self, Imu, f'{name}/data_calibrated') for name in names]
        self._registered = [Output(self, Imu, f'{name}/data_registered') for name in names]
        port, usb_serial = declare_port(self)
        self._serial: SerialInput | None = None
        if not (port or usb_serial):
            return super().open_inputs(suffix)
        streams = [ImuInput(f'{port or usb_serial}, IMU {k}') for k in range(len(names))]
        self._raw = [Output(self, Imu, f'{name}/data_raw') for name in names]
        self._raw_numbers = imu_numbers(np.zeros((3, 3)), np.zeros((3, 3)))
        self._serial = SerialInput(self, port, usb_serial, self._on_samples)
        return streams

    def _on_samples(self, samples: list[RawSample], _: int) -> None:
        for k, stamp_ns, values in samples:
            if k >= len(self._raw):
                continue  # the board has more IMUs than the rig file
            frame_id = self.rig.imus[k].frame_id
            self.streams[k].take(stamp_ns)
            if self._raw[k].wanted:
                self._raw_numbers[RATE_AND_FORCE] = values
                send_finite(self._raw[k], (stamp_ns, frame_id, self._raw_numbers))
            self.on_reading(k, stamp_ns, frame_id, values)

    def report(self) -> list[Status]:
        """Add the statuses of the board, where its port is read."""
        if self._serial is None:
            return super().report()
        link, *_ = self._serial.statuses()  # of the IMUs fusion knows more
        return [link, *super().report()]

    def destroy_node(self) -> None:
        """Close the port first: its thread must not wake a node that is gone."""
        if self._serial:
            self._serial.close()
        super().destroy_node()

    def on_reading(self, k: int, stamp_ns: int, frame_id: str, values: Sequence[float]) -> None:
        """Fuse one reading; publish its stages for those who want them."""
        super().on_reading(k, stamp_ns, frame_id, values)
        calibrated, registered = self._calibrated[k], self._registered[k]
        if not (calibrated.wanted or registered.wanted):
            return
        rate_hz = self.streams[k].rate_hz
        message = self._calibrator.convert(k, stamp_ns, frame_id, values, rate_hz)
        if calibrated.wanted:
            send_finite(calibrated, message)
        if registered.wanted:
            send_finite(registered, self._registrar.convert(k, *message, rate_hz))


def main() -> int:
    """Run until shutdown."""
    return run_fusion(PipelineNode)
