"""What a rig file notes about the recording that its figures come from."""

from collections.abc import Sequence
from datetime import datetime, UTC
import hashlib
import math
from pathlib import Path
import struct
from typing import Any

import numpy as np

from multiimu_ros import __version__
from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.bags import ImuTrack, read_messages, Topic
from multiimu_ros.bags.cdr import BYTE_ORDERS, layout
from multiimu_ros.errors import ConfigError

TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'
TEMPERATURE = (('temperature', 'f8', ()), ('variance', 'f8', ()))
CHUNK = 1 << 20  # bytes hashed at a time


def bag_facts(bag: Path, track: ImuTrack, sha256: str) -> dict[str, Any]:
    """Return name, hash and date of a recording, and the version of the tool that read it."""
    received = datetime.fromtimestamp(int(track.received_ns[0]) // NANOSECONDS, UTC)
    return {
        'bag': bag.resolve().name,
        'sha256': sha256,
        'date': received.isoformat(),
        'version': f'multiimu_ros {__version__}',
    }


def bag_sha256(bag: Path) -> str:
    """Return the hash of the messages' files of a bag, one after the other by name."""
    storage = [*bag.glob('*.mcap'), *bag.glob('*.db3')] if bag.is_dir() else [bag]
    digest = hashlib.sha256()
    for path in sorted(storage):
        with path.open('rb') as file:
            while chunk := file.read(CHUNK):
                digest.update(chunk)
    return digest.hexdigest()


def temperature_span(
    bag: Path, imu_topic: str, present: Sequence[Topic]
) -> tuple[float, float] | None:
    """Return the lowest and the highest temperature beside an IMU's topic [deg C], if recorded."""
    name = f'{imu_topic.rpartition("/")[0]}/temperature'
    if not any(topic.name == name and topic.type == TEMPERATURE_TYPE for topic in present):
        return None
    values = [_temperature(name, message.data) for message in read_messages(bag, [name])]
    finite = [value for value in values if math.isfinite(value)]
    return (min(finite), max(finite)) if finite else None


def _temperature(topic: str, data: bytes) -> float:
    """Decode one serialised sensor_msgs/Temperature."""
    order = BYTE_ORDERS.get(data[:2], '<')
    try:
        (frame,) = struct.unpack_from(f'{order}I', data, 12)
        record = layout(TEMPERATURE, (min(frame, len(data)),), order)
        (value,) = np.frombuffer(data[: record.itemsize], record)['temperature']
    except (struct.error, ValueError) as error:
        msg = f'`{topic}` must hold {TEMPERATURE_TYPE} messages, got {len(data)} bytes of another.'
        raise ConfigError(msg) from error
    return float(value)
