"""A board on a serial port, served by a node: what the driver and the pipeline node share.

The transport's thread only queues bytes and wakes the executor; decoding and publishing happen on
the executor's thread, so nothing here needs a lock.
"""

from collections import deque
from collections.abc import Callable
import time

from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from multiimu_ros.nodes.board_status import board_status, imu_statuses, RateMeter
from multiimu_ros.nodes.diagnostics import Status
from multiimu_ros.nodes.parameters import declare
from multiimu_ros.transport.capture import CaptureWriter
from multiimu_ros.transport.serial_port import SerialTransport
from multiimu_ros.wire.board import Board, RawSample

REQUEST_S = 1.0
BOOTLOADER_S = 2.0  # a Mega that hears something during it does not start


def declare_port(node: Node) -> tuple[str, str]:
    """Return the parameters `port` and `usb_serial`, of which one names the board."""
    port = declare(node, 'port', '', 'device path of the serial port')
    usb = declare(node, 'usb_serial', '', 'serial number of the USB device, instead of `port`')
    return port, usb


class SerialInput:
    """Read a board through every unplugging, ask it who it is, and judge its state.

    Parameters
    ----------
    node : Node
        Declares `baud` and `capture_file`; its executor does the work.
    port, usb_serial : str
        Device path or serial number; one is empty.
    on_samples : callable
        Takes the samples that a block of bytes completed, maybe none, and its arrival [ns].

    Attributes
    ----------
    board, transport
        Their counters are the connection's.
    heard : bool
        Whether anything came since the port was opened.
    """

    def __init__(
        self,
        node: Node,
        port: str,
        usb_serial: str,
        on_samples: Callable[[list[RawSample], int], None],
    ) -> None:
        self.board = Board()
        self.heard = False
        self._node, self._on_samples = node, on_samples
        self._rates = RateMeter()
        self._queue: deque[tuple[int, bytes | None]] = deque()
        self._woken = False
        self._connected_at = 0.0
        baud = declare(node, 'baud', 500_000, 'symbols per second', low=1)
        path = declare(node, 'capture_file', '', 'where to keep the bytes as they came; or empty')
        self.transport = SerialTransport(
            self._on_block,
            port=port,
            usb_serial=usb_serial,
            baud=baud,
            on_connect=lambda: self._on_block(0, None),
        )
        self._capture = CaptureWriter(path) if path else None
        node.create_timer(REQUEST_S, self._request, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.transport.start()

    def _on_block(self, arrival_ns: int, data: bytes | None) -> None:
        """Queue a block, or None for a new connection; runs on the transport's thread."""
        self._queue.append((arrival_ns, data))
        # The events executor knows no guard conditions; a task wakes every executor.
        if not self._woken and self._node.executor is not None:
            self._woken = True
            self._node.executor.create_task(self._drain)

    def _drain(self) -> None:
        self._woken = False  # before the queue is emptied: what comes later wakes again
        while self._queue:
            arrival_ns, data = self._queue.popleft()
            if data is None:
                self.board.reconnect()
                self._connected_at, self.heard = time.monotonic(), False
                continue
            if self._capture:
                self._capture.write(arrival_ns, data)
            samples = self.board.push(data, arrival_ns)
            now_s = time.monotonic()
            for sample in samples:
                self._rates.note(sample.imu, now_s)
            self._on_samples(samples, arrival_ns)
            if not self.heard:
                self.heard = True
                self._request()

    def _request(self) -> None:
        awake = self.heard or time.monotonic() - self._connected_at > BOOTLOADER_S
        if self.transport.connected and awake:
            self.transport.write(self.board.requests(self.transport.now_ns()))

    def statuses(self) -> list[Status]:
        """Return the status of the connection and of each IMU on the board."""
        self._rates.look(time.monotonic())
        link = board_status(self.board, self.transport)
        imus = imu_statuses(self.board, self._rates, connected=self.transport.connected)
        return [link, *imus]

    def close(self) -> None:
        """End the thread before the node that it wakes is gone."""
        self.transport.stop()
        if self._capture:
            self._capture.close()
