"""A serial port that can be unplugged: a pty behind a path of its own."""

import os
from pathlib import Path
import time
import tty


class PluggedPort:
    """The device's end of a port; `path` stays the same over unplugging."""

    def __init__(self, path):
        self.path = str(path)
        self._master = -1

    def plug(self):
        """Make the port appear."""
        self._master, slave = os.openpty()
        tty.setraw(slave)
        Path(self.path).symlink_to(os.ttyname(slave))
        self._slave = slave  # kept open: a pty without reader hangs up for good

    def unplug(self):
        """Make it vanish."""
        if self._master >= 0:
            os.close(self._master)
            os.close(self._slave)
            Path(self.path).unlink()
            self._master = -1

    def send(self, data):
        """Speak as the device."""
        while data:
            data = data[os.write(self._master, data) :]

    def hear(self):
        """Return what the host wrote."""
        return os.read(self._master, 4096)


def wait_until(condition, timeout_s=5.0):
    """Wait for a condition; False where it did not come true in time."""
    end = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.005)
    return True
