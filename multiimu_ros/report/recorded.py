"""What the nodes said, from the bag that was recorded meanwhile."""

from collections.abc import Sequence
from dataclasses import dataclass
import os

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import NANOSECONDS, Scalars, Stamps
from multiimu_ros.bags import read_imus, read_messages
from multiimu_ros.bags.cdr import Fields, IMU, layout, ODOMETRY
from multiimu_ros.errors import ConfigError
from multiimu_ros.report.tracks import Track
from multiimu_ros.samples import ImuSamples

Records = NDArray[np.void]
IMU_DATA, ODOM, ZERO_VELOCITY = '/imu/data', '/odom', '/zero_velocity'


@dataclass(frozen=True)
class Recorded:
    """What one live run left behind.

    Parameters
    ----------
    raw : tuple of ImuSamples
        Raw readings of each IMU.
    track : Track
        What the fusion node published; it does not say the weights, which are NaN.
    ages : (N,) array
        From the instant of each measurement to the recorder's receipt of `imu/data` [s].
    """

    raw: tuple[ImuSamples, ...]
    track: Track
    ages: Scalars


def read_run(path: str | os.PathLike[str], names: Sequence[str]) -> Recorded:
    """Read the bag of a live run with the IMUs `names`.

    Raises
    ------
    ConfigError
        If the bag cannot be read, or lacks a topic.
    """
    messages: dict[str, list[bytes]] = {IMU_DATA: [], ODOM: [], ZERO_VELOCITY: []}
    received: list[int] = []
    for topic, received_ns, data in read_messages(path, tuple(messages)):
        messages[topic].append(data)
        if topic == IMU_DATA:
            received.append(received_ns)
    raw = read_imus(path, [f'/{name}/data_raw' for name in names])
    counts = {topic: len(messages[topic]) for topic in (IMU_DATA, ODOM)}
    counts |= {track.topic: len(track.samples) for track in raw.tracks}
    empty = [topic for topic, count in counts.items() if not count]
    if empty:
        msg = f'The bag `{path}` must hold `{empty[0]}`, but nothing was recorded on it.'
        raise ConfigError(msg)
    imu, odom = _records(messages[IMU_DATA], IMU, 1), _records(messages[ODOM], ODOMETRY, 2)
    still = {_stamp_of(data) for data in messages[ZERO_VELOCITY]}
    ages = (np.array(received) - _stamps(imu)) / NANOSECONDS
    samples = tuple(track.samples for track in raw.tracks)
    return Recorded(samples, _track(imu, odom, still, len(names)), ages)


def _records(messages: Sequence[bytes], fields: Fields, strings: int) -> Records:
    """View messages of one publisher, and so of one length, as records."""
    sizes, end = [], 12
    for _ in range(strings):  # each string starts on a multiple of 4 with its length
        end += -end % 4
        sizes.append(int.from_bytes(messages[0][end : end + 4], 'little'))
        end += 4 + sizes[-1]
    return np.frombuffer(b''.join(messages), layout(fields, sizes, itemsize=len(messages[0])))


def _stamps(records: Records) -> Stamps:
    return np.asarray(records['sec'].astype(np.int64) * NANOSECONDS + records['nanosec'])


def _stamp_of(data: bytes) -> int:
    seconds = int.from_bytes(data[4:8], 'little')
    return seconds * NANOSECONDS + int.from_bytes(data[8:12], 'little')


def _track(imu: Records, odom: Records, still: set[int], count: int) -> Track:
    """Join the messages of one stamp."""
    stamp_ns, at_imu, at_odom = np.intersect1d(_stamps(imu), _stamps(odom), return_indices=True)
    imu, odom = imu[at_imu], odom[at_odom]
    variance = np.diagonal(imu['orientation_covariance'], axis1=1, axis2=2)
    return Track(
        stamp_ns,
        imu['angular_rate'].copy(),
        imu['specific_force'].copy(),
        Rotation.from_quat(imu['orientation']).as_matrix(),
        np.sqrt(np.maximum(variance, 0.0)),
        odom['position'].copy(),
        Rotation.from_quat(odom['orientation']).as_matrix(),
        np.isin(stamp_ns, list(still)),
        np.full((len(stamp_ns), count), np.nan),
    )
