"""The two checks at the end of every frame: a CRC-16 and a weighted sum.

CRC-16/CCITT-FALSE (polynomial 0x1021, start 0xFFFF) finds every error of up to three flipped bits
and every burst of up to 16; of heavier damage it lets one frame in 2^15 through, which on a bad
cable is one an hour.  The upper half of Adler-32 (RFC 1950, section 8.2) is arithmetic modulo
65521, not modulo 2, so what slips past one of them does not slip past the other: together one
damaged scan in about 2^31.  Both cost an 8-bit controller a few cycles a byte.
"""

import binascii
import struct
import zlib

_CHECKS = struct.Struct('<HH')
SIZE = _CHECKS.size


def seal(payload: bytes) -> bytes:
    """Return `payload` with its weighted sum and its CRC behind it."""
    summed = payload + (zlib.adler32(payload) >> 16).to_bytes(2, 'little')
    return summed + binascii.crc_hqx(summed, 0xFFFF).to_bytes(2, 'little')


def is_sealed(block: bytes) -> bool:
    """Say whether `block` ends in the two checks of what stands before them."""
    if len(block) <= SIZE:
        return False
    weighted_sum, crc = _CHECKS.unpack_from(block, len(block) - SIZE)
    if binascii.crc_hqx(block[:-2], 0xFFFF) != crc:
        return False
    return bool(zlib.adler32(block[:-SIZE]) >> 16 == weighted_sum)
