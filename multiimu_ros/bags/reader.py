"""Read rosbag2 recordings (mcap or sqlite3): raw in recorded order, or Imu topics as arrays.

Messages are read raw and decoded in blocks (`bags/cdr.py`), which is several times faster than
message by message.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
import os
from pathlib import Path
import struct
from typing import NamedTuple

import apsw
import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, ConnectionExtRosbag2, QosDurability, QosReliability
from rosbags.rosbag2 import Reader, ReaderError

from multiimu_ros.arrays import Stamps
from multiimu_ros.bags.cdr import decode_imus
from multiimu_ros.errors import ConfigError
from multiimu_ros.samples import ImuSamples

IMU_TYPE = 'sensor_msgs/msg/Imu'
BLOCK = 1 << 15  # messages decoded at a time: 10 MB of Imu messages
Source = str | os.PathLike[str]

# What the storage readers raise on a damaged file, found by cutting and flipping bytes of one.
DAMAGE = (
    ReaderError,
    OSError,
    EOFError,
    RuntimeError,
    ValueError,
    TypeError,
    KeyError,
    IndexError,
    OverflowError,
    AssertionError,
    MemoryError,
    struct.error,
    apsw.Error,
)


@dataclass(frozen=True)
class Topic:
    """One topic of a recording; `latched` is transient local durability."""

    name: str
    type: str
    count: int
    reliable: bool = True
    latched: bool = False


class Message(NamedTuple):
    """One serialised message and the instant at which the recorder got it [ns]."""

    topic: str
    received_ns: int
    data: bytes


@dataclass(frozen=True)
class ImuTrack:
    """What one Imu topic of a recording says; `received_ns` (N,) is the recorder's clock [ns]."""

    topic: str
    frame_id: str
    samples: ImuSamples
    received_ns: Stamps


@dataclass(frozen=True)
class ImuRecording:
    """Imu topics of one recording; `order` (M,) names the track of each message as recorded."""

    tracks: tuple[ImuTrack, ...]
    order: NDArray[np.uint8]


@contextmanager
def _open(path: Source) -> Iterator[Reader]:
    """Open a bag's folder or its single storage file."""
    place = Path(path)
    files = [*place.glob('*.mcap'), *place.glob('*.db3')]
    if len(files) == 1 and not (place / 'metadata.yaml').exists():
        place = files[0]  # the recorder was killed before it wrote the metadata
    if not place.exists() or (place.is_dir() and not files):
        msg = (
            f'`{path}` must be a rosbag2 folder, or an .mcap or .db3 file, and is none; check it.'
        )
        raise ConfigError(msg)
    try:
        with Reader(place) as reader:
            yield reader
    except DAMAGE as error:
        reason = ' '.join(str(error).split()).rstrip('.') or type(error).__name__
        msg = f'The bag `{path}` is damaged or cut short ({reason}); repair or record it again.'
        raise ConfigError(msg) from error


def _topic(connection: Connection, count: int) -> Topic:
    ext = connection.ext
    offered = ext.offered_qos_profiles if isinstance(ext, ConnectionExtRosbag2) else []
    reliable = all(qos.reliability != QosReliability.BEST_EFFORT for qos in offered)
    latched = any(qos.durability == QosDurability.TRANSIENT_LOCAL for qos in offered)
    return Topic(connection.topic, connection.msgtype, count, reliable, latched)


def list_topics(path: Source) -> tuple[Topic, ...]:
    """Return the topics of a recording by name.

    Raises
    ------
    ConfigError
        If the bag is missing or damaged.
    """
    with _open(path) as reader:
        counts: dict[str, int] = {}
        for connection in reader.connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
        found = {c.topic: _topic(c, counts[c.topic]) for c in reader.connections}
    return tuple(found[name] for name in sorted(found))


def read_messages(path: Source, topics: Sequence[str] | None = None) -> Iterator[Message]:
    """Yield the messages of the named topics (default: all) in recorded order, undecoded."""
    with _open(path) as reader:
        wanted = [c for c in reader.connections if topics is None or c.topic in topics]
        for connection, received_ns, data in reader.messages(wanted) if wanted else ():
            yield Message(connection.topic, received_ns, data)


def find_imu_topics(
    topics: Sequence[Topic], names: Sequence[str], wanted: Sequence[str] = ()
) -> dict[int, str]:
    """Say which topic holds the raw readings of which IMU.

    Parameters
    ----------
    topics : sequence of Topic
        What the recording holds.
    names : sequence of str
        Names of the IMUs; IMU k is looked for in `<names[k]>/data_raw`, under any namespace.
    wanted : sequence of str
        Topics in the order of `names`, to read instead of those.

    Returns
    -------
    dict
        Topic by index of IMU; IMUs that were not recorded are absent.

    Raises
    ------
    ConfigError
        If no IMU was found, a wanted topic is absent or not of type Imu, or two would fit.
    """
    imus = [topic.name for topic in topics if topic.type == IMU_TYPE and topic.count]
    listed = ', '.join(f'`{name}`' for name in imus) or 'no Imu topic at all'
    if len(wanted) > len(names):
        msg = f'`topics` must name at most the {len(names)} IMUs of the rig, got {len(wanted)}.'
        raise ConfigError(msg)
    searched = wanted or [f'{name}/data_raw' for name in names]
    found = {}
    for index, name in enumerate(searched):
        fits = [imu for imu in imus if f'/{imu}'.endswith('/' + name.lstrip('/'))]
        if len(fits) > 1 or (wanted and not fits):
            msg = f'`{name}` must fit one Imu topic of the bag, which holds {listed}.'
            raise ConfigError(msg)
        if fits:
            found[index] = fits[0]
    single = [imu for imu in imus if f'/{imu}'.endswith('/imu/data_raw')]
    if not found and len(single) == 1:
        found[0] = single[0]
    if not found:
        msg = (
            f'`topics` must name what to read, as the bag has no `{searched[0]}`: it has {listed}.'
        )
        raise ConfigError(msg)
    return found


def read_imus(path: Source, topics: Sequence[str]) -> ImuRecording:
    """Read and decode Imu topics.

    Raises
    ------
    ConfigError
        If the bag is missing or damaged, or a topic holds something else than one IMU's messages.
    """
    numbers = {topic: number for number, topic in enumerate(topics)}
    order: list[int] = []
    pending = _Pending(tuple(topics), str(path))
    for message in read_messages(path, topics):
        order.append(numbers[message.topic])
        pending.add(message)
    return ImuRecording(pending.tracks(), np.array(order, np.uint8))


class _Pending:
    """Messages on their way into arrays, topic by topic and block by block."""

    def __init__(self, topics: tuple[str, ...], path: str) -> None:
        self._path = path
        self._messages: dict[str, list[bytes]] = {topic: [] for topic in topics}
        self._received: dict[str, list[int]] = {topic: [] for topic in topics}
        self._blocks: dict[str, list[ImuSamples]] = {topic: [] for topic in topics}
        self._frames: dict[str, frozenset[str]] = dict.fromkeys(topics, frozenset())

    def add(self, message: Message) -> None:
        self._received[message.topic].append(message.received_ns)
        self._messages[message.topic].append(message.data)
        if len(self._messages[message.topic]) == BLOCK:
            self._decode(message.topic)

    def _decode(self, topic: str) -> None:
        try:
            samples, frames = decode_imus(self._messages[topic])
        except ValueError as error:
            msg = f'Topic `{topic}` of `{self._path}` must hold {IMU_TYPE} messages, but {error}.'
            raise ConfigError(msg) from error
        self._messages[topic].clear()
        self._blocks[topic].append(samples)
        self._frames[topic] |= frames
        if len(self._frames[topic]) > 1:
            names = ' and '.join(f'`{frame}`' for frame in sorted(self._frames[topic])[:2])
            msg = f'Topic `{topic}` must come from one IMU, got {names}; record one topic per IMU.'
            raise ConfigError(msg)

    def tracks(self) -> tuple[ImuTrack, ...]:
        for topic, messages in self._messages.items():
            if messages:
                self._decode(topic)
        return tuple(
            ImuTrack(
                topic,
                next(iter(self._frames[topic]), ''),
                _joined(blocks),
                np.array(self._received[topic], np.int64),
            )
            for topic, blocks in self._blocks.items()
        )


def _joined(blocks: Sequence[ImuSamples]) -> ImuSamples:
    none = ImuSamples(np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)))
    parts = [none, *blocks]
    return ImuSamples(
        np.concatenate([part.stamp_ns for part in parts]),
        np.concatenate([part.angular_rate for part in parts]),
        np.concatenate([part.specific_force for part in parts]),
    )
