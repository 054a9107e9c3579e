"""Run one node until it is asked to stop: executor, signals and shutdown in one place.

rclpy's own signal handlers invalidate the context first, so that a node's last message fails and
a second signal interrupts its destruction.  Here a signal only ends the loop; the node is then
destroyed while its context still lives, and signals that come later are ignored.  A node that is
still being made gets a moment to be made and destroyed, and then the process just ends.

The events executor is the fast one, but never wakes when it is spun without a timeout; the
single-threaded one stands in where rclpy has no other.
"""

from collections.abc import Callable
from contextlib import suppress
import gc
import os
import signal
import sys
from threading import Timer

import rclpy
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from multiimu_ros.errors import ConfigError, MultiImuError

try:
    from rclpy.experimental import EventsExecutor
except ImportError:  # an rclpy older than Jazzy's
    EventsExecutor = None

SIGNALS = (signal.SIGINT, signal.SIGTERM)
WAKE_S = 0.1  # how often the loop looks whether it was asked to stop
CONSTRUCTION_S = 1.0  # how long a node that is asked to stop may still be under construction


def spin(node: Node, stop: Future) -> None:
    """Serve `node` until `stop` is done or the node has shut its context down."""
    executor: Executor = EventsExecutor() if EventsExecutor else SingleThreadedExecutor()
    executor.add_node(node)
    gc.freeze()  # else a full collection stalls the node for as long as 30 messages last
    with suppress(ExternalShutdownException):
        while rclpy.ok() and not stop.done():
            if EventsExecutor:
                executor.spin_until_future_complete(stop, timeout_sec=WAKE_S)
            else:  # here spin_until_future_complete would leave a task behind at every turn
                executor.spin_once(timeout_sec=WAKE_S)
    executor.shutdown()


def _init() -> None:
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # rcl refuses a parameter file, or a `--ros-args` option
        reason = str(error).splitlines()[0].split(', at ')[0].rstrip('.')
        msg = f'The ROS arguments are wrong: {reason}; correct what follows `--ros-args`.'
        raise ConfigError(msg) from error


def run(make_node: Callable[[], Node]) -> int:
    """Make a node and serve it until SIGINT or SIGTERM; return the exit code of the process.

    Parameters
    ----------
    make_node : callable
        Makes the node, usually its class.  A node that ends by itself calls
        `self.context.try_shutdown()`.

    Returns
    -------
    int
        0 after a signal or the node's own end; 1, with one sentence on stderr, where the node
        meets an error that only its user can mend.
    """
    stop = Future()
    node = None

    def give_up() -> None:
        if node is None:
            os._exit(0)

    def ask(*_: object) -> None:
        stop.set_result(None)
        if node is None:  # its constructor may compile kernels for a minute
            patience = Timer(CONSTRUCTION_S, give_up)
            patience.daemon = True
            patience.start()

    for number in SIGNALS:
        signal.signal(number, ask)
    try:
        _init()
        node = make_node()
        spin(node, stop)
    except MultiImuError as error:
        sys.stderr.write(f'{error}\n')
        return 1
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        for number in SIGNALS:  # Python, on its way out, would die of a second Ctrl-C
            signal.signal(number, signal.SIG_IGN)
    return 0
