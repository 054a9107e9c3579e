"""ROS 2 node: registered readings of all IMUs to one IMU and an odometry.

`zero_velocity` is a geometry_msgs/TwistWithCovarianceStamped in the base frame, one per frame in
which the rig stands still and none while it moves: a filter downstream takes it as a measurement.
`fusion/health` is described in `health`.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from math import isfinite
from pathlib import Path
import sys
from threading import Timer
from typing import Any

from geometry_msgs.msg import TwistWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from sensor_msgs.msg import Imu
from std_srvs.srv import SetBool, Trigger

from multiimu_ros.arrays import Vector
from multiimu_ros.errors import ConfigError, MultiImuError
from multiimu_ros.fused_frame import FusedFrame
from multiimu_ros.nodes import convert
from multiimu_ros.nodes.biases import with_biases
from multiimu_ros.nodes.diagnostics import Diagnostics, Status
from multiimu_ros.nodes.health import HealthOutput, HealthReport
from multiimu_ros.nodes.inputs import declare_rig, ImuInput, ImuInputs
from multiimu_ros.nodes.kept_state import KeptState
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.parameters import declare, declare_config, warn_about_unused
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.statuses import FusionReport
from multiimu_ros.nodes.transform import TransformOutput
from multiimu_ros.nodes.watch import SilenceWatch
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.pipeline_config import fused_frame_id, Input
from multiimu_ros.rig import save_rig

PATIENCE_S = 3.0
COMPILING = 'Compiling the filters, once for this installation; it may take a minute ...'
REST, REST_SIGMA = (0.0, 0.0, 0.0, 0.0, 0.0, 9.80665), (1e-3, 1e-3, 1e-3, 1e-2, 1e-2, 1e-2)


@contextmanager
def explained(say: Callable[[str], Any]) -> Iterator[None]:
    """Say what takes so long, where it does."""
    patience = Timer(PATIENCE_S, say, [COMPILING])
    patience.start()
    try:
        yield
    finally:
        patience.cancel()


def warm_up(pipeline: Pipeline, imus: int) -> None:
    """Run a scratch pipeline for a second of rest, so that no kernel is compiled under load.

    With noise: filters that learn theirs would make nonsense of readings that never change.
    """
    noise = np.random.default_rng(1).normal(REST, REST_SIGMA, (200, imus, 6))
    for scan, values in enumerate(noise):
        for k in range(imus):
            pipeline.push(k, scan * 5_000_000 + 1, values[k])


class FusionNode(Node):
    """Hear `imu<k>/data_registered`; say `imu/data`, `odom`, `zero_velocity`, `fusion/health`.

    Attributes
    ----------
    failure : MultiImuError or None
        What has ended the node while it ran.
    """

    def __init__(
        self, name: str = 'fusion', suffix: str = 'data_registered', kind: Input = 'registered'
    ) -> None:
        super().__init__(name)
        self.rig = declare_rig(self)
        config = declare_config(self, PipelineConfig, input=kind)
        with explained(self.get_logger().info):
            warm_up(Pipeline(self.rig, config), len(self.rig.imus))
        self.pipeline = Pipeline(self.rig, config)
        self._declare_outputs(self._declare_frame(config), np.array(config.virtual_imu))
        self._serve()
        self.kept_state = KeptState(self, self.pipeline)
        self.not_finite = 0
        self.failure: MultiImuError | None = None
        self._watch: SilenceWatch | None = None
        self.streams = self.open_inputs(suffix)
        self._fusion_report = FusionReport(self.pipeline, self.streams)
        health = HealthReport(self.pipeline, self.streams)
        self._health = HealthOutput(self, self.rig.rig.name, health)
        self.diagnostics = Diagnostics(self, self.rig.rig.name, self.report)
        warn_about_unused(self)

    def open_inputs(self, suffix: str) -> Sequence[ImuInput]:
        """Subscribe to the topics of the IMUs."""
        inputs = ImuInputs(self, self.rig, suffix, convert.decode_imu, self.on_reading)
        self._watch = SilenceWatch(self, inputs.streams, inputs.subscriptions)
        return inputs.streams

    def _declare_frame(self, config: PipelineConfig) -> str:
        words = 'frame of the point `virtual_imu`; empty: the base frame, for the base origin'
        name = declare(self, 'virtual_imu_frame', '', words)
        return fused_frame_id(self.rig.rig.base_frame, config.virtual_imu, name)

    def _declare_outputs(self, fused_frame: str, point_b: Vector) -> None:
        odom_frame = declare(self, 'odom_frame', 'odom', 'frame that the odometry starts in')
        self._imu_encoder = convert.StampedEncoder(fused_frame)
        self._odometry_encoder = convert.StampedEncoder(odom_frame, fused_frame)
        self._imu = Output(self, Imu, 'imu/data')
        self._odometry = Output(self, Odometry, 'odom')
        self._zero_velocity = Output(self, TwistWithCovarianceStamped, 'zero_velocity')
        publish_tf = declare(self, 'publish_tf', False, 'publish the transform odom -> base')
        frames = odom_frame, self.rig.rig.base_frame
        self._transform = TransformOutput(self, *frames, point_b) if publish_tf else None

    def _serve(self) -> None:
        self.create_service(Trigger, '~/reset', self._on_reset)
        self.create_service(Trigger, '~/save_biases', self._on_save_biases)
        for k, name in enumerate(self.rig.names):
            self.create_service(SetBool, f'~/enable_{name}', partial(self._on_enable, k))

    def on_reading(self, k: int, stamp_ns: int, frame_id: str, values: Sequence[float]) -> None:
        """Push one reading into the pipeline and publish what became due."""
        del frame_id  # the rig file says where the IMU is
        try:
            frames = self.pipeline.push(k, stamp_ns, values)
        except MultiImuError as error:  # rclpy would print its own words about an exception
            self.failure = error
            self.context.try_shutdown()
            return
        for frame in frames:
            self._health.note(frame)
            self._publish(frame)

    def _publish(self, frame: FusedFrame) -> None:
        if not isfinite(frame.record.sum()):
            self.not_finite += 1
            return
        if self._imu.wanted:
            imu = convert.fused_imu_numbers(frame)
            self._imu.send(self._imu_encoder.encode(frame.stamp_ns, imu))
        if self._odometry.wanted:
            odometry = convert.odometry_numbers(frame)
            self._odometry.send(self._odometry_encoder.encode(frame.stamp_ns, odometry))
        if frame.still and self._zero_velocity.wanted:
            twist = convert.still_twist_numbers(frame)
            self._zero_velocity.send(self._imu_encoder.encode(frame.stamp_ns, twist))
        if self._transform is not None:
            self._transform.send(frame)
        self.diagnostics.latency.note(frame.stamp_ns)

    def report(self) -> list[Status]:
        """Return the statuses of fusion and of each IMU."""
        if self._watch is not None:
            self._watch.check(self.get_logger().warning)
        self._health.look()
        return self._fusion_report.statuses(self.not_finite)

    def _on_reset(self, _request: Any, response: Any) -> Any:
        self.pipeline.reset()
        response.success, response.message = True, 'Attitude, position and biases start anew.'
        return response

    def _on_enable(self, k: int, request: Any, response: Any) -> Any:
        self.pipeline.set_enabled(k, request.data)
        state = 'enabled' if request.data else 'disabled'
        response.success, response.message = True, f'{self.rig.names[k]} is {state}.'
        return response

    def _on_save_biases(self, _request: Any, response: Any) -> Any:
        path = Path(self.get_parameter('rig_file').value)
        now_s = self.get_clock().now().nanoseconds * 1e-9
        try:
            save_rig(with_biases(self.rig, *self.pipeline.biases(), now_s), path)
        except ConfigError as error:
            response.success, response.message = False, str(error)
        else:
            response.success, response.message = (
                True,
                f'Saved to {path} for the next start.',
            )
        return response


def run_fusion(make_node: Callable[[], FusionNode]) -> int:
    """Run until shutdown, or until the filter gives up; return the exit code as `run` does."""
    nodes: list[FusionNode] = []

    def make() -> FusionNode:
        nodes.append(make_node())
        return nodes[-1]

    code = run(make)
    for node in nodes:
        try:
            node.kept_state.save()
        except ConfigError as error:
            sys.stderr.write(f'{error}\n')
            code = 1
        if node.failure is not None:
            sys.stderr.write(f'{node.failure}\n')
            return 1
    return code


def main() -> int:
    """Run until shutdown."""
    return run_fusion(FusionNode)
