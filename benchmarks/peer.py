"""The outside of the live benchmark, each a process of its own: publisher, receiver, plain echo.

peer.py publish FOLDER RATE SECONDS    8 x imu<k>/data_raw and echo; writes sent.npz
peer.py receive FOLDER                 imu/data as the package hears it; writes received.npy
peer.py echo FOLDER                    one typed hop as rclpy's tutorials write it; echo.npy
"""

import array
from pathlib import Path
import signal
import sys
import time

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from sensor_msgs.msg import Imu

from multiimu_ros.nodes.convert import decode_imu, FORCE, imu_numbers, RATE, StampedEncoder
from multiimu_ros.nodes.run import spin

IMUS = 8
WARM_UP = 3.0  # [s] not counted
DEPTH = 2000


def publish(node: Node, folder: Path, rate: float, seconds: float) -> None:
    """Send scans: eight messages in a burst with the scan's stamp, then one for the echo."""
    topics = [f'imu{k}/data_raw' for k in range(IMUS)]
    senders = [node.create_publisher(Imu, topic, QoSProfile(depth=DEPTH)) for topic in topics]
    echo = node.create_publisher(Imu, 'echo', QoSProfile(depth=DEPTH))
    deadline = time.monotonic() + 60.0
    while not all(each.get_subscription_count() for each in (*senders, echo)):
        if time.monotonic() > deadline:
            sys.exit('nobody listens')
        time.sleep(0.05)
    encoders = [StampedEncoder(f'imu{k}_link') for k in range(IMUS)]
    noise = np.random.default_rng(0).normal(scale=1e-3, size=(1000, IMUS, 6))
    noise[:, :, 5] += 9.80665
    readings = [[reading(values) for values in scan] for scan in noise]
    count = round((WARM_UP + seconds) * rate)
    sent = np.empty((count, 2), np.int64)  # stamp, instant of the last message's publication
    begin, wall, late = time.monotonic_ns(), time.time_ns(), 0.0
    for n in range(count):
        due = begin + round(n * 1e9 / rate)
        wait = (due - time.monotonic_ns()) * 1e-9
        late = max(late, -wait)
        if wait > 0:
            time.sleep(wait)
        stamp = wall + due - begin  # of the schedule, as a device's clock has it
        for sender, encoder, numbers in zip(senders, encoders, readings[n % 1000], strict=True):
            sender.publish(encoder.encode(stamp, numbers))
        sent[n] = stamp, time.time_ns()
        echo.publish(encoders[0].encode(stamp, readings[0][0]))
    warm = round(WARM_UP * rate)
    np.savez(folder / 'sent.npz', sent=sent[warm:], late=late)


def reading(values: np.ndarray) -> np.ndarray:
    numbers = imu_numbers(np.zeros(9), np.zeros(9))
    numbers[RATE], numbers[FORCE] = values[:3], values[3:]
    return numbers


def listen(node: Node, path: Path, topic: str, *, plain: bool) -> None:
    """Note stamp and arrival of every message until SIGINT."""
    notes = array.array('q')

    def on_bytes(data: bytes) -> None:
        now = time.time_ns()
        notes.extend((decode_imu(data)[0], now))

    def on_message(msg: Imu) -> None:
        now = time.time_ns()
        notes.extend((msg.header.stamp.sec * 10**9 + msg.header.stamp.nanosec, now))

    stop = Future()
    signal.signal(signal.SIGINT, lambda *_: stop.set_result(None))
    qos = QoSProfile(depth=DEPTH, reliability=qos_profile_sensor_data.reliability)
    if plain:
        node.create_subscription(Imu, topic, on_message, qos)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        while not stop.done():
            executor.spin_once(timeout_sec=0.1)
    else:
        node.create_subscription(Imu, topic, on_bytes, qos, raw=True)
        spin(node, stop)
    np.save(path, np.array(notes, np.int64).reshape(-1, 2))


def main() -> int:
    role, folder = sys.argv[1], Path(sys.argv[2])
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(f'bench_{role}')
    if role == 'publish':
        publish(node, folder, float(sys.argv[3]), float(sys.argv[4]))
    elif role == 'receive':
        listen(node, folder / 'received.npy', 'imu/data', plain=False)
    else:
        listen(node, folder / 'echo.npy', 'echo', plain=True)
    node.destroy_node()
    rclpy.try_shutdown()
    return 0
