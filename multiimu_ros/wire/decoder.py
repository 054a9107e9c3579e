"""Bytes in, packets out: finds the frames in whatever a serial line delivers.

A zero ends a frame, so the decoder cuts at zeros, unstuffs, and believes what passes both checks
and fits its type.  What does not is counted, never raised.  Where the zero before a frame got
lost, the frame is the tail of a longer piece; its possible lengths are few, so they are tried.
"""

from multiimu_ros.wire import cobs, crc, packets
from multiimu_ros.wire.packets import Packet, Scan

_MAX_PIECE = packets.MAX_PACKET + crc.SIZE + 3  # stuffing adds a code, and one per 254 bytes
_RESTART = 0x8000  # scans that seem to be missing when a board counts from zero again


def _tails() -> dict[int, set[int]]:
    """Map the length of a stuffed frame to the types that can have it."""
    tails: dict[int, set[int]] = {}
    for kind, sizes in packets.SIZES.items():
        for size in sizes:
            sealed = size + crc.SIZE
            for length in {sealed + 1, sealed + 1 + sealed // 254}:
                tails.setdefault(length, set()).add(kind)
    return dict(sorted(tails.items(), reverse=True))


_TAILS = _tails()


class FrameDecoder:
    """Turns blocks of bytes, however cut, into packets.

    Attributes
    ----------
    bytes, frames : int
        Bytes seen; packets handed out.
    cobs_errors, crc_errors, unknown : int
        Pieces between zeros that are no stuffing (or too long), fail a check, or pass both but
        fit no packet of this protocol.
    lost : int
        Scans that the sequence numbers say are missing.
    """

    def __init__(self) -> None:
        self.bytes = 0
        self.frames = 0
        self.cobs_errors = 0
        self.crc_errors = 0
        self.unknown = 0
        self.lost = 0
        self._piece = b''
        self._next_seq: int | None = None

    def push(self, data: bytes) -> list[Packet]:
        """Return the packets that `data` completes, in order."""
        self.bytes += len(data)
        *pieces, rest = (self._piece + data).split(b'\0')
        # An endless piece stays too long, and stays bounded.
        self._piece = rest if len(rest) <= _MAX_PIECE else rest[-_MAX_PIECE - 1 :]
        found = [self._read(piece) for piece in pieces if piece]
        return [packet for packet in found if packet is not None]

    def restart(self) -> None:
        """Forget the unfinished piece and the last sequence number: the line was cut."""
        self._piece = b''
        self._next_seq = None

    def _read(self, piece: bytes) -> Packet | None:
        block = cobs.decode(piece) if len(piece) <= _MAX_PIECE else None
        packet = packets.decode(block[: -crc.SIZE]) if block and crc.is_sealed(block) else None
        if packet is None:
            self._count_damage(block)
            packet = _packet_at_end(piece)
        if packet is not None:
            self.frames += 1
            self._follow(packet)
        return packet

    def _count_damage(self, block: bytes | None) -> None:
        if block is None:
            self.cobs_errors += 1
        elif crc.is_sealed(block):
            self.unknown += 1
        else:
            self.crc_errors += 1

    def _follow(self, packet: Packet) -> None:
        if isinstance(packet, Scan):
            if self._next_seq is not None:
                missing = (packet.seq - self._next_seq) & 0xFFFF
                self.lost += missing if missing < _RESTART else 0
            self._next_seq = (packet.seq + 1) & 0xFFFF
        elif isinstance(packet, packets.Hello) and packet.reason == packets.BOOT:
            self._next_seq = None


def _packet_at_end(piece: bytes) -> Packet | None:
    size = len(piece)
    for length, kinds in _TAILS.items():
        # The first code is followed by the type, which is never zero.
        if length < size and piece[size - length + 1] in kinds:
            block = cobs.decode(piece[-length:])
            if block and crc.is_sealed(block):
                packet = packets.decode(block[: -crc.SIZE])
                if packet is not None:
                    return packet
    return None
