"""Hear the raw topics of a board while they are recorded; `multiimu inspect --live` judges them.

It asks for best effort, which every publisher can give, and decodes in handfuls.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
import os
import time
from typing import Protocol

from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu

from multiimu_ros.bags import ImuTrack
from multiimu_ros.nodes.doctor import decode
from multiimu_ros.nodes.endpoints import find_publishers
from multiimu_ros.nodes.inputs import QOS
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.watch import explain_silence, IMU_TYPE, PATIENCE_S

LOOK_S = 0.25
DISCOVERY_S = 4.0  # Fast DDS repeats an announcement that was lost after 3 s
NOBODY = (
    'nobody publishes a topic `*/data_raw` of type sensor_msgs/msg/Imu; start the driver, or name '
    'what to watch with `--topics`.'
)


class Watcher(Protocol):
    """Who judges what was heard."""

    def hear(self, track: ImuTrack) -> None:
        """Take the newest samples of a topic; none where only its name is news."""

    def look(self, silences: Sequence[str]) -> bool:
        """Show what is known; say whether that is all that was wanted."""


class _Ear:
    """One topic: its messages since the last look, and when the last one came."""

    def __init__(self, node: Node, topic: str) -> None:
        self.messages: list[tuple[int, bytes]] = []
        self.heard = time.monotonic()
        self.malformed = 0
        self.subscription: Subscription = node.create_subscription(
            Imu, topic, self._keep, QOS, raw=True
        )
        self.topic: str = self.subscription.topic_name

    def _keep(self, data: bytes) -> None:
        self.messages.append((time.time_ns(), data))

    def take(self) -> ImuTrack:
        """Return what came since the last call."""
        messages, self.messages = self.messages, []
        heard = decode(self.topic, messages)
        samples = heard.track.samples
        stamped = samples.stamp_ns > 0
        self.malformed += heard.malformed + int((~stamped).sum())
        if stamped.any():
            self.heard, self.malformed = time.monotonic(), 0
        received_ns = heard.track.received_ns[stamped]
        return replace(heard.track, samples=samples.select(stamped), received_ns=received_ns)


class InspectNode(Node):
    """Hear Imu topics, hand on what they say, and end when nothing is missing or time is over.

    Parameters
    ----------
    watcher : Watcher
        Who judges.
    topics : sequence of str
        What to hear; without any, every Imu topic named `data_raw`.
    seconds : float or None
        When to end at the latest [s].
    """

    def __init__(self, watcher: Watcher, topics: Sequence[str], seconds: float | None) -> None:
        super().__init__(f'inspect_{os.getpid()}', start_parameter_services=False)
        self._watcher, self._seconds = watcher, seconds
        self._begin = time.monotonic()
        self._named = bool(topics)
        self._ears: dict[str, _Ear] = {}
        for topic in topics:
            self._listen(topic)
        self.create_timer(LOOK_S, self._look)

    def _listen(self, topic: str) -> None:
        ear = _Ear(self, topic)
        self._ears[ear.topic] = ear

    def _look(self) -> None:
        if not self._named:
            for topic, types in self.get_topic_names_and_types():
                fits = topic.endswith('/data_raw') and IMU_TYPE in types
                if fits and topic not in self._ears and find_publishers(self, topic, IMU_TYPE):
                    self._listen(topic)
        for ear in self._ears.values():
            self._watcher.hear(ear.take())
        done = self._watcher.look(list(self._silences()))
        if done or (self._seconds and time.monotonic() > self._begin + self._seconds):
            self.context.try_shutdown()

    def _silences(self) -> Sequence[str]:
        now = time.monotonic()
        if not self._ears:
            return [NOBODY] if now > self._begin + DISCOVERY_S else []
        return [
            explain_silence(self, ear.subscription, ear.malformed)
            for ear in self._ears.values()
            if now > ear.heard + PATIENCE_S
        ]


def listen(watcher: Watcher, topics: Sequence[str], seconds: float | None) -> int:
    """Hear the graph of this domain until nothing is missing, time is over, or Ctrl-C."""
    make_node: Callable[[], Node] = partial(InspectNode, watcher, topics, seconds)
    return run(make_node)
