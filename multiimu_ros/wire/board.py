"""One board, from bytes to samples in SI units on the host's clock.

The scale factors come with the board's HELLO.  Until one was heard nothing can be said of a count,
so scans only teach the clock then, and `requests` asks for the HELLO.
"""

from typing import NamedTuple

from multiimu_ros.wire import packets
from multiimu_ros.wire.clock import DeviceClock
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Hello, Scan, Status, Sync

_EXCHANGES_PENDING = 8  # a board that does not answer must not fill the memory

Values = tuple[float, float, float, float, float, float]


class RawSample(NamedTuple):
    """One reading at nominal scale: angular rate [rad/s], then specific force [m/s^2]."""

    imu: int
    stamp_ns: int
    values: Values


class Board:
    """Turns blocks of bytes and their arrival into samples.

    Attributes
    ----------
    decoder, clock
        Their counters are the board's.
    hello, status : Hello, Status or None
        The last of each.
    held_back : int
        Scans that came before their scale factors.
    unannounced : int
        Readings of IMUs that HELLO did not name.
    foreign_protocol : int or None
        Version of a board that speaks another protocol than ours; nothing of it is used.
    """

    def __init__(self) -> None:
        self.decoder = FrameDecoder()
        self.clock = DeviceClock()
        self.hello: Hello | None = None
        self.status: Status | None = None
        self.held_back = 0
        self.unannounced = 0
        self.foreign_protocol: int | None = None
        self._scales: dict[int, tuple[float, float]] = {}
        self._sent: dict[int, int] = {}  # token -> instant [ns]
        self._token = 0

    def push(self, data: bytes, arrival_ns: int) -> list[RawSample]:
        """Return the samples that `data`, read at `arrival_ns`, completes."""
        samples: list[RawSample] = []
        for packet in self.decoder.push(data):
            match packet:
                case Scan():
                    samples += self._samples(packet, arrival_ns)
                case Hello():
                    self._greet(packet)
                case Status():
                    self.status = packet
                case Sync(token, ticks_us) if token in self._sent:
                    self.clock.bound(ticks_us, self._sent.pop(token), arrival_ns)
        return samples

    def requests(self, now_ns: int) -> bytes:
        """Return what to send to the board at `now_ns`, about once a second."""
        self._token = (self._token + 1) & 0xFFFFFFFF
        self._sent[self._token] = now_ns
        if len(self._sent) > _EXCHANGES_PENDING:
            del self._sent[min(self._sent, key=self._sent.__getitem__)]
        ask = packets.encode(packets.HelloRequest()) if self.hello is None else b''
        return ask + packets.encode(packets.SyncRequest(self._token))

    def reconnect(self) -> None:
        """Forget what a new connection may have changed: scale factors and unfinished frames."""
        self.decoder.restart()
        self.hello = None
        self._scales = {}
        self._sent = {}

    def _greet(self, hello: Hello) -> None:
        if hello.reason == packets.BOOT:
            self.clock.restart()
        if hello.protocol != packets.PROTOCOL:
            self.foreign_protocol = hello.protocol
            return
        self.hello, self.foreign_protocol = hello, None
        self._scales = {
            info.imu: (info.angular_rate_scale, info.specific_force_scale) for info in hello.imus
        }

    def _samples(self, scan: Scan, arrival_ns: int) -> list[RawSample]:
        start_ns = self.clock.observe(scan.ticks_us, arrival_ns)
        if not self._scales:
            self.held_back += 1
            return []
        rate, samples = self.clock.ns_per_tick, []
        for imu, (dt_us, (wx, wy, wz, fx, fy, fz)) in scan.imus.items():
            scale = self._scales.get(imu)
            if scale is None:
                self.unannounced += 1
                continue
            w, f = scale
            values = (w * wx, w * wy, w * wz, f * fx, f * fy, f * fz)
            samples.append(RawSample(imu, start_ns + round(rate * dt_us), values))
        return samples
