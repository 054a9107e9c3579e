"""Topics out: serialised bytes, and nothing at all for a topic that nobody subscribes to."""

from typing import Any

from rclpy.event_handler import PublisherEventCallbacks, QoSPublisherMatchedInfo
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.qos_overriding_options import QoSOverridingOptions

DEPTH = 200


class Output:
    """A publisher that knows its `subscribers`, and whether it is `wanted`.

    The middleware reports each subscriber that comes or goes; asking it per message costs more
    than the message.

    Parameters
    ----------
    kind : type
        The message class.
    topic : str
        Its name, relative to the node's namespace.
    """

    def __init__(self, node: Node, kind: type[Any], topic: str) -> None:
        self.subscribers = 0
        self.wanted = False
        self.publisher = node.create_publisher(
            kind,
            topic,
            QoSProfile(depth=DEPTH),
            event_callbacks=PublisherEventCallbacks(matched=self._on_matched),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        self.send = self.publisher.publish

    def _on_matched(self, info: QoSPublisherMatchedInfo) -> None:
        self.subscribers = info.current_count
        self.wanted = self.subscribers > 0
