"""The state of the filters, kept in a file from one run of a node to the next.

A rig that starts in mid-walk cannot stand still first: it takes position, heading and biases from
before, with what may have happened since in their covariance.  See `saved_state`.
"""

from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_srvs.srv import Trigger

from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.parameters import declare
from multiimu_ros.odometry.saved_state import load_state, save_state, SavedState
from multiimu_ros.pipeline import Pipeline

SAVE_EVERY = 10.0  # [s] what a battery that falls out may cost
WORDS = 'file that keeps the state of the filters from one run to the next; empty: none'


class KeptState:
    """Reads the file at the start; writes it now and then, at the end, and for `~/save_state`."""

    def __init__(self, node: Node, pipeline: Pipeline) -> None:
        self._node, self._pipeline = node, pipeline
        self._path = declare(node, 'state_file', '', WORDS)
        node.create_service(Trigger, '~/save_state', self._on_save)
        # A slow card must not keep the readings waiting.
        self._writer = ThreadPoolExecutor(max_workers=1)
        self._writing: Future[str] | None = None
        self._complained = False
        if self._path:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
            node.create_timer(SAVE_EVERY, self._save_in_passing, clock=clock)
        if self._path and Path(self._path).exists():
            now_ns = node.get_clock().now().nanoseconds
            try:
                pipeline.restore(load_state(self._path, pipeline.owner, now_ns))
            except ConfigError as error:
                node.get_logger().warning(f'Starting anew: {error}')
            else:
                node.get_logger().info(f'Going on from the state in {self._path}.')

    def save(self) -> str:
        """Write the file.

        Returns
        -------
        str
            Where to; '' where there is no file or nothing to save.

        Raises
        ------
        ConfigError
            If it cannot be written.
        """
        state = self._pipeline.snapshot()
        if not self._path or state is None:
            return ''
        return self._writer.submit(self._write, state).result()

    def _write(self, state: SavedState) -> str:
        save_state(state, self._path)
        return str(self._path)

    def _save_in_passing(self) -> None:
        state = self._pipeline.snapshot()
        if state is not None and (self._writing is None or self._writing.done()):
            self._writing = self._writer.submit(self._write, state)
            self._writing.add_done_callback(self._on_written)

    def _on_written(self, writing: Future[str]) -> None:
        """Say once that the file cannot be written, until it can again."""
        error = writing.exception()
        if error is not None and not self._complained:
            self._node.get_logger().warning(str(error))
        self._complained = error is not None

    def _on_save(self, _request: Any, response: Any) -> Any:
        try:
            path = self.save()
        except ConfigError as error:
            response.success, response.message = False, str(error)
            return response
        wish = 'Name a file by the parameter `state_file`, and let the rig move first.'
        response.success = bool(path)
        response.message = f'Saved to {path} for the next start.' if path else wish
        return response
