"""Packets come back as they were, and what is not quite a packet is refused."""

from dataclasses import replace
import math

from hypothesis import given, strategies as st
import pytest

from multiimu_ros.wire import cobs, crc, packets

INT16 = st.integers(-(2**15), 2**15 - 1)
UINT8, UINT16, UINT32 = (st.integers(0, 2**bits - 1) for bits in (8, 16, 32))
FLOAT32 = st.floats(width=32, min_value=2**-20, max_value=1.0)
SCANS = st.builds(
    packets.Scan,
    UINT16,
    UINT32,
    st.dictionaries(st.integers(0, 15), st.tuples(UINT16, st.tuples(*[INT16] * 6))),
)
INFO = st.builds(
    packets.ImuInfo, st.just(0), UINT8, UINT8, UINT8, UINT16, UINT16, FLOAT32, FLOAT32
)
HELLOS = st.builds(
    lambda infos, **rest: packets.Hello(
        tuple(replace(info, imu=k) for k, info in enumerate(infos)), **rest
    ),
    st.lists(INFO, max_size=16),
    rate_hz=UINT16,
    ticks_us=UINT32,
    reason=st.sampled_from([packets.BOOT, packets.ASKED]),
    firmware=st.tuples(UINT8, UINT8),
    protocol=UINT8,
)
CELSIUS = st.integers(-32767, 32767).map(lambda centi: centi / 100.0)
STATUSES = st.builds(
    packets.Status,
    UINT32,
    UINT16,
    UINT16,
    st.dictionaries(st.integers(0, 15), st.tuples(UINT16, CELSIUS)),
)
PACKETS = st.one_of(
    SCANS,
    HELLOS,
    STATUSES,
    st.builds(packets.Sync, UINT32, UINT32),
    st.builds(packets.SyncRequest, UINT32),
    st.just(packets.HelloRequest()),
)


def payload(packet):
    return cobs.decode(packets.encode(packet)[:-1])[: -crc.SIZE]


@given(PACKETS)
def test_a_packet_comes_back(packet):
    frame = packets.encode(packet)
    assert frame.count(b'\0') == 1
    assert frame[-1] == 0
    assert packets.decode(payload(packet)) == packet


@given(PACKETS, st.integers(1, 20))
def test_a_packet_with_bytes_missing_or_added_is_refused(packet, count):
    whole = payload(packet)
    longer = packets.decode(whole + b'\x07' * count)
    shorter = packets.decode(whole[:-count])
    assert longer is None
    assert shorter is None


def test_a_scan_of_eight_looks_as_the_document_says():
    counts = (1, 2, 3, 4, 5, -1)
    scan = packets.Scan(0x0201, 0x06050403, {0: (0x0807, counts), 7: (1, counts)})
    body = bytes([7, 8, 1, 0, 2, 0, 3, 0, 4, 0, 5, 0, 255, 255])
    assert payload(scan) == bytes([2, 1, 2, 3, 4, 5, 6, 0b10000001]) + body + b'\1\0' + body[2:]
    whole = packets.Scan(0, 0, dict.fromkeys(range(8), (0, counts)))
    assert len(packets.encode(whole)) == 126  # 120 of packet, 4 of checks, 1 of stuffing, the zero


def test_an_unknown_temperature_stays_unknown():
    back = packets.decode(payload(packets.Status(0, imus={2: (7, math.nan)})))
    assert back.imus[2][0] == 7
    assert math.isnan(back.imus[2][1])


@pytest.mark.parametrize(
    'spoil',
    [
        {'imu': 16},
        {'angular_rate_scale': 0.0},
        {'specific_force_scale': math.inf},
        {'angular_rate_scale': math.nan},
    ],
)
def test_a_hello_that_makes_no_sense_is_refused(spoil):
    info = packets.ImuInfo(0, 1, 0x69, 0, 2000, 16, 0.5, 0.5)
    good = packets.Hello((info,), 100)
    assert packets.decode(payload(good)) == good
    assert packets.decode(payload(packets.Hello((replace(info, **spoil),), 100))) is None
    assert packets.decode(payload(packets.Hello((info, info), 100))) is None
    assert packets.decode(payload(replace(good, reason=2))) is None


def test_a_wide_scan_that_could_be_a_narrow_one_is_refused():
    wide = payload(packets.Scan(0, 0, {8: (0, (0,) * 6)}))
    assert packets.decode(wide) is not None
    assert packets.decode(wide[:7] + b'\x01\x00' + wide[9:]) is None


def test_nothing_and_unknown_types_are_refused():
    assert packets.decode(b'') is None
    assert packets.decode(b'\x77abc') is None


def test_what_does_not_fit_is_named():
    with pytest.raises(ValueError, match='`packet` must have fields that fit the wire'):
        packets.encode(packets.SyncRequest(2**32))
    with pytest.raises(ValueError, match=r'indices in 0-15, got \[16\]'):
        packets.encode(packets.Scan(0, 0, {16: (0, (0,) * 6)}))
