"""ROS 2 node: a board on a serial port becomes `imu<k>/data_raw` and `imu<k>/temperature`."""

import time

import numpy as np
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, Temperature

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.nodes import convert
from multiimu_ros.nodes.diagnostics import Diagnostics
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.parameters import declare, warn_about_unused
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.serial_input import declare_port, SerialInput
from multiimu_ros.wire.board import RawSample
from multiimu_ros.wire.packets import Hello, Status as BoardStatus

MATCHING_S = 0.2  # from HELLO until those who wait for the topics have found them


class DriverNode(Node):
    """Read the board; publish what it measures, as it measured it."""

    def __init__(self, parameters: list[Parameter] | None = None) -> None:
        super().__init__('driver', parameter_overrides=parameters)
        self._outputs: dict[int, tuple[Output, convert.StampedEncoder]] = {}
        self._temperatures: dict[int, Output] = {}
        self._held: list[RawSample] = []
        self._publish_from = 0.0
        self._hello: Hello | None = None
        self._status: BoardStatus | None = None
        self._declare_message()
        port, usb_serial = declare_port(self)
        self.input = SerialInput(self, port, usb_serial, self._on_samples)
        self.diagnostics = Diagnostics(self, usb_serial or port, self.input.statuses)
        warn_about_unused(self)

    def _declare_message(self) -> None:
        self._frame = declare(self, 'frame_id', 'imu{k}_link', 'frame of IMU number {k}')
        rate_sigma = declare(
            self, 'angular_velocity_stddev', 0.0, 'of one reading [rad/s]; 0 is unknown', low=0.0
        )
        force_sigma = declare(
            self, 'linear_acceleration_stddev', 0.0, 'of one reading [m/s^2]; 0: unknown', low=0.0
        )
        self._numbers = convert.imu_numbers(np.eye(3) * rate_sigma**2, np.eye(3) * force_sigma**2)

    def _on_samples(self, samples: list[RawSample], arrival_ns: int) -> None:
        board = self.input.board
        if board.hello is not None and board.hello is not self._hello:
            self._advertise(board.hello)
        self._held += samples
        if samples and time.monotonic() >= self._publish_from:
            for sample in self._held:
                self._publish(sample)
            self._held.clear()
            self.diagnostics.latency.note(samples[-1].stamp_ns)
        if board.status is not None and board.status is not self._status:
            self._publish_temperatures(board.status, arrival_ns)

    def _advertise(self, hello: Hello) -> None:
        """Open the topics of those IMUs that are new; what they say is held until then."""
        self._hello = hello
        for imu in {info.imu for info in hello.imus} - self._outputs.keys():
            encoder = convert.StampedEncoder(self._frame.replace('{k}', str(imu)))
            self._outputs[imu] = Output(self, Imu, f'imu{imu}/data_raw'), encoder
            self._publish_from = time.monotonic() + MATCHING_S

    def _publish(self, sample: RawSample) -> None:
        imu, stamp_ns, values = sample
        output, encoder = self._outputs[imu]
        if output.wanted:
            self._numbers[convert.RATE], self._numbers[convert.FORCE] = values[:3], values[3:]
            output.send(encoder.encode(stamp_ns, self._numbers))

    def _publish_temperatures(self, status: BoardStatus, arrival_ns: int) -> None:
        self._status = status
        for imu, (_, celsius) in status.imus.items():
            if np.isnan(celsius):
                continue
            if imu not in self._temperatures:
                self._temperatures[imu] = Output(self, Temperature, f'imu{imu}/temperature')
            msg = Temperature(temperature=celsius)
            msg.header.frame_id = self._frame.replace('{k}', str(imu))
            stamp = msg.header.stamp
            stamp.sec, stamp.nanosec = divmod(arrival_ns, NANOSECONDS)
            self._temperatures[imu].send(msg)

    def destroy_node(self) -> None:
        """Close the port first: its thread must not wake a node that is gone."""
        self.input.close()
        super().destroy_node()


def main() -> int:
    """Run until SIGINT or SIGTERM."""
    return run(DriverNode)
