"""What a port delivered, kept in a file: so a session can be decoded again, bit for bit.

The file is the eight bytes `MIMUCAP1`, then for each block its arrival (int64, ns since 1970), its
length (uint32) and its bytes; little-endian.
"""

from collections.abc import Iterator
import os
from pathlib import Path
import struct
from typing import Self

from multiimu_ros.errors import TransportError

_MAGIC = b'MIMUCAP1'
_HEAD = struct.Struct('<qI')


class CaptureWriter:
    """Appends blocks to a new file; a context manager.

    Raises
    ------
    TransportError
        If the file cannot be made.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        try:
            self._file = Path(path).open('wb')  # noqa: SIM115 (closed by `close`)
        except OSError as error:
            msg = f'Cannot write the capture `{path}`: {error.strerror}; choose a writable place.'
            raise TransportError(msg) from error
        self._file.write(_MAGIC)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def write(self, arrival_ns: int, data: bytes) -> None:
        """Add one block."""
        self._file.write(_HEAD.pack(arrival_ns, len(data)) + data)

    def close(self) -> None:
        """Finish the file."""
        self._file.close()


def read_capture(path: str | os.PathLike[str]) -> Iterator[tuple[int, bytes]]:
    """Yield arrival [ns] and bytes of each block; a block cut short by a crash is left out.

    Raises
    ------
    TransportError
        If the file cannot be read, or is no capture.
    """
    try:
        with Path(path).open('rb') as file:
            if file.read(len(_MAGIC)) != _MAGIC:
                msg = f'`{path}` must be a capture that starts with {_MAGIC!r}; pass another file.'
                raise TransportError(msg)
            while len(head := file.read(_HEAD.size)) == _HEAD.size:
                arrival_ns, size = _HEAD.unpack(head)
                data = file.read(size)
                if len(data) < size:
                    return
                yield arrival_ns, data
    except OSError as error:
        msg = f'Cannot read the capture `{path}`: {error.strerror}; pass an existing file.'
        raise TransportError(msg) from error
