"""The packets of the board's protocol, as values and as bytes.

docs/wire_format.md is the same text for people who program a board.  All fields are little-endian;
a frame is COBS(packet, weighted sum, CRC-16), 0x00.  A packet whose bytes do not fit its type to
the last one is refused, so that damage has little room to look like a packet.
"""

from collections.abc import Callable, Mapping
from dataclasses import astuple, dataclass, field
import math
import struct

from multiimu_ros.wire import cobs, crc

PROTOCOL = 1  # version that HELLO carries
MAX_IMUS = 16
MAX_PACKET = 320  # [bytes] a HELLO of 16 IMUs has 270
UNKNOWN_TEMPERATURE = -32768

HELLO, SCAN, STATUS, SYNC, WIDE_SCAN = 0x01, 0x02, 0x03, 0x04, 0x05
HELLO_REQUEST, SYNC_REQUEST = 0x11, 0x12
BOOT, ASKED = 0, 1  # why a HELLO was sent

_HELLO = struct.Struct('<BBBBBHIB')  # type, protocol, reason, major, minor, rate, ticks, count
_HELLO_IMU = struct.Struct('<BBBBHHff')
_SCAN, _WIDE_SCAN = struct.Struct('<BHIB'), struct.Struct('<BHIH')  # type, seq, t0, mask
_STATUS = struct.Struct('<BIHHH')  # type, ticks, overruns, recoveries, mask
_STATUS_IMU = struct.Struct('<Hh')
_SYNC = struct.Struct('<BII')
_SYNC_REQUEST = struct.Struct('<BI')
_IMU_SIZE = 14  # dt and six counts
_READINGS = tuple(struct.Struct('<' + 'Hhhhhhh' * count) for count in range(MAX_IMUS + 1))
_INDICES = tuple(tuple(k for k in range(8) if mask >> k & 1) for mask in range(256))

Counts = tuple[int, int, int, int, int, int]


@dataclass(frozen=True, slots=True)
class ImuInfo:
    """What HELLO says of one IMU.

    Parameters
    ----------
    imu : int
        Index k, 0-15; names the topic `imu<k>`.
    model : int
        Key of `MODELS`.
    address, channel : int
        I2C address and multiplexer channel; 255 is "no multiplexer".
    angular_rate_range, specific_force_range : int
        Full scale [deg/s], [g].
    angular_rate_scale, specific_force_scale : float
        SI units of one count [rad/s], [m/s^2]; single precision on the wire.
    """

    imu: int
    model: int
    address: int
    channel: int
    angular_rate_range: int
    specific_force_range: int
    angular_rate_scale: float
    specific_force_scale: float


MODELS = {0: 'unknown', 1: 'BMI160', 2: 'MPU-9250', 3: 'BNO055', 4: 'SEN0140'}


@dataclass(frozen=True, slots=True)
class Hello:
    """Who the board is; sent at its start (`reason` BOOT) and when asked (ASKED)."""

    imus: tuple[ImuInfo, ...]
    rate_hz: int
    ticks_us: int = 0
    reason: int = BOOT
    firmware: tuple[int, int] = (0, 0)
    protocol: int = PROTOCOL


@dataclass(frozen=True, slots=True)
class Scan:
    """One reading of all the IMUs that answered.

    Parameters
    ----------
    seq : int
        Number of the scan, modulo 2^16.
    ticks_us : int
        Device time t0, modulo 2^32 [us].
    imus : mapping of int to (int, tuple of 6 int)
        For each IMU: its own instant after t0 [us]; angular rate and specific force [counts].
    """

    seq: int
    ticks_us: int
    imus: Mapping[int, tuple[int, Counts]]


@dataclass(frozen=True, slots=True)
class Status:
    """The board's counters, once a second.

    Parameters
    ----------
    ticks_us : int
        Device time, modulo 2^32 [us].
    overruns, recoveries : int
        Scans dropped before sending; resets of a stuck bus.  Both count modulo 2^16.
    imus : mapping of int to (int, float)
        For each IMU: failed reads, modulo 2^16; temperature [Celsius], NaN where unknown.
    """

    ticks_us: int
    overruns: int = 0
    recoveries: int = 0
    imus: Mapping[int, tuple[int, float]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Sync:
    """Answer to a SyncRequest: the device time at which its last byte came in [us]."""

    token: int
    ticks_us: int


@dataclass(frozen=True, slots=True)
class HelloRequest:
    """The host asks for a Hello."""


@dataclass(frozen=True, slots=True)
class SyncRequest:
    """The host asks for the device time; the token comes back."""

    token: int


Packet = Hello | Scan | Status | Sync | HelloRequest | SyncRequest


def encode(packet: Packet) -> bytes:
    """Return the whole frame of `packet`: stuffed, sealed and ended by its zero.

    Raises
    ------
    ValueError
        If a field does not fit its place.
    """
    try:
        payload = _payload(packet)
    except (struct.error, OverflowError) as error:
        msg = f'`packet` must have fields that fit the wire ({error}), got {packet}.'
        raise ValueError(msg) from error
    return cobs.encode(crc.seal(payload)) + b'\0'


def _payload(packet: Packet) -> bytes:
    match packet:
        case Scan():
            return _scan_payload(packet)
        case Hello(imus, rate_hz, ticks_us, reason, (major, minor), protocol):
            head = _HELLO.pack(HELLO, protocol, reason, major, minor, rate_hz, ticks_us, len(imus))
            return head + b''.join(_HELLO_IMU.pack(*astuple(info)) for info in imus)
        case Status(ticks_us, overruns, recoveries, imus):
            head = _STATUS.pack(STATUS, ticks_us, overruns, recoveries, _mask(imus))
            return head + b''.join(_status_imu(*imus[k]) for k in sorted(imus))
        case Sync(token, ticks_us):
            return _SYNC.pack(SYNC, token, ticks_us)
        case SyncRequest(token):
            return _SYNC_REQUEST.pack(SYNC_REQUEST, token)
        case HelloRequest():
            return bytes([HELLO_REQUEST])


def _mask(imus: Mapping[int, object]) -> int:
    if any(not 0 <= k < MAX_IMUS for k in imus):
        msg = f'`imus` must have indices in 0-{MAX_IMUS - 1}, got {sorted(imus)}.'
        raise ValueError(msg)
    return sum(1 << k for k in imus)


def _scan_payload(scan: Scan) -> bytes:
    mask = _mask(scan.imus)
    kind, layout = (SCAN, _SCAN) if mask < 256 else (WIDE_SCAN, _WIDE_SCAN)
    readings = [value for k in sorted(scan.imus) for value in (scan.imus[k][0], *scan.imus[k][1])]
    head = layout.pack(kind, scan.seq, scan.ticks_us, mask)
    return head + _READINGS[len(scan.imus)].pack(*readings)


def _status_imu(failures: int, temperature: float) -> bytes:
    unknown = math.isnan(temperature)
    return _STATUS_IMU.pack(
        failures, UNKNOWN_TEMPERATURE if unknown else round(temperature * 100.0)
    )


def decode(payload: bytes) -> Packet | None:
    """Return the packet in `payload` (without checks), or None where it is none of ours."""
    decoder = _DECODERS.get(payload[0]) if payload else None
    return decoder(payload) if decoder else None


def _decode_scan(payload: bytes) -> Scan | None:
    if len(payload) < _SCAN.size:
        return None
    _, seq, ticks_us, mask = _SCAN.unpack_from(payload)
    return _scan(payload, _SCAN.size, (seq, ticks_us), _INDICES[mask])


def _decode_wide_scan(payload: bytes) -> Scan | None:
    if len(payload) < _WIDE_SCAN.size:
        return None
    _, seq, ticks_us, mask = _WIDE_SCAN.unpack_from(payload)
    if mask < 256:  # a SCAN could have said it
        return None
    high = tuple(k + 8 for k in _INDICES[mask >> 8])
    return _scan(payload, _WIDE_SCAN.size, (seq, ticks_us), _INDICES[mask & 255] + high)


def _scan(
    payload: bytes, start: int, head: tuple[int, int], indices: tuple[int, ...]
) -> Scan | None:
    if len(payload) != start + _IMU_SIZE * len(indices):
        return None
    v = _READINGS[len(indices)].unpack_from(payload, start)
    imus = {k: (v[i], v[i + 1 : i + 7]) for k, i in zip(indices, range(0, len(v), 7), strict=True)}
    return Scan(*head, imus)


def _decode_hello(payload: bytes) -> Hello | None:
    if len(payload) < _HELLO.size:
        return None
    _, protocol, reason, major, minor, rate_hz, ticks_us, count = _HELLO.unpack_from(payload)
    entries = payload[_HELLO.size :]
    if len(entries) != count * _HELLO_IMU.size or reason not in (BOOT, ASKED):
        return None
    imus = tuple(ImuInfo(*values) for values in _HELLO_IMU.iter_unpack(entries))
    if not all(_plausible(info) for info in imus) or len({info.imu for info in imus}) < count:
        return None
    return Hello(imus, rate_hz, ticks_us, reason, (major, minor), protocol)


def _plausible(info: ImuInfo) -> bool:
    scales = (info.angular_rate_scale, info.specific_force_scale)
    return info.imu < MAX_IMUS and all(0.0 < scale < math.inf for scale in scales)


def _decode_status(payload: bytes) -> Status | None:
    if len(payload) < _STATUS.size:
        return None
    _, ticks_us, overruns, recoveries, mask = _STATUS.unpack_from(payload)
    indices = [k for k in range(MAX_IMUS) if mask >> k & 1]
    entries = payload[_STATUS.size :]
    if len(entries) != len(indices) * _STATUS_IMU.size:
        return None
    imus = {
        k: (failures, math.nan if centi == UNKNOWN_TEMPERATURE else centi / 100.0)
        for k, (failures, centi) in zip(indices, _STATUS_IMU.iter_unpack(entries), strict=True)
    }
    return Status(ticks_us, overruns, recoveries, imus)


def _decode_sync(payload: bytes) -> Sync | None:
    return Sync(*_SYNC.unpack(payload)[1:]) if len(payload) == _SYNC.size else None


def _decode_sync_request(payload: bytes) -> SyncRequest | None:
    fits = len(payload) == _SYNC_REQUEST.size
    return SyncRequest(_SYNC_REQUEST.unpack(payload)[1]) if fits else None


def _decode_hello_request(payload: bytes) -> HelloRequest | None:
    return HelloRequest() if len(payload) == 1 else None


_DECODERS: dict[int, Callable[[bytes], Packet | None]] = {
    HELLO: _decode_hello,
    SCAN: _decode_scan,
    STATUS: _decode_status,
    SYNC: _decode_sync,
    WIDE_SCAN: _decode_wide_scan,
    HELLO_REQUEST: _decode_hello_request,
    SYNC_REQUEST: _decode_sync_request,
}

_PARTS = (
    (HELLO, _HELLO.size, _HELLO_IMU.size, MAX_IMUS),
    (SCAN, _SCAN.size, _IMU_SIZE, 8),
    (STATUS, _STATUS.size, _STATUS_IMU.size, MAX_IMUS),
    (SYNC, _SYNC.size, 0, 0),
    (WIDE_SCAN, _WIDE_SCAN.size, _IMU_SIZE, MAX_IMUS),
    (HELLO_REQUEST, 1, 0, 0),
    (SYNC_REQUEST, _SYNC_REQUEST.size, 0, 0),
)
SIZES = {kind: {head + n * each for n in range(most + 1)} for kind, head, each, most in _PARTS}
