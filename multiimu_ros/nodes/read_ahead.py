"""Reads a bag in a thread of its own, so that a player never waits for the disk."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from queue import Empty, Full, Queue
from threading import Event, Thread

from multiimu_ros.bags import Message, read_messages
from multiimu_ros.errors import MultiImuError

MESSAGES = 20_000  # read ahead, 2.5 s of 8 x 1000 Hz
LOOK_S = 0.1  # how often a thread that waits looks whether it is to stop


class ReadAhead:
    """The messages of a bag, some time before they are needed.

    Parameters
    ----------
    path : str
        The bag.
    topics : sequence of str
        What to read.
    stop : Event
        Ends the reading and the iteration.
    """

    def __init__(self, path: str, topics: Sequence[str], stop: Event) -> None:
        self._path = path
        self._topics = topics
        self._stop = stop
        self._queue: Queue[Message | MultiImuError | None] = Queue(MESSAGES)
        self.thread = Thread(target=self._read)
        self.thread.start()

    def _read(self) -> None:
        try:
            for message in read_messages(self._path, self._topics):
                if not self._put(message):
                    return
            self._put(None)
        except MultiImuError as error:
            self._put(error)

    def _put(self, item: Message | MultiImuError | None) -> bool:
        while not self._stop.is_set():
            with suppress(Full):
                self._queue.put(item, timeout=LOOK_S)
                return True
        return False

    def __iter__(self) -> Iterator[Message]:
        """Yield the messages in recorded order; raise what the reading raised."""
        while not self._stop.is_set():
            with suppress(Empty):
                item = self._queue.get(timeout=LOOK_S)
                if item is None:
                    return
                if isinstance(item, MultiImuError):
                    raise item
                yield item
