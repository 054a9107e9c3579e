"""ROS 2 node: publish a recording with the spacing in which it was recorded."""

import argparse
from array import array
from collections.abc import Sequence
from functools import partial
import sys
from threading import Event, Thread
import time

import numpy as np
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.bags import list_topics, Topic
from multiimu_ros.errors import ConfigError, MultiImuError
from multiimu_ros.nodes.read_ahead import ReadAhead
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.topics import message_class

TOGETHER_S = 2e-4  # what is due within this is published at once
CLOCK_S = 0.01  # the longest wait between two messages of /clock
SETTLE_S = 0.3  # from the first sign of a subscriber until it hears us too
SWITCH_S = 2e-4  # how long the reading thread may hold up the publishing one
DEPTH = 2000  # messages kept for a subscriber that is late


class PlayNode(Node):
    """Publish a bag from a thread of its own, then end the process."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__('play')
        self._options = options
        self._late = array('d')  # [s], of each message
        self._error: MultiImuError | None = None
        self._stop = Event()
        self._told_ns = 0
        self._outputs = self._advertise(list_topics(options.bag))
        self._clock = self.create_publisher(Clock, '/clock', 10) if options.clock else None
        sys.setswitchinterval(SWITCH_S)
        self._messages = ReadAhead(options.bag, list(self._outputs), self._stop)
        self._thread = Thread(target=self._play)
        self._thread.start()

    def _advertise(self, topics: Sequence[Topic]) -> dict[str, Publisher]:
        wanted = {name.lstrip('/') for name in self._options.topics}
        outputs = {}
        for topic in topics:
            if (wanted and topic.name.lstrip('/') not in wanted) or topic.name == '/clock':
                continue
            profile = QoSProfile(depth=DEPTH)
            if not topic.reliable:
                profile.reliability = ReliabilityPolicy.BEST_EFFORT
            if topic.latched:
                profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
            try:
                kind = message_class(topic.type)
            except ConfigError as error:
                self.get_logger().warning(f'Not played: `{topic.name}`. {error}')
                continue
            outputs[topic.name] = self.create_publisher(kind, topic.name, profile)
        if not outputs:
            msg = f'`{self._options.bag}` must hold a topic to play, and holds none; check it.'
            raise ConfigError(msg)
        return outputs

    def _play(self) -> None:
        self._wait_for_subscribers()
        begin = time.monotonic()
        try:
            self._publish_in_time()
        except MultiImuError as error:
            self._error = error
        seconds = time.monotonic() - begin
        for output in self._outputs.values():
            output.wait_for_all_acked(Duration(seconds=1))
        self.get_logger().info(self._report(seconds))
        self.context.try_shutdown()

    def _publish_in_time(self) -> None:
        begin, first_ns = 0.0, -1
        for message in self._messages:
            if first_ns < 0:
                begin, first_ns = time.monotonic(), message.received_ns
            passed_s = (message.received_ns - first_ns) / NANOSECONDS / self._options.rate
            if not self._sleep(begin + passed_s, message.received_ns):
                return
            self._outputs[message.topic].publish(message.data)
            self._late.append(max(0.0, time.monotonic() - begin - passed_s))

    def _wait_for_subscribers(self) -> None:
        """Wait until every topic is heard, but no longer than the user wants."""
        until = time.monotonic() + self._options.wait
        while unheard := [
            n for n, out in self._outputs.items() if not out.get_subscription_count()
        ]:
            if time.monotonic() > until:
                names = ', '.join(unheard)
                self.get_logger().info(f'Nobody listens to {names} yet; playing all the same.')
                break
            if self._stop.wait(0.02):
                return
        self._stop.wait(SETTLE_S)

    def _sleep(self, due: float, bag_ns: int) -> bool:
        """Sleep until `due` on the monotonic clock, telling the time; False means stop."""
        while (left := due - time.monotonic()) > TOGETHER_S and not self._stop.is_set():
            self._tell(bag_ns - round(left * self._options.rate * NANOSECONDS))
            time.sleep(min(left, CLOCK_S if self._clock else 0.05))
        self._tell(bag_ns)
        return not self._stop.is_set()

    def _tell(self, bag_ns: int) -> None:
        if self._clock:
            self._told_ns = max(self._told_ns, bag_ns)  # what is due soon was told early
            clock = Clock()
            clock.clock.sec, clock.clock.nanosec = divmod(self._told_ns, NANOSECONDS)
            self._clock.publish(clock)

    def _report(self, seconds: float) -> str:
        late_ms = np.percentile(self._late or [0.0], [50, 99, 100]) * 1e3
        return (
            f'Played {len(self._late)} messages on {len(self._outputs)} topics '
            f'in {seconds:.2f} s, '
            f'late by p50 {late_ms[0]:.2f}, p99 {late_ms[1]:.2f}, max {late_ms[2]:.2f} ms.'
        )

    def destroy_node(self) -> None:
        """End the threads; an error of the reading one goes on to `main`."""
        self._stop.set()
        self._thread.join()
        self._messages.thread.join()
        super().destroy_node()
        if self._error is not None:
            raise self._error


def _positive(text: str) -> float:
    value = float(text)
    if not 0 < value < float('inf'):
        msg = f'must be positive, got {text}'
        raise argparse.ArgumentTypeError(msg)
    return value


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(
        prog='play',
        description='Publish a rosbag2 recording with its original spacing.',
        epilog='Example: play walk --rate 2 --clock',
    )
    parser.add_argument('bag', help='rosbag2 folder, .mcap or .db3 file')
    parser.add_argument('--rate', type=_positive, default=1.0, help='speed [-]; default: 1')
    parser.add_argument('--clock', action='store_true', help='publish /clock')
    parser.add_argument('--topics', nargs='+', default=[], help='play only these')
    parser.add_argument(
        '--wait',
        type=float,
        default=5.0,
        help='the longest wait until every topic has a subscriber [s]; default: 5',
    )
    return parser.parse_args(arguments)


def main() -> int:
    """Play to the end, or until SIGINT or SIGTERM."""
    options = parse(remove_ros_args(sys.argv)[1:])
    try:
        return run(partial(PlayNode, options))
    except MultiImuError as error:
        sys.stderr.write(f'{error}\n')
        return 1
