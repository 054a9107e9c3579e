"""What a node says about itself on /diagnostics: once a second, and at once when a level changes.

The first status of every node is its own load and latency; the stages add one per IMU.
"""

from collections import deque
from collections.abc import Callable, Mapping
import time
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
import numpy as np
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)
LOOK_S = 0.2  # a fault is named at most this long after it is known
PERIOD_S = 1.0
HOUR_NS = 3_600_000_000_000


class Status(NamedTuple):
    """One line of /diagnostics: what it is about, how bad, why, and the figures."""

    component: str
    level: bytes
    message: str
    figures: Mapping[str, Any]


class Latency:
    """Time from the instant of a measurement to its publication.

    Only where stamps are of this machine's clock: those of an old bag or of simulated time say
    nothing, and give NaN.
    """

    def __init__(self) -> None:
        self._recent_ns: deque[int] = deque(maxlen=2000)

    def note(self, stamp_ns: int) -> None:
        """Take the stamp of a message that is published now."""
        self._recent_ns.append(time.time_ns() - stamp_ns)

    def percentiles_ms(self) -> tuple[float, float]:
        """Return p50 and p99 of the messages since the last call [ms]."""
        recent = np.array(self._recent_ns)
        self._recent_ns.clear()
        recent = recent[np.abs(recent) < HOUR_NS]
        if not len(recent):
            return float('nan'), float('nan')
        p50, p99 = np.percentile(recent, [50, 99]) * 1e-6
        return float(p50), float(p99)


class Diagnostics:
    """Publish a node's statuses.

    Parameters
    ----------
    node : Node
        Its name starts every status' name.
    hardware_id : str
        Serial number of the device, or name of the rig.
    report : callable
        Returns the statuses of the node's parts; called every `LOOK_S`.
    """

    def __init__(self, node: Node, hardware_id: str, report: Callable[[], list[Status]]) -> None:
        self.latency = Latency()
        self._node = node
        self._hardware_id = hardware_id
        self._report = report
        self._levels: dict[str, tuple[bytes, str]] = {}
        self._cpu_s, self._wall_s = time.process_time(), time.monotonic()
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', 10)
        # A steady clock: simulated time may stand still, and the node must still speak.
        self._timer = node.create_timer(
            LOOK_S, self._look, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _look(self) -> None:
        statuses = self._report()
        levels = {status.component: (status.level, status.message) for status in statuses}
        due = time.monotonic() - self._wall_s > PERIOD_S - LOOK_S / 2
        if due:
            statuses.insert(0, self._own_status())
        if due or levels != self._levels:
            self._publish(statuses)
        self._levels = levels

    def _own_status(self) -> Status:
        cpu_s, wall_s = time.process_time(), time.monotonic()
        load = 100 * (cpu_s - self._cpu_s) / (wall_s - self._wall_s)
        self._cpu_s, self._wall_s = cpu_s, wall_s
        p50, p99 = self.latency.percentiles_ms()
        figures = {'cpu [%]': load, 'latency p50 [ms]': p50, 'latency p99 [ms]': p99}
        return Status('node', OK, 'running', figures)

    def _publish(self, statuses: list[Status]) -> None:
        msg = DiagnosticArray()
        msg.header.stamp = self._node.get_clock().now().to_msg()
        msg.status = [
            DiagnosticStatus(
                level=status.level,
                name=f'{self._node.get_name()}: {status.component}',
                message=status.message,
                hardware_id=self._hardware_id,
                values=[
                    KeyValue(key=key, value=_text(value)) for key, value in status.figures.items()
                ],
            )
            for status in statuses
        ]
        self._publisher.publish(msg)


def _text(value: object) -> str:
    return f'{value:.6g}' if isinstance(value, float) else str(value)
