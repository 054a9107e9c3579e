"""The driver on a real port and real rclpy: bytes in, messages out, through an unplugging."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from diagnostic_msgs.msg import DiagnosticArray
from diagnostics_page import told
from ptys import PluggedPort, wait_until
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from sensor_msgs.msg import Imu, Temperature

from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.driver import DriverNode
from multiimu_ros.transport.capture import read_capture
from multiimu_ros.wire import packets
from multiimu_ros.wire.board import Board

pytestmark = pytest.mark.ros
HELLO = packets.Hello(
    tuple(packets.ImuInfo(k, 1, 0x69, k, 2000, 16, 0.5, 0.25) for k in (0, 3)), rate_hz=100
)
COUNTS = (2, -4, 6, -8, 10, 12)  # 0.5 and 0.25 are exact: so are the products


def scan(seq):
    return packets.encode(
        packets.Scan(seq % 2**16, seq * 10_000, dict.fromkeys((0, 3), (0, COUNTS)))
    )


class Listener(Node):
    """Keeps every message that it hears."""

    def __init__(self):
        super().__init__('listener')
        self.imu, self.temperature, self.statuses = [], [], {}
        self.create_subscription(Imu, 'imu3/data_raw', self.imu.append, 100)
        self.create_subscription(Temperature, 'imu3/temperature', self.temperature.append, 10)
        self.create_subscription(DiagnosticArray, '/diagnostics', self._on_diagnostics, 10)

    def _on_diagnostics(self, msg):
        self.statuses |= {status.name: status for status in msg.status}


@pytest.fixture
def device(tmp_path):
    port = PluggedPort(tmp_path / 'ttyIMU')
    port.plug()
    yield port
    port.unplug()


@pytest.fixture
def executor():
    rclpy.init()
    executor = SingleThreadedExecutor()
    yield executor
    executor.shutdown()
    rclpy.try_shutdown()


@pytest.fixture
def make(executor):
    nodes = []

    def make(kind, **parameters):
        values = [Parameter(name, value=value) for name, value in parameters.items()]
        nodes.append(kind(values) if kind is DriverNode else kind())
        executor.add_node(nodes[-1])
        return nodes[-1]

    yield make
    for node in nodes:
        node.destroy_node()


def speak(device, executor, done, seqs, timeout_s=8.0):
    """Send scans at 100 Hz and serve the nodes until `done`."""
    end = time.monotonic() + timeout_s
    while not done():
        assert time.monotonic() < end
        device.send(scan(next(seqs)))
        pause = time.monotonic() + 0.01
        while time.monotonic() < pause:
            executor.spin_once(timeout_sec=0.002)


def test_bytes_become_messages(device, executor, make, tmp_path):
    listener = make(Listener)
    capture = tmp_path / 'session'
    sigmas = {'angular_velocity_stddev': 2.0, 'linear_acceleration_stddev': 3.0}
    driver = make(DriverNode, port=device.path, capture_file=str(capture), **sigmas)
    assert wait_until(lambda: driver.input.transport.connected)
    status = packets.Status(5, imus={3: (0, 23.5)})
    device.send(packets.encode(HELLO) + packets.encode(status))
    seqs = iter(range(10**6))
    device_said = lambda: listener.imu and listener.statuses.get('driver: imu3')  # noqa: E731
    speak(device, executor, device_said, seqs)
    device.send(packets.encode(status))
    speak(device, executor, lambda: listener.temperature, seqs)

    msg = listener.imu[0]
    w, f = msg.angular_velocity, msg.linear_acceleration
    assert [w.x, w.y, w.z, f.x, f.y, f.z] == [1, -2, 3, -2, 2.5, 3]
    assert msg.header.frame_id == 'imu3_link'
    assert msg.orientation_covariance[0] == -1
    assert list(msg.angular_velocity_covariance) == [4, 0, 0, 0, 4, 0, 0, 0, 4]
    assert msg.linear_acceleration_covariance[8] == 9
    assert abs(msg.header.stamp.sec - time.time()) < 20  # the stamp is host time
    assert listener.temperature[0].temperature == 23.5
    assert listener.statuses['driver: board'].message == 'connected'
    for part, name in (('board', 'board'), ('imu<k>', 'imu3')):
        said = sorted(pair.key for pair in listener.statuses[f'driver: {name}'].values)
        assert told(f'driver: {part}') == said
    driver.destroy_node()
    board = Board()
    kept = [s for arrival_ns, data in read_capture(capture) for s in board.push(data, arrival_ns)]
    assert next(s.values for s in kept if s.imu == 3) == (1, -2, 3, -2, 2.5, 3)


def test_the_first_scans_wait_until_their_topics_are_found(device, executor, make):
    listener = make(Listener)
    driver = make(DriverNode, port=device.path)
    assert wait_until(lambda: driver.input.transport.connected)
    device.send(packets.encode(HELLO))
    seqs = iter(range(10**6))
    speak(device, executor, lambda: len(listener.imu) >= 20, seqs)
    # All but those on their way: a publisher made with the first sample lost about four.
    assert next(seqs) - len(listener.imu) <= 2


def test_a_replugged_board_goes_on(device, executor, make):
    listener = make(Listener)
    driver = make(DriverNode, port=device.path)
    assert wait_until(lambda: driver.input.transport.connected)
    device.send(packets.encode(HELLO))
    speak(device, executor, lambda: listener.imu, iter(range(10**6)))
    device.unplug()
    end = time.monotonic() + 1.0  # a fault must be named within a second
    while getattr(listener.statuses.get('driver: board'), 'level', b'') != b'\x02':
        assert time.monotonic() < end
        executor.spin_once(timeout_sec=0.01)
    before = len(listener.imu)
    device.plug()
    assert wait_until(lambda: driver.input.transport.connected)
    device.send(packets.encode(HELLO))
    speak(device, executor, lambda: len(listener.imu) > before + 5, iter(range(10**6)))
    stamps = [(m.header.stamp.sec, m.header.stamp.nanosec) for m in listener.imu]
    assert stamps == sorted(set(stamps))


def test_a_board_that_was_not_heard_at_its_start_is_asked(device, executor, make):
    driver = make(DriverNode, port=device.path)
    assert wait_until(lambda: driver.input.transport.connected)
    speak(device, executor, lambda: driver.input.heard, iter(range(10**6)))
    assert device.hear().startswith(packets.encode(packets.HelloRequest()))


def test_the_port_must_be_named(executor, make):
    with pytest.raises(ConfigError, match='Exactly one of `port`'):
        make(DriverNode)


def test_destroying_the_node_ends_its_thread(device, executor, make):
    threads = threading.active_count()
    driver = make(DriverNode, port=device.path)
    assert threading.active_count() > threads
    driver.destroy_node()
    assert threading.active_count() == threads


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_process_with_code_0(device, number):
    code = 'import sys; from multiimu_ros.nodes.driver import main; sys.exit(main())'
    command = [sys.executable, '-c', code, '--ros-args', '-p', f'port:={device.path}']
    with subprocess.Popen(command, cwd=Path(__file__).parents[2], env=os.environ) as process:
        device.send(packets.encode(HELLO))
        time.sleep(2.5)  # rclpy is imported and the node is up
        process.send_signal(number)
        assert process.wait(timeout=5) == 0
