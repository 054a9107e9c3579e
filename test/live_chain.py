"""A bag through the separate nodes at its own speed, into another bag."""

from contextlib import contextmanager
import os
import signal
import subprocess
import sys
import time

import numpy as np
import rclpy

from multiimu_ros.bags import read_messages

MULTIIMU = [sys.executable, '-m', 'multiimu_ros.cli']
# Ten minutes of eight IMUs are for machine code, even where coverage runs the rest without it.
ENVIRONMENT = {**os.environ, 'MULTIIMU_COMPILED': '1'}
NODES = ('calibration', 'registration', 'fusion')
START_S = 30.0  # until the graph stands; a cold numba cache compiles first
NUMBERS = {'/imu/data': 37, '/odom': 85}  # doubles at the end of the message


@contextmanager
def started(verb, *arguments, domain):
    """Run `multiimu <verb>`; what still runs at the end is killed."""
    environment = {
        **ENVIRONMENT,
        'ROS_DOMAIN_ID': str(domain),
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
    }
    command = [*MULTIIMU, verb, *map(str, arguments)]
    running = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True)
    try:
        yield running
    finally:
        if running.poll() is None:
            running.kill()
        running.wait()
        running.stderr.close()


@contextmanager
def process(verb, *arguments, domain):
    """Run `multiimu <verb>`; at the end, interrupt it and expect exit code 0."""
    with started(verb, *arguments, domain=domain) as running:
        yield running
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=10)
        assert running.returncode == 0, said


@contextmanager
def observer(domain):
    """Return a node of this process that sees the graph of `domain`."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=domain)
    node = rclpy.create_node('observer', context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


def wait_until(condition, seconds, what):
    """Wait until `condition()` holds."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until, f'{what} did not happen within {seconds} s'
        time.sleep(0.05)


def fuse(bag, rig_file, output, *options):
    """Run `multiimu fuse`, without ROS."""
    command = [*MULTIIMU, 'fuse', bag, '--rig', rig_file, '-o', output, '--json', *options]
    subprocess.run(command, env=ENVIRONMENT, check=True, stdout=subprocess.DEVNULL)


def replay(bag, rig_file, output, *, domain, seconds, last='imu7', profile='hand'):
    """Play `bag` of `seconds` through calibration, registration and fusion; record `output`.

    `last` is the last IMU of the rig.
    """
    with observer(domain) as node:
        told = ('--ros-args', '-p', f'rig_file:={rig_file}')
        processes = [process(name, *told, domain=domain) for name in NODES[:2]]
        processes.append(process(NODES[2], *told, '-p', f'profile:={profile}', domain=domain))
        record = process('record', '-o', output, '/imu/data', '/odom', domain=domain)
        with processes[0], processes[1], processes[2], record:
            topics = ('/imu0/data_calibrated', f'/{last}/data_registered', '/imu/data', '/odom')
            wait_until(
                lambda: (
                    all(map(node.count_publishers, topics))
                    and all(map(node.count_subscribers, (f'/{last}/data_raw', *topics)))
                ),
                START_S,
                'the graph',
            )
            time.sleep(2.0)  # the nodes look once a second who listens
            with started('play', bag, '--wait', '20', domain=domain) as play:
                assert play.wait(seconds + 60) == 0
            time.sleep(0.5)


def numbers(bag, topic):
    """Return the stamps [ns] and the doubles of all messages of `topic`, (N,) and (N, M)."""
    count = NUMBERS[topic]
    messages = [message.data for message in read_messages(bag, [topic])]
    stamps = np.array([np.frombuffer(data[4:12], '<i4') for data in messages], np.int64)
    doubles = np.array([np.frombuffer(data[-8 * count :], '<f8') for data in messages])
    return stamps[:, 0] * 1_000_000_000 + stamps[:, 1], doubles
