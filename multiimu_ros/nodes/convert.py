"""ROS messages to numbers and back, on the serialised bytes.

The middleware costs more than the filters, so IMU messages are read and written as bytes.  Every
message of the live path has one shape: a stamp, one or two frame names, then doubles to the end.

    offset 0   encapsulation, 4 bytes: 0, then 1 for little or 0 for big endian
    offset 4   stamp: int32 seconds, uint32 nanoseconds
    then       strings: uint32 length with the final zero, bytes; each starts on a multiple of 4
    then       doubles; they start on a multiple of 8

where alignment counts from offset 4 (OMG CDR, formal/2021-03-02 section 15.3; RTPS 2.5 section
10.5).  What does not look like that goes through rclpy's own deserialisation.  Quaternions are
x, y, z, w and appear here only.
"""

import struct

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from multiimu_ros import fused_frame as record
from multiimu_ros.arrays import Matrix, NANOSECONDS, Vector
from multiimu_ros.fused_frame import FusedFrame

Reading = tuple[int, str, tuple[float, ...]]  # stamp [ns], frame, angular rate and specific force

# By encapsulation: stamp and length of the frame's name; rate, force (a covariance between them);
# the doubles' type.
LAYOUTS = {
    b'\x00\x01': (struct.Struct('<iII'), struct.Struct('<3d72x3d'), '<f8'),
    b'\x00\x00': (struct.Struct('>iII'), struct.Struct('>3d72x3d'), '>f8'),
}
IMU_NUMBERS = 37  # quaternion 4, covariance 9, rate 3, covariance 9, force 3, covariance 9
RATE_START = 13
RATE, FORCE = slice(13, 16), slice(25, 28)  # where they stand among the 37
# A valid quaternion, for consumers that normalise before they look; then -1: no orientation.
NO_ORIENTATION = np.array([0.0, 0.0, 0.0, 1.0, -1.0, *np.zeros(8)])
RATE_AND_FORCE = [13, 14, 15, 25, 26, 27]
RATE_COVARIANCE, FORCE_COVARIANCE = slice(16, 25), slice(28, 37)


def _places(*blocks: tuple[int, int]) -> NDArray[np.intp]:
    """Return the indices of blocks of a frame's record, each given by its start and size."""
    return np.concatenate([np.arange(start, start + size) for start, size in blocks])


IMU_PLACES = _places(
    (record.ORIENTATION, 4), (record.ORIENTATION_P, 9), (record.RATE, 3), (record.RATE_P, 9),
    (record.FORCE, 3), (record.FORCE_P, 9),
)  # fmt: skip
ODOMETRY_PLACES = _places(
    (record.POSITION, 3), (record.ODOM_ORIENTATION, 4), (record.POSE_P, 36),
    (record.VELOCITY, 3), (record.RATE, 3), (record.TWIST_P, 36),
)  # fmt: skip


def decode_imu(data: bytes) -> Reading | None:
    """Read one serialised sensor_msgs/Imu.

    Parameters
    ----------
    data : bytes
        As a raw subscription delivers it.

    Returns
    -------
    (int, str, tuple) or None
        Stamp [ns], frame, and six floats: angular rate [rad/s], then specific force [m/s^2];
        None for bytes that are no Imu.
    """
    head = _head(data)
    if head is None:
        return _decode_imu_slowly(data)
    stamp_ns, frame_id, offset = head
    values = LAYOUTS[data[:2]][1].unpack_from(data, offset + 8 * RATE_START)
    return stamp_ns, frame_id, values


def decode_imu_numbers(data: bytes) -> tuple[int, str, Vector] | None:
    """Read one serialised sensor_msgs/Imu with its covariances, as (37,) numbers."""
    head = _head(data)
    if head is None:
        return _decode_slowly(data)
    stamp_ns, frame_id, offset = head
    return stamp_ns, frame_id, np.frombuffer(data, LAYOUTS[data[:2]][2], IMU_NUMBERS, offset)


def _head(data: bytes) -> tuple[int, str, int] | None:
    """Return stamp [ns], frame and the place of the first double, or None if in doubt."""
    layout = LAYOUTS.get(data[:2])
    if layout is None or len(data) < 16:
        return None
    seconds, nanoseconds, length = layout[0].unpack_from(data, 4)
    offset = 4 + (12 + length + 7 & -8)
    if length == 0 or len(data) != offset + 8 * IMU_NUMBERS:
        return None
    frame_id = data[16 : 15 + length].decode('utf-8', 'replace')
    return seconds * NANOSECONDS + nanoseconds, frame_id, offset


def _decode_imu_slowly(data: bytes) -> Reading | None:
    reading = _decode_slowly(data)
    if reading is None:
        return None
    stamp_ns, frame_id, numbers = reading
    return stamp_ns, frame_id, (*numbers[RATE].tolist(), *numbers[FORCE].tolist())


def _decode_slowly(data: bytes) -> tuple[int, str, Vector] | None:
    try:
        msg = deserialize_message(bytes(data), Imu)
    except RuntimeError:  # rclpy's RMWError
        return None
    q, w, f = msg.orientation, msg.angular_velocity, msg.linear_acceleration
    numbers = [q.x, q.y, q.z, q.w, *msg.orientation_covariance, w.x, w.y, w.z]
    numbers += [*msg.angular_velocity_covariance, f.x, f.y, f.z]
    numbers += msg.linear_acceleration_covariance.tolist()
    stamp_ns = msg.header.stamp.sec * NANOSECONDS + msg.header.stamp.nanosec
    return stamp_ns, msg.header.frame_id, np.array(numbers)


class StampedEncoder:
    """Write messages that are a stamp, fixed frame names, and doubles.

    That is sensor_msgs/Imu (frame_id; 37 numbers), nav_msgs/Odometry (frame_id, child_frame_id;
    85) and geometry_msgs/TwistWithCovarianceStamped (frame_id; 42).

    Parameters
    ----------
    frames : str
        The names, in the order of the message.
    """

    def __init__(self, *frames: str) -> None:
        text = bytes(8)  # the place of the stamp
        for frame in frames:
            name = frame.encode() + b'\x00'
            text += bytes(-len(text) % 4) + struct.pack('<I', len(name)) + name
        self._names = text[8:] + bytes(-len(text) % 8)

    def encode(self, stamp_ns: int, numbers: Vector) -> bytes:
        """Return the serialised message with these (M,) doubles."""
        stamp = struct.pack('<iI', *divmod(stamp_ns, NANOSECONDS))
        doubles = numbers.astype('<f8', copy=False).tobytes()
        return b'\x00\x01\x00\x00' + stamp + self._names + doubles


def imu_numbers(rate_covariance: Matrix, force_covariance: Matrix) -> Vector:
    """Return the (37,) numbers of an Imu without orientation; RATE and FORCE are to be filled in.

    Parameters
    ----------
    rate_covariance, force_covariance : (3, 3) arrays
        Of the angular rate [rad^2/s^2] and the specific force [m^2/s^4]; zeros are unknown.
    """
    numbers = np.zeros(IMU_NUMBERS)
    numbers[:13] = NO_ORIENTATION
    numbers[RATE_COVARIANCE] = rate_covariance.ravel()
    numbers[FORCE_COVARIANCE] = force_covariance.ravel()
    return numbers


def fused_imu_numbers(frame: FusedFrame) -> Vector:
    """Return the (37,) numbers of `imu/data`: orientation, rate and force with covariances."""
    return frame.record.take(IMU_PLACES)


def odometry_numbers(frame: FusedFrame) -> Vector:
    """Return the (85,) numbers of `odom`: pose in `odom`, twist in the base frame."""
    return frame.record.take(ODOMETRY_PLACES)


def still_twist_numbers(frame: FusedFrame) -> Vector:
    """Return the (42,) numbers of `zero_velocity`: twist zero, with the frame's covariance."""
    numbers = np.zeros(42)
    numbers[6:] = frame.record[record.TWIST_P : record.BIAS]
    return numbers
