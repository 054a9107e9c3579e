"""The transform odom -> base, for those who ask for it; tf2_ros is needed only then."""

from importlib import import_module

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.errors import ConfigError
from multiimu_ros.fused_frame import FusedFrame


class TransformOutput:
    """Broadcast the odometry's pose.

    Raises
    ------
    ConfigError
        If tf2_ros cannot be imported; says what to install.
    """

    def __init__(self, node: Node, odom_frame: str, base_frame: str) -> None:
        try:
            tf2_ros = import_module('tf2_ros')
        except ImportError as error:
            # The C++ package ros-jazzy-tf2-ros holds no Python module.
            msg = f'`publish_tf` needs tf2_ros ({error}); install ros-jazzy-tf2-ros-py.'
            raise ConfigError(msg) from error
        self._broadcaster = tf2_ros.TransformBroadcaster(node)
        self._msg = TransformStamped(child_frame_id=base_frame)
        self._msg.header.frame_id = odom_frame

    def send(self, frame: FusedFrame) -> None:
        """Broadcast the pose of this frame."""
        stamp, transform = self._msg.header.stamp, self._msg.transform
        stamp.sec, stamp.nanosec = divmod(frame.stamp_ns, NANOSECONDS)
        t, q = transform.translation, transform.rotation
        t.x, t.y, t.z = frame.position_n.tolist()
        q.x, q.y, q.z, q.w = frame.odom_orientation.tolist()
        self._broadcaster.sendTransform(self._msg)
