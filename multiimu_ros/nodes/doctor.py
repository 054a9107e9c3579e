"""Listen to a running graph for some seconds; `multiimu doctor` judges what was heard.

The listener asks for best effort, which every publisher can give, so it hears what others miss.
"""

from functools import partial
import os
import time
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription
from sensor_msgs.msg import Imu

from multiimu_ros.bags import ImuTrack
from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.convert import (
    decode_imu_numbers,
    FORCE,
    FORCE_COVARIANCE,
    IMU_NUMBERS,
    RATE,
    RATE_COVARIANCE,
)
from multiimu_ros.nodes.diagnostics import OK, WARN
from multiimu_ros.nodes.endpoints import (
    find_misfits,
    find_publishers,
    find_subscribers,
    full_name,
    IMU_LIKE,
)
from multiimu_ros.nodes.heard import Complaint, Graph, ImuTopic
from multiimu_ros.nodes.inputs import QOS
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.watch import explain_silence, IMU_TYPE
from multiimu_ros.samples import ImuSamples

KINDS = {IMU_TYPE: Imu, 'nav_msgs/msg/Odometry': Odometry}
LOOK_S = 0.2  # how often new topics are looked for
DISCOVERY_S = 1.0  # from the first topic that is found to the last
PATIENCE_S = 4.0  # until there is one: Fast DDS repeats an announcement that was lost after 3 s
COVARIANCES = np.r_[4:13, RATE_COVARIANCE, FORCE_COVARIANCE]
Heard = tuple[int, bytes]  # when [ns], and what


class DoctorNode(Node):
    """Hear every Imu and Odometry topic, and /diagnostics; end after some seconds.

    Parameters
    ----------
    seconds : float
        How long to listen once there is a topic to listen to [s].

    Attributes
    ----------
    graph : Graph or None
        What was heard, once the time is over.
    """

    def __init__(self, seconds: float) -> None:
        super().__init__(f'doctor_{os.getpid()}', start_parameter_services=False)
        self.graph: Graph | None = None
        self._ears: dict[str, tuple[Subscription, float, list[Heard]]] = {}
        self._statuses: dict[str, Complaint | None] = {}
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, QOS)
        self._seconds = seconds
        self._settled = False
        self._end = time.monotonic() + PATIENCE_S
        self.create_timer(LOOK_S, self._look)

    def _look(self) -> None:
        now = time.monotonic()
        if now > self._end:
            self.graph = self._describe()
            self.context.try_shutdown()
            return
        if self._ears and not self._settled and now > self._end - self._seconds:
            self._settled = True
            for _, _, messages in self._ears.values():
                messages.clear()  # while subscribing, the listener itself misses some
        for topic, types in self.get_topic_names_and_types():
            for kind in KINDS.keys() & types:
                if topic not in self._ears and find_publishers(self, topic, kind):
                    self._listen(topic, kind)

    def _listen(self, topic: str, kind: str) -> None:
        if not self._ears:
            self._end = time.monotonic() + DISCOVERY_S + self._seconds
        messages: list[Heard] = []
        callback = partial(_keep, messages)
        ear = self.create_subscription(KINDS[kind], topic, callback, QOS, raw=True)
        self._ears[topic] = ear, time.monotonic(), messages

    def _on_diagnostics(self, msg: Any) -> None:
        for status in msg.status:
            level = 'warning' if status.level == WARN else 'error'
            self._statuses[status.name] = (
                None if status.level == OK else Complaint(status.name, level, status.message)
            )

    def _describe(self) -> Graph:
        present = dict(self.get_topic_names_and_types())
        imus = [t for t in sorted(present) if IMU_TYPE in present[t] or IMU_LIKE.search(t)]
        odometries = sorted(self._ears.keys() - set(imus))
        names = [f'{space.rstrip("/")}/{n}' for n, space in self.get_node_names_and_namespaces()]
        misfits = [misfit for topic in imus for misfit in find_misfits(self, topic)]
        return Graph(
            domain_id=self.context.get_domain_id(),
            nodes=tuple(sorted(name for name in names if name != f'/{self.get_name()}')),
            imus=tuple(self._describe_imu(topic) for topic in imus if topic in self._ears),
            odometries={topic: len(self._ears[topic][2]) for topic in odometries},
            complaints=(*misfits, *filter(None, self._statuses.values())),
            simulated_time=self.count_publishers('/clock') > 0,
        )

    def _describe_imu(self, topic: str) -> ImuTopic:
        ear, begin, messages = self._ears[topic]
        silent = not messages and time.monotonic() - begin > DISCOVERY_S
        reason = explain_silence(self, ear).removeprefix(f'`{topic}`: ') if silent else ''
        publishers = find_publishers(self, topic, IMU_TYPE)
        subscribers = find_subscribers(self, topic)
        return decode(
            topic,
            messages,
            publishers=tuple(sorted(map(full_name, publishers))),
            subscribers=tuple(sorted(map(full_name, subscribers))),
            silence=reason,
        )


def _keep(messages: list[Heard], data: bytes) -> None:
    messages.append((time.time_ns(), data))


def decode(topic: str, messages: list[Heard], **ends: Any) -> ImuTopic:
    """Return what the messages of one Imu topic say.

    Parameters
    ----------
    messages : list of (int, bytes)
        When each came [ns], and its bytes.
    ends : mapping
        The other fields of an ImuTopic.
    """
    readings = [(when_ns, decode_imu_numbers(data)) for when_ns, data in messages]
    good = [(when_ns, *reading) for when_ns, reading in readings if reading is not None]
    numbers = np.array([row[3] for row in good]).reshape(-1, IMU_NUMBERS)
    stamp_ns = np.array([row[1] for row in good], np.int64)
    samples = ImuSamples(stamp_ns, numbers[:, RATE], numbers[:, FORCE])
    frame_id = good[-1][2] if good else ''
    received_ns = np.array([row[0] for row in good], np.int64)
    return ImuTopic(
        track=ImuTrack(topic, frame_id, samples, received_ns),
        orientation=numbers[:, :4],
        covariances=numbers[:, COVARIANCES].reshape(-1, 3, 3, 3),
        frames=frozenset(row[2] for row in good),
        malformed=len(messages) - len(good),
        **ends,
    )


def listen(seconds: float) -> Graph:
    """Listen to the graph of this domain.

    Raises
    ------
    ConfigError
        If it was interrupted.
    """
    nodes: list[DoctorNode] = []

    def make_node() -> DoctorNode:
        nodes.append(DoctorNode(seconds))
        return nodes[0]

    run(make_node)
    if not nodes or nodes[0].graph is None:
        msg = f'`doctor` must listen for {seconds:g} s, but was interrupted; let it finish.'
        raise ConfigError(msg)
    return nodes[0].graph
