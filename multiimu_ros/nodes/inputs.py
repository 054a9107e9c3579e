"""IMU topics in: raw subscriptions, decoded, counted, and handed on in the order of the rig."""

from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
import time
from typing import Any

import numpy as np
from rclpy.event_handler import QoSSubscriptionMatchedInfo, SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Imu

from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.parameters import declare
from multiimu_ros.rig import load_rig, Rig

DEPTH = 500  # half a second at 1 kHz, for the moments in which the machine does something else
QOS = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
RELIABLE_QOS = QoSProfile(depth=DEPTH, reliability=ReliabilityPolicy.RELIABLE)
FIRST_RATE = 10  # so many stamps give a first idea of the rate


def declare_rig(node: Node) -> Rig:
    """Load the rig file that the parameter `rig_file` names; say what it leaves nominal."""
    path = declare(node, 'rig_file', '', 'path of the rig file that describes the IMUs')
    rig = load_rig(path)
    nominal = rig.nominal_blocks()
    if nominal:
        node.get_logger().warning(
            f'The rig file `{path}` leaves {", ".join(nominal[:3])}'
            f'{f" and {len(nominal) - 3} more" if len(nominal) > 3 else ""} nominal; '
            'run `multiimu calibrate` and `multiimu register`.'
        )
    return rig


class ImuInput:
    """What arrived on one topic.

    Attributes
    ----------
    received, malformed : int
        Messages taken; those among them that were no Imu, or had no stamp.
    publishers : int
        How many the middleware has joined to this subscription.
    rate_hz : float
        Median rate of the last stamps [Hz]; NaN before there are enough.
    heard : float
        When the last message was noticed, on the steady clock [s].
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.received = 0
        self.malformed = 0
        self.publishers = 0
        self.rate_hz = float('nan')
        self.heard = time.monotonic()
        self.stamps_ns: deque[int] = deque(maxlen=100)
        self._noticed = 0

    def take(self, stamp_ns: int) -> None:
        """Note a usable message."""
        self.received += 1
        self.stamps_ns.append(stamp_ns)
        if self.received == FIRST_RATE:
            self.measure_rate()

    def on_matched(self, info: QoSSubscriptionMatchedInfo) -> None:
        """Note that a publisher has come or gone."""
        self.publishers = info.current_count

    def measure_rate(self) -> None:
        """Work out the rate; called now and then."""
        if len(self.stamps_ns) >= FIRST_RATE:
            step = float(np.median(np.diff(np.array(self.stamps_ns))))
            self.rate_hz = 1e9 / step if step > 0 else float('nan')

    def silent_s(self) -> float:
        """Return for how long nothing has come, to the resolution of these calls [s]."""
        now = time.monotonic()
        if self.received != self._noticed:
            self._noticed, self.heard = self.received, now
        return now - self.heard


class ImuInputs:
    """The subscriptions of one node.

    Parameters
    ----------
    node : Node
        Declares the parameter `topics`.
    rig : Rig
        Names the topics where `topics` is empty.
    suffix : str
        Last part of the default names, such as `data_raw`.
    decode : callable
        Turns bytes into stamp, frame and numbers, or None.
    on_reading : callable
        Takes index, stamp [ns], frame and numbers.
    """

    def __init__(
        self,
        node: Node,
        rig: Rig,
        suffix: str,
        decode: Callable[[bytes], tuple[int, str, Any] | None],
        on_reading: Callable[[int, int, str, Any], None],
    ) -> None:
        self.streams = [ImuInput(topic) for topic in declare_topics(node, rig, suffix)]
        self._decode = decode
        self._on_reading = on_reading
        reliable = declare(
            node,
            'reliable',
            False,
            'have lost messages sent again; the publishers must then be reliable, as ours are',
        )
        self.subscriptions = [
            node.create_subscription(
                Imu,
                stream.topic,
                partial(self._on_data, k, stream),
                RELIABLE_QOS if reliable else QOS,
                raw=True,
                event_callbacks=SubscriptionEventCallbacks(matched=stream.on_matched),
                qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            )
            for k, stream in enumerate(self.streams)
        ]

    def _on_data(self, k: int, stream: ImuInput, data: bytes) -> None:
        reading = self._decode(data)
        if reading is None or reading[0] <= 0:
            stream.received += 1
            stream.malformed += 1
            return
        stream.take(reading[0])
        self._on_reading(k, *reading)


def declare_topics(node: Node, rig: Rig, suffix: str) -> Sequence[str]:
    """Return the topic of each IMU of the rig.

    Raises
    ------
    ConfigError
        If the user names another number of topics than the rig has IMUs.
    """
    topics = declare(
        node, 'topics', [''], f'topics to read, in the order of the rig; empty: <name>/{suffix}'
    )
    topics = [topic for topic in topics if topic]
    if topics and len(topics) != len(rig.imus):
        msg = f'Parameter `topics` must name {len(rig.imus)} topics, got {len(topics)}; '
        raise ConfigError(msg + 'name one per IMU of the rig file.')
    return topics or [f'{name}/{suffix}' for name in rig.names]
