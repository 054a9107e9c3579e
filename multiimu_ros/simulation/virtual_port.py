"""A serial port that is none: a pseudo-terminal whose far end any program may open.

It behaves as a USB serial port does: what is written while nobody has it open is gone, a reader
that stalls loses bytes, and pulling the plug ends the reader's file with an error.  A symbolic
link gives it a path that survives replugging.
"""

from contextlib import suppress
import os
from pathlib import Path
import select
import termios
import tty

from multiimu_ros.errors import TransportError

READ_SIZE = 4096


class VirtualPort:
    """A port that is plugged in from the start.

    Parameters
    ----------
    link : str or None
        Where to put a symbolic link to the terminal, if anywhere.

    Raises
    ------
    TransportError
        If the link cannot be made.
    """

    def __init__(self, link: str | os.PathLike[str] | None = None) -> None:
        self._link = None if link is None else Path(link)
        self._master: int | None = None
        self._terminal = ''
        self.lost_bytes = 0
        self.plug()

    @property
    def path(self) -> str:
        """Path to open: the link, or else the terminal itself."""
        return self._terminal if self._link is None else str(self._link)

    def plug(self) -> None:
        """Put the port back; nothing happens if it is there."""
        if self._master is not None:
            return
        master, terminal = os.openpty()
        os.set_blocking(master, False)
        self._terminal = os.ttyname(terminal)
        # Closed again at once, so that the master sees a hang-up until somebody else opens it.
        os.close(terminal)
        self._master = master
        if self._link is not None:
            self._make_link(self._link)

    def _make_link(self, link: Path) -> None:
        draft = link.with_name(f'.{link.name}.{os.getpid()}')
        try:
            if link.exists() and not link.is_symlink():
                msg = f'`link` must not be a file that exists, got `{link}`; choose another path.'
                raise TransportError(msg)
            draft.symlink_to(self._terminal)
            draft.replace(link)
        except OSError as error:
            msg = f'Cannot make the link `{link}`: {error.strerror}; choose a writable place.'
            raise TransportError(msg) from error

    def unplug(self) -> None:
        """Take the port away, and its link; a reader gets an error, as from a pulled plug."""
        if self._master is None:
            return
        if self._link is not None and self._link.is_symlink():
            self._link.unlink()
        os.close(self._master)
        self._master = None

    def opened(self) -> bool:
        """Say whether somebody has the port open."""
        if self._master is None:
            return False
        poll = select.poll()
        poll.register(self._master, 0)
        return not any(event & select.POLLHUP for _, event in poll.poll(0))

    def make_raw(self) -> None:
        """Switch off echo and line editing, unless the reader has done so."""
        if self._master is None:
            return
        local_modes = termios.tcgetattr(self._master)[3]
        if local_modes & (termios.ECHO | termios.ICANON):
            tty.setraw(self._master)

    def write(self, data: bytes) -> None:
        """Send what the reader has room for; count the rest as lost."""
        sent = 0
        if self._master is not None:
            with suppress(BlockingIOError):
                sent = os.write(self._master, data)
        self.lost_bytes += len(data) - sent

    def read(self) -> bytes:
        """Return what has come in, without waiting."""
        if self._master is None:
            return b''
        try:
            return os.read(self._master, READ_SIZE)
        except (BlockingIOError, OSError):  # nothing there, or nobody
            return b''

    def wait(self, seconds: float) -> None:
        """Return after `seconds`, or sooner when something has come in from an open port."""
        readable = [self._master] if self.opened() and self._master is not None else []
        select.select(readable, [], [], max(seconds, 0.0))
