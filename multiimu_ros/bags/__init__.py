"""Recordings in rosbag2's format, read and written without ROS."""

from multiimu_ros.bags.reader import (
    find_imu_topics,
    ImuRecording,
    ImuTrack,
    list_topics,
    Message,
    read_imus,
    read_messages,
    Topic,
)
from multiimu_ros.bags.writer import BagWriter

__all__ = [
    'BagWriter',
    'ImuRecording',
    'ImuTrack',
    'Message',
    'Topic',
    'find_imu_topics',
    'list_topics',
    'read_imus',
    'read_messages',
]
