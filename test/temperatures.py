"""Temperature messages for the tests of what is noted about a recording."""

from rosbags.typesys import get_typestore, Stores

STORE = get_typestore(Stores.ROS2_JAZZY)


def temperature(celsius, frame_id='imu0_link', little=True):
    """Return a Temperature message as another library serialises it."""
    types = STORE.types
    stamp = types['builtin_interfaces/msg/Time'](sec=1, nanosec=2)
    header = types['std_msgs/msg/Header'](stamp=stamp, frame_id=frame_id)
    message = types['sensor_msgs/msg/Temperature'](header, celsius, 0.0)
    name = 'sensor_msgs/msg/Temperature'
    return bytes(STORE.serialize_cdr(message, name, little_endian=little))
