"""The decoder against lines that garble, cut and flip what is sent."""

from hypothesis import given, strategies as st

from multiimu_ros.wire import cobs, crc, packets
from multiimu_ros.wire.decoder import FrameDecoder

COUNTERS = ('bytes', 'frames', 'cobs_errors', 'crc_errors', 'unknown', 'lost')
SCANS = st.builds(
    lambda seq, ticks, counts, present: packets.Scan(
        seq, ticks, {k: (400 * k, counts) for k in sorted(present)}
    ),
    st.integers(0, 2**16 - 1),
    st.integers(0, 2**32 - 1),
    st.tuples(*[st.integers(-(2**15), 2**15 - 1)] * 6),
    st.sets(st.integers(0, 15)),
)


def flip(frame, bits):
    damaged = bytearray(frame)
    for bit in bits:
        damaged[bit % (8 * len(frame)) // 8] ^= 1 << bit % 8
    return bytes(damaged)


# What a line delivers: (bytes, the packet in them or None).  A cut takes three bytes or more: the
# next bytes may make up for fewer, and then the frame is whole after all.
WHOLE = SCANS.map(lambda scan: (packets.encode(scan), scan))
RANDOM = st.binary(max_size=600).map(lambda data: (data, None))
SHORT = st.builds(
    lambda scan, share: (packets.encode(scan)[: int(share * 7)], None), SCANS, st.floats(0, 1)
)
CUT = st.builds(lambda scan, n: (packets.encode(scan)[:-n], None), SCANS, st.integers(3, 200))
FLIPPED = st.builds(
    lambda scan, bits: (flip(packets.encode(scan), bits), None),
    SCANS,
    st.sets(st.integers(0, 239), min_size=1, max_size=12),
)
LINES = st.lists(st.one_of(WHOLE, RANDOM, SHORT, CUT, FLIPPED), max_size=12)


@given(LINES)
def test_every_intact_frame_is_found_and_no_other(line):
    decoder = FrameDecoder()
    found = decoder.push(b''.join(data for data, _ in line))
    assert found == [packet for _, packet in line if packet is not None]
    assert decoder.frames == len(found)


@given(LINES, st.lists(st.integers(1, 200), max_size=20))
def test_whole_in_blocks_and_byte_by_byte_agree(line, sizes):
    data = b''.join(data for data, _ in line)
    whole, single, blocks = FrameDecoder(), FrameDecoder(), FrameDecoder()
    expected = whole.push(data)
    assert [
        packet for k in range(len(data)) for packet in single.push(data[k : k + 1])
    ] == expected
    found, start = [], 0
    for size in [*sizes, len(data)]:
        found += blocks.push(data[start : start + size])
        start += size
    assert found == expected
    for name in COUNTERS:
        assert getattr(whole, name) == getattr(single, name) == getattr(blocks, name)


def test_missing_scans_are_counted_over_the_wrap_but_not_over_a_restart():
    decoder = FrameDecoder()
    for seq in (65534, 1, 2, 2, 0):  # 65535 and 0 are missing; then a repeat; then a restart
        decoder.push(packets.encode(packets.Scan(seq, 0, {})))
    assert decoder.lost == 2
    decoder.push(packets.encode(packets.Hello((), 100)) + packets.encode(packets.Scan(9, 0, {})))
    assert decoder.lost == 2
    decoder.restart()
    decoder.push(packets.encode(packets.Scan(50, 0, {})))
    assert decoder.lost == 2


def test_damage_is_counted_by_kind():
    decoder = FrameDecoder()
    decoder.push(b'\x09ab\0')  # the code leads past the end
    decoder.push(b'\x06abcde\0')  # well stuffed, wrong checks
    decoder.push(cobs.encode(crc.seal(b'\x77new')) + b'\0')  # sealed, but of a type to come
    counts = (decoder.cobs_errors, decoder.crc_errors, decoder.unknown, decoder.frames)
    assert counts == (1, 1, 1, 0)


def test_endless_rubbish_takes_no_memory_and_hides_no_frame():
    decoder = FrameDecoder()
    for _ in range(1000):
        assert decoder.push(b'\x55' * 1000) == []
    assert len(decoder._piece) < 1000
    scan = packets.Scan(1, 2, {0: (3, (0, 0, 0, 0, 0, 0))})
    found = [decoder.push(bytes([byte])) for byte in packets.encode(scan)]
    assert found[-1] == [scan]
    assert decoder.cobs_errors == 1
