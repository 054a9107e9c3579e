"""What happens to the fused output while sensors fail: real processes, one fault after another.

A drill keeps a listener on `imu/data`, `odom` and `/diagnostics`, provokes a fault, ends it, and
judges from what was heard: how soon the diagnostics named the fault, the longest pause between
two fused messages, whether the stamps went on, and how far the output stepped from before to
after.
"""

from contextlib import contextmanager
from dataclasses import dataclass
import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from live_chain import ENVIRONMENT, process, wait_until
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.qos import qos_profile_sensor_data, QoSProfile
from ros_helpers import imu_message
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Imu

from multiimu_ros.rig import save_rig
from multiimu_ros.simulation import placements

RIG = Path(__file__).parents[1] / 'config/ring8.yaml'
ROTATION, RATE, FORCE = slice(0, 4), slice(13, 16), slice(25, 28)  # among the doubles of an Imu
ROTATION_P = slice(4, 13, 4)
SETTLE_S = 6.0  # attitude and biases settle at rest
WINDOW_S = 2.0  # the output is averaged over so long
BLOCKS = 20  # of it: a tenth of a second outlasts what interpolation correlates
NEVER = float('inf')


@dataclass(frozen=True)
class Outcome:
    """What one fault did; times count from its first moment, or from its end."""

    fault: str
    named_s: float  # until /diagnostics named it as an error
    over_s: float  # from its end until /diagnostics took that back
    pause_ms: float  # the longest between two fused messages, as they arrived
    missing_ms: float  # the longest between two stamps
    step_sigmas: float  # largest of rate, force and attitude, before to after
    position_mm: float  # the odometry's movement from before to after
    turn_deg: float


class Ears:
    """Everything that was heard, with the steady clock's time of each arrival [s].

    Parameters
    ----------
    peer : ros_helpers.Peer
        Whose node listens.
    """

    def __init__(self, peer):
        self._peer = peer
        self._heard = {Imu: [], Odometry: []}
        self._statuses = []
        qos = QoSProfile(depth=1000, reliability=qos_profile_sensor_data.reliability)
        for kind, topic in ((Imu, 'imu/data'), (Odometry, 'odom')):
            note = lambda data, list_=self._heard[kind]: list_.append((time.monotonic(), data))  # noqa: E731
            peer.node.create_subscription(kind, topic, note, qos, raw=True)
        peer.node.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 100)

    def _on_diagnostics(self, msg):
        now = time.monotonic()
        self._statuses += [(now, status) for status in msg.status]

    def listen(self, seconds):
        self._peer.spin(seconds)

    def has_fused(self):
        return len(self._heard[Imu]) > 0

    def first(self, begin, name, judge):
        """Return when, after `begin`, a status of this name first passed `judge` [s]."""
        times = (t for t, s in self._statuses if t > begin and s.name == name and judge(s))
        return next(times, NEVER) - begin

    def between(self, kind, begin, end):
        """Return arrivals [s], stamps [ns] and doubles of the messages in that time."""
        count = {Imu: 37, Odometry: 85}[kind]
        heard = [(t, data) for t, data in self._heard[kind] if begin <= t < end]
        assert heard, f'no {kind.__name__} between {begin} and {end}'
        stamps = np.array([np.frombuffer(data[4:12], '<i4') for _, data in heard], np.int64)
        doubles = np.array([np.frombuffer(data[-8 * count :], '<f8') for _, data in heard])
        return np.array([t for t, _ in heard]), stamps @ [10**9, 1], doubles


def judge(ears, fault, begin, end, until, *, name, states):
    """Return the outcome of a fault from `begin` to `end`, heard `until` then."""
    arrivals, stamps, numbers = ears.between(Imu, begin - WINDOW_S, until)
    before = numbers[arrivals < begin]
    after = numbers[arrivals > until - WINDOW_S]
    times, _, odometry = ears.between(Odometry, begin - WINDOW_S, until)
    still, moved = odometry[times < begin][-1], odometry[-1]
    assert np.isfinite(numbers).all()
    assert np.isfinite(odometry).all()
    assert (np.diff(stamps) > 0).all()

    def named(status):
        return status.level == DiagnosticStatus.ERROR and status.message.startswith(states)

    return Outcome(
        fault,
        ears.first(begin, name, named),
        ears.first(end, name, lambda status: status.level == DiagnosticStatus.OK),
        1e3 * np.diff(arrivals).max(),
        1e-6 * np.diff(stamps).max(),
        max(largest_step(before, after), turn(before, after)),
        1e3 * np.linalg.norm(moved[:3] - still[:3]),
        np.rad2deg(angle(still[3:7], moved[3:7]).max()),
    )


def largest_step(before, after):
    """Return the change of the mean of rate and force in its standard errors."""
    values = [np.hstack([part[:, RATE], part[:, FORCE]]) for part in (before, after)]
    blocks = [
        np.array([block.mean(axis=0) for block in np.array_split(part, BLOCKS)]) for part in values
    ]
    variance = sum(part.var(axis=0, ddof=1) / BLOCKS for part in blocks)
    step = blocks[1].mean(axis=0) - blocks[0].mean(axis=0)
    return float((np.abs(step) / np.sqrt(variance)).max())


def turn(before, after):
    """Return the change of attitude in the filter's own standard deviations."""
    sigmas = np.sqrt(after[-1, ROTATION_P])
    return float((angle(before[-1, ROTATION], after[-1, ROTATION]) / sigmas).max())


def angle(before, after):
    """Return the rotation between two quaternions about each axis [rad]."""
    rotations = Rotation.from_quat(after) * Rotation.from_quat(before).inv()
    return np.abs(rotations.as_rotvec())


class Emulator:
    """An emulated board that obeys: faults in, bytes out on the port `link`."""

    def __init__(self, folder, seconds):
        self.link, self.rig_file = folder / 'board', folder / 'rig.yaml'
        command = [sys.executable, '-c', 'from multiimu_ros.cli.emulator import main; main()']
        options = ['--rig', RIG, '--motion', 'static', '--duration', seconds, '--link', self.link]
        self._process = subprocess.Popen(
            [*map(str, [*command, *options, '--calibrated-rig', self.rig_file])],
            env=ENVIRONMENT,
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            text=True,
        )

    def command(self, text):
        """Say a fault, or its end; return when that was [s]."""
        self._process.stdin.write(text + '\n')
        self._process.stdin.flush()
        return time.monotonic()

    def end(self):
        self._process.send_signal(signal.SIGINT)
        self._process.stdin.close()
        assert self._process.wait(10) == 0

    def kill(self):
        self._process.kill()
        self._process.wait()
        self._process.stdin.close()


@contextmanager
def emulator(folder, seconds):
    """Run an emulated board on `folder / 'board'`; at the end it has to leave with code 0."""
    board = Emulator(folder, seconds)
    try:
        wait_until(lambda: board.link.exists() and board.rig_file.exists(), 20, 'the emulator')
        yield board
        board.end()
    finally:
        board.kill()


FAULTS = {  # what is said to begin and to end it, for how long, and how it is named
    'IMU 0 dead': ('dead:0', 'heal:0', 3.0, 'fusion: imu0', ('absent',)),
    'IMU 5 stuck': ('stuck:5', 'heal:5', 3.0, 'fusion: imu5', ('stuck',)),
    'board unplugged': ('unplug', 'replug', 2.0, 'driver: board', ('disconnected',)),
}


def board_drill(peer, folder, faults=tuple(FAULTS)):
    """Drill the chain behind an emulated board; return the outcomes and what was heard."""
    domain = int(os.environ['ROS_DOMAIN_ID'])
    ears, outcomes = Ears(peer), []
    with emulator(folder, 120) as board:
        rig = ('--ros-args', '-p', f'rig_file:={board.rig_file}')
        driver = process('driver', '--ros-args', '-p', f'port:={board.link}', domain=domain)
        with (
            process('fusion', *rig, domain=domain),
            process('registration', *rig, domain=domain),
            process('calibration', *rig, domain=domain),
            driver,
        ):
            peer.wait_until(ears.has_fused, 60.0)
            ears.listen(SETTLE_S)
            for fault in faults:
                start, stop, seconds, name, states = FAULTS[fault]
                begin = board.command(start)
                ears.listen(seconds)
                end = board.command(stop)
                ears.listen(2 * WINDOW_S)
                until = time.monotonic()
                outcomes.append(judge(ears, fault, begin, end, until, name=name, states=states))
    return outcomes, ears


def not_a_number_drill(peer, folder):
    """Let one of four IMUs send NaN for three seconds, which no wire format can; 100 Hz."""
    domain = int(os.environ['ROS_DOMAIN_ID'])
    rig = placements.row(4)
    save_rig(rig, folder / 'rig.yaml')
    topics = [f'{name}/data_registered' for name in rig.names]
    ears, rng = Ears(peer), np.random.default_rng(1)

    def send(seconds, broken=None):
        end = time.monotonic() + seconds
        while (now := time.monotonic()) < end:
            stamp_ns = time.time_ns()
            for k, topic in enumerate(topics):
                values = rng.normal([0, 0, 0, 0, 0, 9.80665], [1e-3] * 3 + [1e-2] * 3)
                if k == broken:
                    values[4] = np.nan
                peer.send(topic, imu_message(f'imu{k}_link', stamp_ns, values))
            peer.spin(max(0.0, now + 0.01 - time.monotonic()))

    with process('fusion', '--ros-args', '-p', f'rig_file:={folder}/rig.yaml', domain=domain):
        peer.wait_until(lambda: peer.node.count_publishers('imu/data') > 0, 60.0)
        peer.wait_for_matches(topics, ['imu/data', 'odom'])
        send(SETTLE_S)
        begin = time.monotonic()
        send(3.0, broken=2)
        end = time.monotonic()
        send(2 * WINDOW_S)
        until = time.monotonic()
    name = 'fusion: imu2'
    return judge(ears, 'IMU 2 NaN', begin, end, until, name=name, states=('invalid',))


def table(outcomes):
    """Return the outcomes as text."""
    heads = ('named [s]', 'over [s]', 'pause [ms]', 'missing [ms]', 'step [sigma]', 'moved [mm]')
    lines = [f'{"fault":18}' + ''.join(f'{head:>13}' for head in (*heads, 'turned [deg]'))]
    lines += [
        f'{o.fault:18}{o.named_s:13.2f}{o.over_s:13.2f}{o.pause_ms:13.0f}{o.missing_ms:13.1f}'
        f'{o.step_sigmas:13.1f}{o.position_mm:13.2f}{o.turn_deg:13.3f}'
        for o in outcomes
    ]
    return '\n'.join(lines)
