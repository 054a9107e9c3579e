"""Message types by name, for the nodes that move messages without knowing them."""

from importlib import import_module
from typing import Any

from multiimu_ros.errors import ConfigError


def message_class(type_name: str) -> Any:
    """Return the Python class of a type such as `sensor_msgs/msg/Imu`.

    Raises
    ------
    ConfigError
        If its package is not installed.
    """
    package, _, name = type_name.replace('/', '.').rpartition('.')
    try:
        return getattr(import_module(package), name)
    except (ImportError, AttributeError, ValueError) as error:
        msg = f'The message type `{type_name}` must be installed, but is not; install its package.'
        raise ConfigError(msg) from error
