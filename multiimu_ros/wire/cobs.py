"""Consistent overhead byte stuffing [1]_: any bytes, written without a zero.

A block of up to 254 bytes without zero is preceded by a code: its length plus one.  Each code but
the last also stands for a zero after its block, unless it is 255.  A zero byte can then end a
frame, and a reader that lost its place finds it again at the next one.

.. [1] S. Cheshire, M. Baker, "Consistent overhead byte stuffing", IEEE/ACM Trans. Netw. 7(2),
   1999.
"""

_LONGEST = 254  # bytes under one code


def encode(payload: bytes) -> bytes:
    """Return `payload` without zeros; the zero that ends a frame is left to the caller."""
    coded = bytearray()
    for block in payload.split(b'\0'):
        full = len(block) // _LONGEST * _LONGEST
        for start in range(0, full, _LONGEST):
            coded.append(255)
            coded += block[start : start + _LONGEST]
        coded.append(len(block) - full + 1)
        coded += block[full:]
    return bytes(coded)


def decode(coded: bytes) -> bytes | None:
    """Return the payload of `coded`, or None where the codes do not lead to its end."""
    payload = bytearray()
    position, size = 0, len(coded)
    while position < size:
        code = coded[position]
        if code == 0 or position + code > size:
            return None
        payload += coded[position + 1 : position + code]
        position += code
        if code <= _LONGEST and position < size:
            payload.append(0)
    return bytes(payload)
