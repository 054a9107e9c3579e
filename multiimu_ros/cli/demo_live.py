"""The live part of `multiimu demo`: board, nodes and recorder as processes, and a line about them.

The motion begins when the port is first opened.  So the driver gets a path that leads nowhere
until all processes have found each other; then the board is plugged in.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
import json
import os
from pathlib import Path
import signal
import time
from types import FrameType
from typing import Any

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.cli.children import Children
from multiimu_ros.errors import MultiImuError
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.rig import save_rig
from multiimu_ros.simulation.placements import ring

IMUS = 8
RATE = 200  # [Hz]
PERIOD_NS = NANOSECONDS // RATE
START_PATIENCE = 60.0  # [s] a dozen times what it takes
LAST_MESSAGES = 0.5  # [s]
LOOK = 0.1  # [s]
PLUG = 'plugged'  # where the driver looks for the port
STAGES = ('calibration', 'registration', 'fusion')
NODES = ('driver', *STAGES)


@dataclass(frozen=True, kw_only=True)
class LiveRun:
    """Where one run keeps its files, and what it is to do.

    Parameters
    ----------
    folder : Path
        Gets `bag/`, `rig.yaml`, `truth.npz` and `logs/`.
    motion : str
        Named motion of the board.
    duration : float
        Of the motion [s].
    profile : str
        What the fusion node is told about the motion.
    seed : int
        Draws the IMUs, their noise and the motion.
    """

    folder: Path
    motion: str
    duration: float
    profile: str
    seed: int

    @property
    def rig(self) -> Path:
        """The rig file that the nodes load."""
        return self.folder / 'rig.yaml'

    @property
    def truth(self) -> Path:
        """What the board really did."""
        return self.folder / 'truth.npz'

    @property
    def bag(self) -> Path:
        """What the nodes were given and said."""
        return self.folder / 'bag'


@dataclass(frozen=True)
class Glance:
    """What the live line shows at one moment: time since the start [s], the monitor's figures."""

    elapsed: float
    figures: dict[str, Any]


def domain_id() -> str:
    """Return the user's ROS domain, or one of our own that other runs hardly share."""
    return os.environ.get('ROS_DOMAIN_ID', str(1 + os.getpid() % 100))


def compile_filters() -> None:
    """Push three scans through a pipeline, so that the nodes find the compiled filters cached."""
    pipeline = Pipeline(ring(IMUS), PipelineConfig())
    for n in range(3):
        for k in range(IMUS):
            pipeline.push(k, n * PERIOD_NS, [1e-3 * n, 0.0, 0.0, 0.0, 0.0, 9.81])


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn SIGTERM into the exception of Ctrl-C, so that either ends the children."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


@contextmanager
def live(run: LiveRun) -> Iterator[Children]:
    """Start the board and the graph; leaving ends whatever still runs."""
    logs = run.folder / 'logs'
    logs.mkdir(parents=True, exist_ok=True)
    environment = {'ROS_DOMAIN_ID': domain_id(), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    with interruptible(), Children(logs, environment) as children:
        _start_board(run, children)
        _start_graph(run, children)
        yield children


def _start_board(run: LiveRun, children: Children) -> None:
    board = run.folder / 'board.yaml'
    save_rig(ring(IMUS), board)
    arguments = [f'--rig={board}', f'--motion={run.motion}', f'--rate={RATE}']
    arguments += [f'--duration={run.duration}', f'--link={run.folder / "port"}']
    arguments += [f'--truth={run.truth}', f'--calibrated-rig={run.rig}', f'--seed={run.seed}']
    children.start('emulator', 'multiimu_ros.cli.emulator', arguments)
    _wait(children, lambda: run.rig.exists() and (run.folder / 'port').exists(), 'emulator')


def _start_graph(run: LiveRun, children: Children) -> None:
    """Start all nodes, and wait until they have found each other."""
    parameter = ['--ros-args', '-p', f'rig_file:={run.rig}', '-p', 'reliable:=true']
    for name in STAGES:
        extra = ['-p', f'profile:={run.profile}'] if name == 'fusion' else []
        children.start(name, f'multiimu_ros.nodes.{name}', parameter + extra)
    topics = [f'imu{k}/data_raw' for k in range(IMUS)] + ['imu/data', 'odom', 'zero_velocity']
    children.start('record', 'multiimu_ros.nodes.record', [*topics, '-o', str(run.bag)])
    children.start('monitor', 'multiimu_ros.nodes.monitor', [])
    port = ['--ros-args', '-p', f'port:={run.folder / PLUG}']
    children.start('driver', 'multiimu_ros.nodes.driver', port)
    _wait(children, lambda: _ready(last_line(children)), 'graph')


def _ready(line: dict[str, Any]) -> bool:
    """Say whether every node listens, and the driver is heard."""
    return bool(line.get('ready')) and 'driver: board' in line['figures']


def last_line(children: Children) -> dict[str, Any]:
    """Return what the monitor said last; nothing at first."""
    with children.log('monitor').open('rb') as log:
        log.seek(max(log.seek(0, os.SEEK_END) - 65536, 0))
        lines = log.read().split(b'\n')[:-1]
    for line in reversed(lines):
        if line.startswith(b'{'):
            return dict(json.loads(line))
    return {}


def _wait(children: Children, done: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + START_PATIENCE
    while not done():
        if time.monotonic() > deadline:
            msg = f'The {what} was not ready after {START_PATIENCE:g} s; see the logs with --keep.'
            raise MultiImuError(msg)
        children.running('emulator')
        time.sleep(LOOK)


def carry(run: LiveRun, children: Children) -> Iterator[Glance]:
    """Plug the board in, and yield a glance every moment until the motion is over."""
    (run.folder / PLUG).symlink_to(run.folder / 'port')
    begin = time.monotonic()
    while children.running('emulator'):
        if run.truth.exists():
            yield Glance(time.monotonic() - begin, last_line(children))
        else:
            begin = time.monotonic()  # the motion has not begun
        time.sleep(LOOK)
    time.sleep(LAST_MESSAGES)
    children.running('record')
    yield Glance(run.duration, last_line(children))
    children.end('record')
    children.running('record')  # raises if the bag could not be closed
