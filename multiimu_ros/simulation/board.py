"""The emulated board on its port: the device's frames, at their instants, through a terminal.

The motion begins when the port is first opened, as a Mega resets when its port is opened; each
opening after that boots the firmware again while the motion goes on.
"""

from collections.abc import Callable
import time

from multiimu_ros.simulation.device import EmulatedDevice
from multiimu_ros.simulation.faults import FaultPlan
from multiimu_ros.simulation.virtual_port import VirtualPort

SLICE = 0.001  # [s] frames due within one slice go together
IDLE = 0.02  # [s] between two looks at a closed port


class EmulatedBoard:
    """One board on one port.

    Parameters
    ----------
    device : EmulatedDevice
        What is sent.
    port : VirtualPort
        Where it goes.
    faults : FaultPlan
        The device's own; the board obeys `unplug`.
    on_start : callable
        Is told the host time [ns] of time 0 when the motion begins.
    """

    def __init__(
        self,
        device: EmulatedDevice,
        port: VirtualPort,
        faults: FaultPlan,
        on_start: Callable[[int], None],
    ) -> None:
        self._device = device
        self._port = port
        self._faults = faults
        self._on_start = on_start
        self._start: float | None = None  # on the monotonic clock
        self._open = False
        self.sent_bytes = 0

    def now(self) -> float:
        """Return the time since the motion began [s], 0 before."""
        return 0.0 if self._start is None else time.monotonic() - self._start

    @property
    def finished(self) -> bool:
        """Whether the motion is over and sent."""
        return self._device.finished

    def step(self) -> None:
        """Do what is due, then wait until there is more, for a few milliseconds at most."""
        if self._faults.unplugged(self.now()):
            self._port.unplug()
        else:
            self._port.plug()
        opened = self._port.opened()
        if opened and not self._open:
            self._boot()
        self._open = opened
        if self._start is not None:
            self._exchange()
        pause = self._device.next_due() - self.now() if opened else IDLE
        self._port.wait(min(max(pause, SLICE), IDLE))

    def _boot(self) -> None:
        """Begin: the port has been opened."""
        self._port.make_raw()
        self._port.read()  # what the terminal echoed before it was raw
        if self._start is None:
            # Both clocks are read together; the motion's time 0 is now.
            self._start = time.monotonic()
            self._on_start(time.time_ns())
        now = self.now()
        self._device.boot(now)
        self._send(self._device.hello(now))

    def _exchange(self) -> None:
        frames = self._device.frames(self.now())
        if self._open:
            self._send(b''.join(frames))
            request = self._port.read()
            if request:
                self._send(self._device.answer(request, self.now()))

    def _send(self, data: bytes) -> None:
        self._port.write(data)
        self.sent_bytes += len(data)
