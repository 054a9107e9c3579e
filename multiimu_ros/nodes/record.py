"""ROS 2 node: write topics into a rosbag2 recording, without decoding a message."""

import argparse
from collections.abc import Sequence
from functools import partial
import re
import sys
import time
from typing import Any

from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args

from multiimu_ros.bags import BagWriter
from multiimu_ros.errors import ConfigError, MultiImuError
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.topics import message_class

OURS = re.compile(r'/(imu[^/]*/[^/]+|odom|zero_velocity)$')
LOOK_S = 0.2  # how often new topics are looked for
DEPTH = 5000  # messages: half a second of 8 x 1000 Hz while the disk is busy


class RecordNode(Node):
    """Subscribe to the wanted topics as they appear, and write what arrives."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__('record')
        self._bag = BagWriter(options.output, options.storage)
        self._wanted = {self.resolve_topic_name(topic) for topic in options.topics}
        self._all = options.all
        self._seen: set[str] = set()
        self._lost = 0
        self._look()
        self.create_timer(LOOK_S, self._look)

    def _is_wanted(self, topic: str) -> bool:
        if self._wanted or self._all:
            return self._all or topic in self._wanted
        return OURS.search(topic) is not None

    def _look(self) -> None:
        for topic, types in self.get_topic_names_and_types():
            published = topic not in self._seen and self.count_publishers(topic)
            if published and self._is_wanted(topic):
                self._seen.add(topic)
                self._subscribe(topic, types[0])

    def _subscribe(self, topic: str, type_name: str) -> None:
        """Ask for the best quality of service that all present publishers offer."""
        offered = [info.qos_profile for info in self.get_publishers_info_by_topic(topic)]
        reliable = all(qos.reliability == ReliabilityPolicy.RELIABLE for qos in offered)
        latched = all(qos.durability == DurabilityPolicy.TRANSIENT_LOCAL for qos in offered)
        profile = QoSProfile(depth=DEPTH)
        profile.reliability = (
            ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        )
        if latched:
            profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
        try:
            kind = message_class(type_name)
            self._bag.add_topic(topic, type_name, reliable=reliable, latched=latched)
        except ConfigError as error:
            self.get_logger().warning(f'Not recorded: {error}')
            return
        events = SubscriptionEventCallbacks(message_lost=self._on_lost)
        callback = partial(self._on_message, topic)
        self.create_subscription(kind, topic, callback, profile, raw=True, event_callbacks=events)

    def _on_message(self, topic: str, data: bytes) -> None:
        # The events executor fails on a callback that asks for the middleware's own stamp, too.
        self._bag.write(topic, time.time_ns(), data)

    def _on_lost(self, event: Any) -> None:
        self._lost += event.total_count_change

    def destroy_node(self) -> None:
        """Close the bag and say what it holds."""
        self._bag.close()
        counts = self._bag.counts
        lines = [f'{topic}: {counts[topic]}' for topic in sorted(counts)]
        self.get_logger().info(
            f'Recorded {counts.total()} messages on {len(counts)} topics to `{self._bag.path}`, '
            f'{self._lost} lost on the way. {", ".join(lines)}'
        )
        absent = sorted(self._wanted - set(counts))
        if absent:
            self.get_logger().warning(f'Nothing came on {", ".join(absent)}.')
        super().destroy_node()


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog='record',
        description='Write topics into a rosbag2 recording until SIGINT.',
        epilog='Example: record -o walk   (all imu*/..., odom and zero_velocity topics)',
    )
    parser.add_argument('topics', nargs='*', help='topics; default: imu*/*, odom, zero_velocity')
    parser.add_argument('-o', '--output', required=True, help='folder to make')
    parser.add_argument('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    parser.add_argument('--all', action='store_true', help='every topic of the graph')
    return parser.parse_args(arguments)


def main() -> int:
    """Run until SIGINT or SIGTERM."""
    options = parse(remove_ros_args(sys.argv)[1:])
    try:
        return run(partial(RecordNode, options))
    except MultiImuError as error:  # the bag could not be closed
        sys.stderr.write(f'{error}\n')
        return 1
