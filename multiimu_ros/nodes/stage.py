"""What the nodes of one stage share: K topics in, K topics out, a line per IMU on /diagnostics."""

from collections.abc import Callable
from functools import lru_cache
from math import isfinite
from typing import Any, Protocol

from rclpy.node import Node
from sensor_msgs.msg import Imu

from multiimu_ros.arrays import Vector
from multiimu_ros.nodes.convert import StampedEncoder
from multiimu_ros.nodes.diagnostics import Diagnostics, ERROR, OK, STALE, Status, WARN
from multiimu_ros.nodes.inputs import declare_rig, ImuInputs
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.parameters import warn_about_unused
from multiimu_ros.nodes.watch import SilenceWatch
from multiimu_ros.rig import Rig

SILENT_S = 0.5  # an IMU slower than 2 Hz is of no use here
encoder_for = lru_cache(maxsize=64)(StampedEncoder)


Message = tuple[int, str, Vector]  # stamp [ns], frame, the 37 numbers of an Imu


def send_finite(output: Output, message: Message) -> bool:
    """Publish a message, unless one of its numbers is none; say whether it went out."""
    stamp_ns, frame_id, numbers = message
    if not isfinite(numbers.sum()):
        return False
    output.send(encoder_for(frame_id).encode(stamp_ns, numbers))
    return True


class Stage(Protocol):
    """What one stage does to a message."""

    def convert(
        self, k: int, stamp_ns: int, frame_id: str, reading: Any, rate_hz: float, /
    ) -> Message:
        """Return what goes out for this reading of IMU k, which comes at this rate."""


class StageNode(Node):
    """Turn each message of `imu<k>/<suffix_in>` into one of `imu<k>/<suffix_out>`.

    Parameters
    ----------
    name : str
        Of the node.
    suffix_in, suffix_out : str
        Last part of the topics' names.
    decode : callable
        How to read a message.
    make_stage : callable
        Makes the stage for a rig.
    """

    def __init__(
        self,
        name: str,
        suffix_in: str,
        suffix_out: str,
        decode: Callable[[bytes], tuple[int, str, Any] | None],
        make_stage: Callable[[Rig], Stage],
    ) -> None:
        super().__init__(name)
        self.rig = declare_rig(self)
        self._stage = make_stage(self.rig)
        self._invalid = [0] * len(self.rig.imus)
        self._outputs = [Output(self, Imu, f'{name}/{suffix_out}') for name in self.rig.names]
        self._inputs = ImuInputs(self, self.rig, suffix_in, decode, self._on_reading)
        self._watch = SilenceWatch(self, self._inputs.streams, self._inputs.subscriptions)
        self._diagnostics = Diagnostics(self, self.rig.rig.name, self._report)
        warn_about_unused(self)

    def _on_reading(self, k: int, stamp_ns: int, frame_id: str, reading: Any) -> None:
        output = self._outputs[k]
        if not output.wanted:
            return
        rate_hz = self._inputs.streams[k].rate_hz
        message = self._stage.convert(k, stamp_ns, frame_id, reading, rate_hz)
        if not send_finite(output, message):
            self._invalid[k] += 1
            return
        self._diagnostics.latency.note(stamp_ns)

    def _report(self) -> list[Status]:
        self._watch.check(self.get_logger().warning)
        return [self._imu_status(k) for k in range(len(self.rig.imus))]

    def _imu_status(self, k: int) -> Status:
        stream, invalid = self._inputs.streams[k], self._invalid[k]
        stream.measure_rate()
        figures = {
            'rate [Hz]': stream.rate_hz,
            'received': stream.received,
            'malformed': stream.malformed,
            'not finite': invalid,
            'publishers': stream.publishers,
            'subscribers': self._outputs[k].subscribers,
        }
        level, message = OK, 'ok'
        if not stream.received:
            level, message = STALE, f'nothing came yet on {stream.topic}'
        elif stream.silent_s() > SILENT_S:
            level, message = ERROR, 'absent'
        elif stream.malformed or invalid:
            level, message = WARN, 'some messages were unusable'
        return Status(self.rig.names[k], level, message, figures)
