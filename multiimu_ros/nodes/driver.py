"""ROS 2 node: a board on a serial port becomes `imu<k>/data_raw` and `imu<k>/temperature`.

The transport's thread only queues bytes and wakes the executor; decoding and publishing happen on
the executor's thread, so nothing here needs a lock.
"""

from collections import deque
import time

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, Temperature

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.nodes import convert
from multiimu_ros.nodes.board_status import board_status, imu_statuses, RateMeter
from multiimu_ros.nodes.diagnostics import Diagnostics, Status
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.parameters import declare, warn_about_unused
from multiimu_ros.nodes.run import run
from multiimu_ros.transport.capture import CaptureWriter
from multiimu_ros.transport.serial_port import SerialTransport
from multiimu_ros.wire.board import Board, RawSample

REQUEST_S = 1.0
BOOTLOADER_S = 2.0  # a Mega that hears something during it does not start


class DriverNode(Node):
    """Read the board; publish what it measures, as it measured it."""

    def __init__(self, parameters: list[Parameter] | None = None) -> None:
        super().__init__('driver', parameter_overrides=parameters)
        self._board = Board()
        self._rates = RateMeter()
        self._outputs: dict[int, tuple[Output, convert.StampedEncoder]] = {}
        self._temperatures: dict[int, Output] = {}
        self._queue: deque[tuple[int, bytes | None]] = deque()
        self._woken = False
        self._connected_at, self._heard = 0.0, False
        self._last_status = self._board.status
        self._declare_and_open()
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(REQUEST_S, self._request, clock=steady)
        warn_about_unused(self)
        self._transport.start()

    def _declare_and_open(self) -> None:
        port = declare(self, 'port', '', 'device path of the serial port')
        usb = declare(self, 'usb_serial', '', 'serial number of the USB device, instead of `port`')
        baud = declare(self, 'baud', 500_000, 'symbols per second', low=1)
        self._frame = declare(self, 'frame_id', 'imu{k}_link', 'frame of IMU number {k}')
        rate_sigma = declare(
            self, 'angular_velocity_stddev', 0.0, 'of one reading [rad/s]; 0 is unknown', low=0.0
        )
        force_sigma = declare(
            self, 'linear_acceleration_stddev', 0.0, 'of one reading [m/s^2]; 0: unknown', low=0.0
        )
        self._numbers = np.zeros(convert.IMU_NUMBERS)
        self._numbers[:13] = convert.NO_ORIENTATION
        self._numbers[convert.RATE_COVARIANCE] = np.eye(3).ravel() * rate_sigma**2
        self._numbers[convert.FORCE_COVARIANCE] = np.eye(3).ravel() * force_sigma**2
        path = declare(self, 'capture_file', '', 'where to keep the bytes as they came; or empty')
        self._transport = SerialTransport(
            self._on_block, port=port, usb_serial=usb, baud=baud, on_connect=self._on_connect
        )
        self._capture = CaptureWriter(path) if path else None
        self.diagnostics = Diagnostics(self, usb or port, self._report)

    def _on_block(self, arrival_ns: int, data: bytes | None) -> None:
        self._queue.append((arrival_ns, data))
        # The events executor knows no guard conditions; a task wakes every executor.
        if not self._woken and self.executor is not None:
            self._woken = True
            self.executor.create_task(self._on_bytes)

    def _on_connect(self) -> None:
        self._on_block(0, None)

    def _on_bytes(self) -> None:
        self._woken = False  # before the queue is emptied: what comes later wakes again
        while self._queue:
            arrival_ns, data = self._queue.popleft()
            if data is None:
                self._board.reconnect()
                self._connected_at, self._heard = time.monotonic(), False
                continue
            if self._capture:
                self._capture.write(arrival_ns, data)
            samples = self._board.push(data, arrival_ns)
            for sample in samples:
                self._publish(sample)
            if samples:
                self.diagnostics.latency.note(samples[-1].stamp_ns)
            if not self._heard:
                self._heard = True
                self._request()
            if self._board.status is not self._last_status:
                self._publish_temperatures(arrival_ns)

    def _publish(self, sample: RawSample) -> None:
        imu, stamp_ns, values = sample
        self._rates.note(imu)
        if imu not in self._outputs:
            encoder = convert.StampedEncoder(self._frame.replace('{k}', str(imu)))
            self._outputs[imu] = Output(self, Imu, f'imu{imu}/data_raw'), encoder
        output, encoder = self._outputs[imu]
        if output.wanted:
            self._numbers[convert.RATE], self._numbers[convert.FORCE] = values[:3], values[3:]
            output.send(encoder.encode(stamp_ns, self._numbers))

    def _publish_temperatures(self, arrival_ns: int) -> None:
        status = self._last_status = self._board.status
        for imu, (_, celsius) in status.imus.items() if status else ():
            if np.isnan(celsius):
                continue
            if imu not in self._temperatures:
                self._temperatures[imu] = Output(self, Temperature, f'imu{imu}/temperature')
            msg = Temperature(temperature=celsius)
            msg.header.frame_id = self._frame.replace('{k}', str(imu))
            stamp = msg.header.stamp
            stamp.sec, stamp.nanosec = divmod(arrival_ns, NANOSECONDS)
            self._temperatures[imu].send(msg)

    def _request(self) -> None:
        awake = self._heard or time.monotonic() - self._connected_at > BOOTLOADER_S
        if self._transport.connected and awake:
            self._transport.write(self._board.requests(self._transport.now_ns()))

    def _report(self) -> list[Status]:
        self._rates.look(time.monotonic())
        link = board_status(self._board, self._transport)
        return [link, *imu_statuses(self._board, self._rates, connected=self._transport.connected)]

    def destroy_node(self) -> None:
        """Close the port first: its thread must not wake a node that is gone."""
        self._transport.stop()
        if self._capture:
            self._capture.close()
        super().destroy_node()


def main() -> int:
    """Run until SIGINT or SIGTERM."""
    return run(DriverNode)
