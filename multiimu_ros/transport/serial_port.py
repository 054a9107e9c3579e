"""A serial port that is read for ever, through every unplugging.

A thread waits for bytes, notes the time as soon as it has them, and hands both on.  Where the
port cannot be opened, or goes away, it tries again after 0.1 s, then 0.2 s, up to every 0.5 s.

Arrivals are host time without its steps: the system's clock is read once, at the start, and the
monotonic one counts from there, so that a correction of the former never tears a recording.
"""

from collections.abc import Callable
import os
import select
import termios
import threading
import time

import serial
from serial.tools import list_ports

from multiimu_ros.errors import ConfigError, TransportError

_FIRST_DELAY_S, _LONGEST_DELAY_S = 0.1, 0.5
_LOOK_S = 0.1  # how often a silent port looks whether it shall stop
_BLOCK = 65536  # [bytes]
_FAILURES = (OSError, termios.error)  # pyserial lets the second one through


class SerialTransport:
    """Reads one port on a thread of its own.

    Parameters
    ----------
    on_block : callable
        Called on that thread with the arrival [ns since 1970] and the bytes.
    port : str
        Device path, such as /dev/ttyACM0.
    usb_serial : str
        Serial number of the USB device; finds the port wherever it is plugged in.
    baud : int
        Symbols per second.
    on_connect : callable, optional
        Called on that thread each time the port has been opened.

    Attributes
    ----------
    connected : bool
        Whether the port is open now.
    connections, bytes : int
        How often it was opened; bytes read.
    last_error : str
        Why it is not open, or was not before.

    Raises
    ------
    ConfigError
        If not exactly one of `port` and `usb_serial` is given.
    """

    def __init__(
        self,
        on_block: Callable[[int, bytes], None],
        *,
        port: str = '',
        usb_serial: str = '',
        baud: int = 500_000,
        on_connect: Callable[[], None] = lambda: None,
    ) -> None:
        if bool(port) == bool(usb_serial):
            came = f'`{port}` and `{usb_serial}`'
            msg = f'Exactly one of `port` and `usb_serial` must be given, got {came}; set one.'
            raise ConfigError(msg)
        self.connected = False
        self.connections = 0
        self.bytes = 0
        self.last_error = ''
        self._on_block, self._on_connect = on_block, on_connect
        self._port, self._usb_serial, self._baud = port, usb_serial, baud
        self._serial: serial.Serial | None = None
        self._offset_ns = time.time_ns() - time.monotonic_ns()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name='serial reader', daemon=True)

    def now_ns(self) -> int:
        """Return the present instant on the clock of the arrivals."""
        return time.monotonic_ns() + self._offset_ns

    def start(self) -> None:
        """Begin to read."""
        self._thread.start()

    def stop(self) -> None:
        """Close the port and end the thread; takes at most 0.2 s."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def write(self, data: bytes) -> None:
        """Send `data`, or what fits the system's buffer; without a port it is lost."""
        port = self._serial
        if port is None:
            return
        try:
            os.write(port.fileno(), data)
        except (*_FAILURES, ValueError) as error:  # ValueError: just closed by the reader
            self.last_error = str(error)

    def _run(self) -> None:
        delay = _FIRST_DELAY_S
        while not self._stop.is_set():
            try:
                with self._open() as port:
                    delay = _FIRST_DELAY_S
                    self._serve(port)
            except TransportError as error:
                self.last_error = str(error)
            finally:
                self.connected, self._serial = False, None
            if self._stop.wait(delay):
                return
            delay = min(2.0 * delay, _LONGEST_DELAY_S)

    def _open(self) -> serial.Serial:
        path = self._port or _find(self._usb_serial)
        try:
            return serial.Serial(path, self._baud, timeout=0, exclusive=True)
        except (*_FAILURES, ValueError) as error:  # ValueError: a baud rate the port cannot do
            msg = f'Cannot open `{path}` ({error}); is it plugged in, and may this user read it?'
            raise TransportError(msg) from error

    def _serve(self, port: serial.Serial) -> None:
        self.connected, self._serial = True, port
        self.connections += 1
        self._on_connect()
        descriptor = port.fileno()
        while not self._stop.is_set():
            try:
                if not select.select([descriptor], [], [], _LOOK_S)[0]:
                    continue
                data = os.read(descriptor, _BLOCK)
                arrival_ns = self.now_ns()
            except OSError as error:
                msg = f'`{port.port}` went away ({error.strerror}); plug it in again.'
                raise TransportError(msg) from error
            if not data:
                msg = f'`{port.port}` hung up; plug it in again.'
                raise TransportError(msg)
            self.bytes += len(data)
            self._on_block(arrival_ns, data)


def _find(usb_serial: str) -> str:
    """Return the device path of the USB device with that serial number."""
    ports = list_ports.comports()
    for port in ports:
        if port.serial_number == usb_serial:
            return str(port.device)
    seen = ', '.join(str(port.serial_number) for port in ports if port.serial_number) or 'none'
    msg = f'`usb_serial` must be a plugged-in device, got `{usb_serial}`; there are: {seen}.'
    raise TransportError(msg)
