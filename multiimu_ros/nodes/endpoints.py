"""Who publishes and subscribes to an IMU topic, and which of them do not fit together."""

import re
from types import SimpleNamespace

from rclpy.node import Node
from rclpy.qos import qos_check_compatible, QoSCompatibility
from rclpy.topic_endpoint_info import TopicEndpointInfo

from multiimu_ros.nodes.heard import Complaint
from multiimu_ros.nodes.watch import explain_silence, IMU_TYPE

IMU_LIKE = re.compile(r'/imu[^/]*/data(_raw|_calibrated|_registered)?$')


def full_name(info: TopicEndpointInfo) -> str:
    """Return the name of the node at one end of a topic, with its namespace."""
    return f'{info.node_namespace.rstrip("/")}/{info.node_name}'


def find_publishers(node: Node, topic: str, kind: str) -> list[TopicEndpointInfo]:
    """Return who publishes a topic under this type."""
    return [info for info in node.get_publishers_info_by_topic(topic) if info.topic_type == kind]


def find_subscribers(node: Node, topic: str) -> list[TopicEndpointInfo]:
    """Return who but `node` subscribes to a topic, under whatever type."""
    infos = node.get_subscriptions_info_by_topic(topic)
    return [info for info in infos if info.node_name != node.get_name()]


def why_silent(node: Node, topic: str, subscriber: TopicEndpointInfo) -> str:
    """Return why a subscriber hears nothing, without the name of the topic."""
    end = SimpleNamespace(topic_name=topic, qos_profile=subscriber.qos_profile)
    return explain_silence(node, end).removeprefix(f'`{topic}`: ')


def find_misfits(node: Node, topic: str) -> list[Complaint]:
    """Say which ends of an IMU topic cannot hear each other: type, name, quality of service."""
    subscribers = find_subscribers(node, topic)
    ends = [*node.get_publishers_info_by_topic(topic), *subscribers]
    wrong = [
        (info, f'its type is {info.topic_type} where {IMU_TYPE} belongs; remap it.')
        for info in ends
        if info.topic_type != IMU_TYPE
    ]
    fitting = find_publishers(node, topic, IMU_TYPE)
    deaf = [
        (info, why_silent(node, topic, info))
        for info in subscribers
        if info.topic_type == IMU_TYPE
        and (not fitting or any(_refused(publisher, info) for publisher in fitting))
    ]
    return [
        Complaint(f'{full_name(info)} on {topic}', 'error', text) for info, text in wrong + deaf
    ]


def _refused(publisher: TopicEndpointInfo, subscriber: TopicEndpointInfo) -> bool:
    verdict, _ = qos_check_compatible(publisher.qos_profile, subscriber.qos_profile)
    return bool(verdict == QoSCompatibility.ERROR)
