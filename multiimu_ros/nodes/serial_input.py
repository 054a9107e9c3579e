"""A board on a serial port as the input of the pipeline node, without a hop through topics.

The transport's thread queues bytes and wakes the executor; everything else happens there.
"""

from collections import deque
from collections.abc import Callable, Sequence
import time

import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from sensor_msgs.msg import Imu

from multiimu_ros.nodes.board_status import board_status
from multiimu_ros.nodes.convert import imu_numbers, RATE_AND_FORCE
from multiimu_ros.nodes.diagnostics import Status
from multiimu_ros.nodes.inputs import FIRST_RATE, ImuInput
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.parameters import declare
from multiimu_ros.nodes.stage import send_finite
from multiimu_ros.rig import Rig
from multiimu_ros.transport.serial_port import SerialTransport
from multiimu_ros.wire.board import Board, RawSample

REQUEST_S = 1.0
BOOTLOADER_S = 2.0  # some boards do not start if they hear something earlier


class SerialInput:
    """Hand on what the board says, and publish `imu<k>/data_raw` for those who want it.

    Parameters
    ----------
    node : Node
        Declares `baud`; serves the port.
    rig : Rig
        Names the IMUs; the board numbers them in its order.
    port : str
        Device path.
    on_reading : callable
        Takes index, stamp [ns], frame and six values.
    """

    def __init__(
        self,
        node: Node,
        rig: Rig,
        port: str,
        on_reading: Callable[[int, int, str, Sequence[float]], None],
    ) -> None:
        self.streams = [ImuInput(f'{port}, IMU {k}') for k in range(len(rig.imus))]
        self._node, self._on_reading = node, on_reading
        self._frames = [imu.frame_id for imu in rig.imus]
        self._outputs = [Output(node, Imu, f'{name}/data_raw') for name in rig.names]
        self._numbers = imu_numbers(np.zeros((3, 3)), np.zeros((3, 3)))
        self._board = Board()
        self._queue: deque[tuple[int, bytes | None]] = deque()
        self._woken = False
        self._connected_at = 0.0
        baud = declare(node, 'baud', 500_000, 'symbols per second', low=1)
        self._transport = SerialTransport(
            self._on_block, port=port, baud=baud, on_connect=lambda: self._on_block(0, None)
        )
        node.create_timer(REQUEST_S, self._request, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._transport.start()

    def _on_block(self, arrival_ns: int, data: bytes | None) -> None:
        """Queue a block, or None for a new connection; runs on the transport's thread."""
        self._queue.append((arrival_ns, data))
        if not self._woken and self._node.executor is not None:
            self._woken = True
            self._node.executor.create_task(self._drain)

    def _drain(self) -> None:
        self._woken = False  # before the queue is emptied: what comes later wakes again
        while self._queue:
            arrival_ns, data = self._queue.popleft()
            if data is None:
                self._board.reconnect()
                self._connected_at = time.monotonic()
                continue
            for sample in self._board.push(data, arrival_ns):
                self._hand_on(sample)

    def _hand_on(self, sample: RawSample) -> None:
        k, stamp_ns, values = sample
        if k >= len(self.streams):
            return  # the board has more IMUs than the rig file
        stream, output = self.streams[k], self._outputs[k]
        stream.received += 1
        stream.stamps_ns.append(stamp_ns)
        if stream.received == FIRST_RATE:
            stream.measure_rate()
        if output.wanted:
            self._numbers[RATE_AND_FORCE] = values
            send_finite(output, (stamp_ns, self._frames[k], self._numbers))
        self._on_reading(k, stamp_ns, self._frames[k], values)

    def _request(self) -> None:
        heard = self._board.hello is not None
        awake = heard or time.monotonic() - self._connected_at > BOOTLOADER_S
        if self._transport.connected and awake:
            self._transport.write(self._board.requests(self._transport.now_ns()))

    def status(self) -> Status:
        """Return the connection's status."""
        return board_status(self._board, self._transport)

    def close(self) -> None:
        """End the thread before the node that it wakes is gone."""
        self._transport.stop()
