"""ROS 2 node: watch the fused output and say on stdout, as lines of JSON, how the graph fares."""

import json
import sys
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TwistWithCovarianceStamped
import numpy as np
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu

from multiimu_ros.nodes.convert import decode_imu
from multiimu_ros.nodes.run import run

PERIOD_S = 0.25
# Both ends of each hop, for one may know of the other first; the raw topics open with the port.
JOINED = (
    ('calibration', 'subscribers'),
    ('registration', 'publishers'),
    ('registration', 'subscribers'),
    ('fusion', 'publishers'),
)


class MonitorNode(Node):
    """Hear `imu/data`, `zero_velocity` and `/diagnostics`; write a line four times a second."""

    def __init__(self) -> None:
        super().__init__('monitor')
        self._count = self.declare_parameter('imus', 8).value
        self._ages: list[float] = []
        self._stamp_ns = self._still_ns = 0
        self._received = 0
        self._begin = time.monotonic()
        self._figures: dict[str, dict[str, str]] = {}
        best_effort = qos_profile_sensor_data
        self.create_subscription(Imu, 'imu/data', self._on_imu, best_effort, raw=True)
        self.create_subscription(
            TwistWithCovarianceStamped, 'zero_velocity', self._on_still, best_effort
        )
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 50)
        # A recorder subscribes to what is published: these let it do so before the first message.
        for k in range(self._count):
            self.create_publisher(Imu, f'imu{k}/data_raw', 10)
        self.create_timer(PERIOD_S, self._tell)

    def _on_imu(self, data: bytes) -> None:
        now_ns = time.time_ns()
        reading = decode_imu(data)
        if reading is not None:
            self._received += 1
            self._stamp_ns = reading[0]
            self._ages.append((now_ns - self._stamp_ns) * 1e-9)

    def _on_still(self, msg: Any) -> None:
        self._still_ns = msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec

    def _on_diagnostics(self, msg: Any) -> None:
        for status in msg.status:
            figures = {value.key: value.value for value in status.values}
            self._figures[status.name] = figures | {'message': status.message}

    def _is_ready(self) -> bool:
        """Say whether all who have to hear each other do."""
        imus = [f'imu{k}' for k in range(self._count)]
        # The raw topics have two listeners: calibration and the recorder.
        heard = all(self.count_subscribers(f'{imu}/data_raw') > 1 for imu in imus)
        joined = all(
            int(self._figures.get(f'{node}: {imu}', {}).get(end, 0)) > 0
            for node, end in JOINED
            for imu in imus
        )
        return heard and joined and self.count_publishers('imu/data') > 0

    def _tell(self) -> None:
        now, ages = time.monotonic(), self._ages
        line = {
            'ready': self._is_ready(),
            'received': self._received,
            'rate_hz': len(ages) / (now - self._begin),
            'still': self._stamp_ns - self._still_ns < 1e9 * PERIOD_S / 2,
            'age_p50_s': float(np.median(ages)) if ages else None,
            'age_p99_s': float(np.quantile(ages, 0.99)) if ages else None,
            'figures': self._figures,
        }
        self._ages, self._begin = [], now
        sys.stdout.write(json.dumps(line) + '\n')
        sys.stdout.flush()


def main() -> int:
    """Run until shutdown."""
    return run(MonitorNode)
