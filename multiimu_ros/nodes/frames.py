"""Which frame the fused IMU is in, live and in `multiimu fuse`; nothing here needs ROS."""

from collections.abc import Sequence

from multiimu_ros.errors import ConfigError


def fused_frame_id(base_frame: str, virtual_imu: Sequence[float], virtual_imu_frame: str) -> str:
    """Return the frame of `imu/data`, whose specific force is that of one point of the rig.

    Parameters
    ----------
    base_frame : str
        Frame of the rig.
    virtual_imu : 3 floats
        Where the fused IMU sits, in the base frame [m].
    virtual_imu_frame : str
        Frame with the axes of the base frame and its origin there; '' where that is the base.

    Raises
    ------
    ConfigError
        If the fused IMU sits elsewhere than the origin of the only frame that is known.
    """
    if not virtual_imu_frame and any(virtual_imu):
        msg = (
            f'`virtual_imu_frame` must name the frame of the point {tuple(virtual_imu)} that '
            f"`virtual_imu` asks for, got ''; `{base_frame}` has its origin elsewhere."
        )
        raise ConfigError(msg)
    return virtual_imu_frame or base_frame
