"""Start real nodes as processes, talk to them, and judge how they end."""

from contextlib import contextmanager
import os
import signal
import subprocess
import sys
import threading
import time

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Imu

ENTRY = 'import sys; from multiimu_ros.nodes.{0} import main; sys.exit(main())'


class Process:
    """A node's process; `text` is what it has said so far on stdout and stderr."""

    def __init__(self, name, *arguments, domain_id=None):
        domain = {} if domain_id is None else {'ROS_DOMAIN_ID': str(domain_id)}
        self._popen = subprocess.Popen(
            [sys.executable, '-c', ENTRY.format(name), *arguments],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env=os.environ | {'PYTHONUNBUFFERED': '1'} | domain,
        )
        self._lines = []
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self):
        self._lines.extend(iter(self._popen.stdout.readline, ''))

    @property
    def text(self):
        return ''.join(self._lines)

    @property
    def pid(self):
        return self._popen.pid

    def end(self, number=signal.SIGINT, timeout_s=10.0):
        """Send a signal; return the exit code and the seconds that it took."""
        start = time.monotonic()
        self._popen.send_signal(number)
        return self.wait(timeout_s), time.monotonic() - start

    def wait(self, timeout_s=15.0):
        """Return the exit code of a process that ends by itself."""
        try:
            return self._popen.wait(timeout_s)
        finally:
            self.close()

    def close(self):
        if self._popen.poll() is None:
            self._popen.kill()
            self._popen.wait()
        self._reader.join(2.0)
        self._popen.stdout.close()


@contextmanager
def node_process(name, *ros_arguments, **parameters):
    """Run `multiimu_ros.nodes.<name>:main`; killed at the end if it still runs."""
    pairs = [part for key, value in parameters.items() for part in ('-p', f'{key}:={value}')]
    process = Process(name, '--ros-args', *pairs, *ros_arguments)
    try:
        yield process
    finally:
        process.close()
        sys.stdout.write(process.text)  # pytest shows it where the test fails


class Peer:
    """A test's own node: publishes IMU messages, collects whatever topics carry."""

    def __init__(self):
        self.node = rclpy.create_node('peer')
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self._publishers = {}

    def collect(self, kind, topic, depth=1000):
        """Return a list that grows by the messages of a topic."""
        messages = []
        qos = QoSProfile(depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT)
        self.node.create_subscription(kind, topic, messages.append, qos)
        return messages

    def publisher(self, topic, kind=Imu, qos=1000):
        if topic not in self._publishers:
            self._publishers[topic] = self.node.create_publisher(kind, topic, qos)
        return self._publishers[topic]

    def send(self, topic, msg):
        self.publisher(topic, type(msg)).publish(serialize_message(msg))

    def spin(self, seconds):
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def wait_until(self, condition, timeout_s=10.0):
        """Spin until the condition holds; fail the test if it never does."""
        end = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end, f'waited {timeout_s} s in vain'
            self._executor.spin_once(timeout_sec=0.02)

    def wait_for_matches(self, inputs=(), outputs=()):
        """Wait until the node under test hears our `inputs` and publishes `outputs` for us."""
        publishers = [self.publisher(topic) for topic in inputs]
        self.wait_until(lambda: all(p.get_subscription_count() for p in publishers))
        self.wait_until(lambda: all(self.node.count_publishers(topic) for topic in outputs))
        self.spin(0.7)  # the far side learns of the match a little later

    def call(self, kind, name, request, timeout_s=5.0):
        client = self.node.create_client(kind, name)
        assert client.wait_for_service(timeout_s), f'no service {name}'
        future = client.call_async(request)
        self.wait_until(future.done, timeout_s)
        return future.result()

    def close(self):
        self._executor.shutdown()
        self.node.destroy_node()


@contextmanager
def ros_peer():
    """A `Peer` in a context of its own."""
    rclpy.init()
    peer = Peer()
    try:
        yield peer
    finally:
        peer.close()
        rclpy.try_shutdown()


def imu_message(frame_id, stamp_ns, values):
    """Return an Imu; `values` are angular rate, then specific force."""
    msg = Imu()
    msg.header.frame_id = frame_id
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    w, f = msg.angular_velocity, msg.linear_acceleration
    w.x, w.y, w.z, f.x, f.y, f.z = (float(value) for value in values)
    return msg


def imu_values(msg):
    """Return angular rate and specific force of an Imu as six floats."""
    w, f = msg.angular_velocity, msg.linear_acceleration
    return [w.x, w.y, w.z, f.x, f.y, f.z]
