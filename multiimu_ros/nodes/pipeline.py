"""ROS 2 node: all stages in one process, from raw readings to odometry.

The stages are calls, not hops.  `imu<k>/data_calibrated` and `imu<k>/data_registered` are made
only while somebody subscribes to them.
"""

from collections.abc import Sequence

from sensor_msgs.msg import Imu

from multiimu_ros.nodes.calibration import Calibrator
from multiimu_ros.nodes.diagnostics import Status
from multiimu_ros.nodes.fusion import FusionNode
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.parameters import declare
from multiimu_ros.nodes.registration import Registrar
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.serial_input import SerialInput
from multiimu_ros.nodes.stage import send_finite


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
        port = declare(self, 'port', '', 'serial port of the board; empty: read topics instead')
        self._serial = SerialInput(self, self.rig, port, self.on_reading) if port else None
        return self._serial.streams if self._serial else super().open_inputs(suffix)

    def report(self) -> list[Status]:
        """Add the status of the port, where it is read."""
        return [*([self._serial.status()] if self._serial else []), *super().report()]

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
    return run(PipelineNode)
