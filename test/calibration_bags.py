"""Bags for the verbs `calibrate` and `register`: boards as they should be recorded, and others."""

import pathlib

import numpy as np
from typer.testing import CliRunner

from multiimu_ros.bags import BagWriter
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.cli.calibrate import app as calibrate_app
from multiimu_ros.cli.register import app as register_app
from multiimu_ros.rig import Imu, Rig, RigFrame
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.paths import Path
from multiimu_ros.simulation.placements import row
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import calibration_path

RATE = 100.0  # [Hz]
REST, POSE, MOVE = 4.0, 2.5, 3.0  # [s]
YAW = 5  # the channel of a path
IMU_TYPE = 'sensor_msgs/msg/Imu'


def carried(path, duration, rig=None, seed=0):
    """Return what the IMUs of a board, two in a row unless told, record along a path."""
    return simulate(rig or row(2), Trajectory(path, duration), RATE, seed=seed)


def recorded(poses=16, waving=25.0, rig=None, seed=0):
    """Return the recording of a rest, some poses, and waving about [s]."""
    rng = np.random.default_rng(seed)
    path = calibration_path(poses, rng, rest=REST, pose=POSE, waving=waving)
    return carried(path, REST + poses * (MOVE + POSE) + waving, rig, seed)


def with_slow_moves(poses, slower, only=None):
    """Return a path whose moves take `slower` times 3 s, about one channel `only` if told."""
    path = calibration_path(poses, np.random.default_rng(0), rest=REST, pose=POSE, waving=0.0)
    steps = np.diff(path.time)
    steps[1::2] *= slower
    value = path.value.copy()
    if only is not None:
        value[:, np.arange(6) != only] = 0.0
    return Path(np.concatenate([[0.0], np.cumsum(steps)]), value, path.first, path.second)


def turned_about_z(seconds):
    """Return a path that rests and then swings about z only, once a second."""
    time = REST + np.concatenate([[-REST], np.arange(0.0, seconds, 0.5)])
    value = np.zeros((len(time), 6))
    value[2:-1, YAW] = 0.5 * (-1.0) ** np.arange(len(time) - 3)
    return Path(time, value, np.zeros_like(value), np.zeros_like(value))


def changed(samples, rate=1.0, force=1.0):
    """Return the samples in other units."""
    return ImuSamples(
        samples.stamp_ns, rate * samples.angular_rate, force * samples.specific_force
    )


def clipped(samples, rate):
    """Return the samples of a gyroscope that reads up to `rate` [rad/s]."""
    limited = np.clip(samples.angular_rate, -rate, rate)
    return ImuSamples(samples.stamp_ns, limited, samples.specific_force)


def write_bag(path, tracks, topics=None):
    """Write one topic per IMU, in order of time; return the path."""
    topics = topics or [f'/imu{k}/data_raw' for k in range(len(tracks))]
    messages = [
        (stamp, topic, data)
        for k, (topic, track) in enumerate(zip(topics, tracks, strict=True))
        for stamp, data in zip(
            np.maximum.accumulate(track.stamp_ns).tolist() if len(track) else [],
            encode_imus(f'imu{k}_link', track),
            strict=True,
        )
    ]
    with BagWriter(path) as bag:
        for topic in topics:
            bag.add_topic(topic, IMU_TYPE)
        for stamp, topic, data in sorted(messages):
            bag.write(topic, stamp, data)
    return path


def bare(rig):
    """Return a rig that knows nothing but names and gravity."""
    imus = tuple(Imu(name=imu.name, frame_id=imu.frame_id) for imu in rig.imus)
    frame = RigFrame(name=rig.rig.name, gravity=rig.rig.gravity_magnitude)
    return Rig(version=1, rig=frame, imus=imus)


def calibrate(bag: pathlib.Path, output: pathlib.Path, *arguments):
    """Run the verb; errors come through."""
    command = [str(bag), '-o', str(output), *map(str, arguments)]
    return CliRunner().invoke(calibrate_app, command, catch_exceptions=False)


def register(output: pathlib.Path, *arguments):
    """Run the verb; errors come through."""
    command = ['-o', str(output), *map(str, arguments)]
    return CliRunner().invoke(register_app, command, catch_exceptions=False)
