"""Why no data arrives: look at the graph and say the reason and the fix, once."""

from collections.abc import Callable, Sequence

from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility
from rclpy.subscription import Subscription

from multiimu_ros.nodes.inputs import ImuInput

PATIENCE_S = 3.0
ENOUGH = 10  # messages without one usable stamp
IMU_TYPE = 'sensor_msgs/msg/Imu'
MAKERS = {
    'data_raw': 'the driver',
    'data_calibrated': 'the calibration node',
    'data_registered': 'the registration node',
    'data': 'the fusion node',
    'odom': 'the fusion node',
}


def explain_silence(node: Node, subscription: Subscription, malformed: int = 0) -> str:
    """Return one sentence: why `subscription` gets nothing usable, and what to do.

    Parameters
    ----------
    subscription : Subscription
        Of an IMU topic.
    malformed : int
        Messages that arrived all the same, without a stamp or unreadable.
    """
    topic = subscription.topic_name
    if malformed:
        return (
            f'`{topic}`: {malformed} messages came without a usable stamp; '
            f'let the driver write the instant of the measurement into header.stamp.'
        )
    publishers = node.get_publishers_info_by_topic(topic)
    if not publishers:
        return _explain_absence(node, topic)
    fitting = [info for info in publishers if info.topic_type == IMU_TYPE]
    if not fitting:
        return f'`{topic}`: its type must be {IMU_TYPE}, got {publishers[0].topic_type}; remap it.'
    for info in fitting:
        verdict, reason = qos_check_compatible(info.qos_profile, subscription.qos_profile)
        if verdict == QoSCompatibility.ERROR:
            return (
                f'`{topic}`: the QoS of {_name(info.node_name)} does not fit '
                f'({reason.strip("; ")}); '
                f'set `qos_overrides.{topic}.subscription.reliability: best_effort`.'
            )
    names = ', '.join(sorted({_name(info.node_name) for info in fitting}))
    return f'`{topic}`: {names} publishes it but sends nothing; look at its diagnostics.'


def _name(node_name: str) -> str:
    """Return what to call a node; its topics may be discovered before its name is."""
    return 'a node without a name yet' if 'UNKNOWN' in node_name else f'/{node_name}'


def _explain_absence(node: Node, topic: str) -> str:
    tail = '/'.join(topic.split('/')[-2:])
    similar = [
        name
        for name, types in node.get_topic_names_and_types()
        if name != topic and name.endswith(f'/{tail}') and node.count_publishers(name)
    ]
    if similar:
        space = similar[0].removesuffix(f'/{tail}') or '/'
        return (
            f'`{topic}`: nobody publishes it, but `{similar[0]}` exists; '
            f'start this node with `--ros-args -r __ns:={space}`, or set `topics`.'
        )
    maker = MAKERS.get(topic.rpartition('/')[2], 'its driver')
    return f'`{topic}`: nobody publishes it; start {maker}, or set `topics`.'


class SilenceWatch:
    """Log once, for each topic that stays silent for 3 s, the reason.

    And once more when it changes: discovery may take longer than these 3 s.

    Parameters
    ----------
    streams, subscriptions : sequences
        What arrived on each topic, and its subscription.
    """

    def __init__(
        self, node: Node, streams: Sequence[ImuInput], subscriptions: Sequence[Subscription]
    ) -> None:
        self._node = node
        self._pairs = list(zip(streams, subscriptions, strict=True))
        self._told: dict[str, str] = {}  # reason by topic, without its numbers

    def check(self, log: Callable[[str], object]) -> None:
        """Look at every topic; called every now and then."""
        news = []
        for stream, subscription in self._pairs:
            unusable = stream.malformed if stream.malformed == stream.received else 0
            if stream.silent_s() < PATIENCE_S and unusable < ENOUGH:
                if not unusable:
                    self._told.pop(stream.topic, None)
                continue
            reason = explain_silence(self._node, subscription, unusable)
            kind = ''.join(letter for letter in reason if not letter.isdigit())
            if self._told.get(stream.topic) != kind:
                self._told[stream.topic] = kind
                news.append(reason)
        if news:
            more = f' (And {len(news) - 1} more topics.)' if len(news) > 1 else ''
            log(news[0] + more)
