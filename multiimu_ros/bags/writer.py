"""Write rosbag2 recordings (mcap or sqlite3) that stock tools read and replay."""

from collections import Counter, defaultdict
import io
import os
from pathlib import Path
import sqlite3
from struct import unpack_from
from types import TracebackType
from typing import cast, Literal, Self

from rosbags.interfaces import (
    Connection,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import get_typestore, Stores

from multiimu_ros.errors import ConfigError

VERSION: Literal[9] = 9  # of the metadata, as Jazzy writes it
DEPTH = 10  # ROS's default queue; a player takes it over for its publishers
FOR_EVER = QosTime(9223372036, 854775807)  # the middleware's name for no limit
DISK = (OSError, sqlite3.Error)  # what a full or broken disk raises
COMMIT = 4096  # messages after which sqlite makes sure of them
RESERVE = 1 << 22  # bytes set aside, so that a full disk still takes the index of 4 h at 1 MB/s


def _qos(reliable: bool, latched: bool) -> Qos:
    return Qos(
        QosHistory.KEEP_LAST,
        DEPTH,
        QosReliability.RELIABLE if reliable else QosReliability.BEST_EFFORT,
        QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        FOR_EVER,
        FOR_EVER,
        QosLiveliness.AUTOMATIC,
        FOR_EVER,
        False,
    )


def _reason(error: Exception) -> str:
    return getattr(error, 'strerror', None) or str(error)


class _WholeWrites(io.FileIO):
    """An unbuffered file that writes all it is given or raises; nothing waits in a buffer."""

    def write(self, data: object) -> int:
        view = memoryview(data).cast('B')  # type: ignore[arg-type]
        written = 0
        while written < len(view):
            written += super().write(view[written:]) or 0
        return written


class BagWriter:
    """Write serialised messages; a context manager.

    Leaving it closes the bag, whatever happened inside: what was written stays readable.  Where
    the disk is full, the bag ends with the last complete chunk or commit, `write` raises, and
    `lost` counts the messages after that.

    Parameters
    ----------
    path : path
        Folder to make; it must not exist.
    storage : 'mcap' or 'sqlite3'
        Format of the file in it.

    Raises
    ------
    ConfigError
        If the bag cannot be made or written to.
    """

    def __init__(self, path: str | os.PathLike[str], storage: str = 'mcap') -> None:
        self.path = Path(path)
        self.lost = 0
        self.counts: Counter[str] = Counter()
        self._typestore = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Connection] = {}
        self._reserve = self.path / '.reserve'
        self._complete = 0  # bytes of the file up to the last complete chunk
        self._chunks = self._uncommitted = 0
        plugin = {'mcap': StoragePlugin.MCAP, 'sqlite3': StoragePlugin.SQLITE3}.get(storage)
        if plugin is None:
            msg = f'`storage` must be mcap or sqlite3, got {storage!r}.'
            raise ConfigError(msg)
        try:
            self._writer = Writer(self.path, version=VERSION, storage_plugin=plugin)
            self._writer.open()
            with self._reserve.open('wb') as file:
                os.posix_fallocate(file.fileno(), 0, RESERVE)
        except WriterError as error:
            msg = f'The bag `{path}` exists already; remove it or choose another name.'
            raise ConfigError(msg) from error
        except OSError as error:
            msg = f'Cannot make the bag `{path}`: {error.strerror}; choose a writable place.'
            raise ConfigError(msg) from error
        self._mcap = self._writer.storage if isinstance(self._writer.storage, McapWriter) else None
        if self._mcap is None:
            self._sqlite = cast('Sqlite3Writer', self._writer.storage)
        else:
            self._mcap.bio.close()
            self._mcap.bio = cast('io.BufferedWriter', _WholeWrites(self._mcap.path, 'r+'))
            self._mcap.bio.seek(0, io.SEEK_END)
            self._complete = self._mcap.bio.tell()

    def add_topic(
        self, topic: str, msgtype: str, *, reliable: bool = True, latched: bool = False
    ) -> None:
        """Declare a topic and the quality of service with which it was published."""
        if msgtype not in self._typestore.fielddefs:
            msg = f'`{topic}` must be of a type that ROS 2 Jazzy brings, got `{msgtype}`.'
            raise ConfigError(msg)
        self._connections[topic] = self._writer.add_connection(
            topic,
            msgtype,
            typestore=self._typestore,
            offered_qos_profiles=[_qos(reliable, latched)],
        )

    def write(self, topic: str, received_ns: int, data: bytes) -> None:
        """Append one serialised message of a declared topic."""
        self.counts[topic] += 1
        self._uncommitted += 1
        try:
            self._writer.write(self._connections[topic], received_ns, data)
            self._note_what_is_safe()
        except DISK as error:
            self._rescue()
            msg = (
                f'The bag `{self.path}` ends early, without the last {self.lost} messages, as '
                f'the disk says: {_reason(error)}; make room and record again.'
            )
            raise ConfigError(msg) from error

    def _note_what_is_safe(self) -> None:
        if self._mcap is not None and len(self._mcap.chunks) > self._chunks:
            self._chunks = len(self._mcap.chunks)
            self._complete = self._mcap.bio.tell()
        elif self._mcap is None and self._uncommitted == COMMIT:
            self._sqlite.conn.commit()
            self._uncommitted = 0

    def _rescue(self) -> None:
        """Close the bag after its last complete chunk, in the room that was set aside."""
        storage = self._mcap
        if storage is None:
            self.lost = self._uncommitted
            self._writer.abort()
            self._reserve.unlink()
            return
        storage.bio.truncate(storage.bio.seek(self._complete))
        for number, entries in storage.chunk.msgs.items():
            storage.channel_stats[number] -= len(entries)
            self.lost += len(entries)
        del storage.chunks[self._chunks :]
        ends = [unpack_from('<Q', chunk.getbuffer(), 8)[0] for chunk in storage.chunks]
        storage.message_end_time = self._writer.max_timestamp = max(ends, default=0)
        self._writer.counts.update(storage.channel_stats)
        storage.chunk = PendingChunk(2**63 - 1, 0, io.BytesIO(), defaultdict(list))
        self.close()

    def close(self) -> None:
        """Write the index and the metadata; a second call does nothing."""
        self._reserve.unlink(missing_ok=True)
        if self._writer.storage is None:
            return
        try:
            self._writer.close()
        except DISK as error:
            self._writer.abort()
            msg = f'Cannot finish the bag `{self.path}`: {_reason(error)}; make room.'
            raise ConfigError(msg) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()
