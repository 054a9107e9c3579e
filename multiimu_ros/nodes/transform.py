"""The transform odom -> base, for those who ask for it; tf2_ros is needed only then."""

from importlib import import_module

from geometry_msgs.msg import TransformStamped
import numpy as np
from rclpy.node import Node

from multiimu_ros.arrays import NANOSECONDS, Vector
from multiimu_ros.errors import ConfigError
from multiimu_ros.fused_frame import FusedFrame
from multiimu_ros.rotations import skew


class TransformOutput:
    """Broadcast where the rig's base frame is, whichever of its points the odometry follows.

    A frame has one parent: were it the virtual IMU's, which a robot's description hangs below the
    base frame, the two would contradict each other.

    Parameters
    ----------
    node : Node
        Publishes `/tf`.
    odom_frame, base_frame : str
        Parent and child.
    point_b : (3,) array
        What the odometry follows, in the base frame [m].

    Raises
    ------
    ConfigError
        If tf2_ros cannot be imported; says what to install.
    """

    def __init__(self, node: Node, odom_frame: str, base_frame: str, point_b: Vector) -> None:
        try:
            tf2_ros = import_module('tf2_ros')
        except ImportError as error:
            # The C++ package ros-jazzy-tf2-ros holds no Python module.
            msg = f'`publish_tf` needs tf2_ros ({error}); install ros-jazzy-tf2-ros-py.'
            raise ConfigError(msg) from error
        self._broadcaster = tf2_ros.TransformBroadcaster(node)
        self._point_b = point_b
        self._msg = TransformStamped(child_frame_id=base_frame)
        self._msg.header.frame_id = odom_frame

    def send(self, frame: FusedFrame) -> None:
        """Broadcast the base frame's pose at this instant."""
        stamp, transform = self._msg.header.stamp, self._msg.transform
        stamp.sec, stamp.nanosec = divmod(frame.stamp_ns, NANOSECONDS)
        t, q = transform.translation, transform.rotation
        x, y, z, w = frame.odom_orientation.tolist()
        cross = skew(np.array([x, y, z]))
        # What a unit quaternion (a, w) does to a vector v: v + 2 w (a x v) + 2 a x (a x v).
        across = 2.0 * cross @ self._point_b
        base = frame.position_n - (self._point_b + w * across + cross @ across)
        t.x, t.y, t.z = base.tolist()
        q.x, q.y, q.z, q.w = x, y, z, w
        self._broadcaster.sendTransform(self._msg)
