"""The executables of ROS: a signal ends them with exit code 0 from their first moment on.

Importing rclpy and numba takes a second, in which Python would answer SIGINT with a traceback.
So this module imports nothing of that kind, listens first, and imports afterwards.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
import os
from pathlib import Path
import signal
import sys

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def ended_by_signals() -> Iterator[None]:
    """End the process at once on a signal, until the program has handlers of its own.

    Afterwards signals are ignored: Ctrl-C in a terminal reaches a process that `ros2 launch`
    started twice, and Python would die of the second one on its way out.
    """
    for number in SIGNALS:
        signal.signal(number, lambda *_: os._exit(0))  # there is nothing to clean up yet
    try:
        yield
    finally:
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def main() -> int:
    """Run the node, or the emulator, that this process is called after."""
    name = Path(sys.argv[0]).name
    room = 'cli' if name == 'emulator' else 'nodes'
    with ended_by_signals():
        return int(import_module(f'multiimu_ros.{room}.{name}').main() or 0)
