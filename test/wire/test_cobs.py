"""Stuffing against the examples of the paper, and as a round trip."""

from hypothesis import given, strategies as st
import pytest

from multiimu_ros.wire import cobs, crc


@given(st.binary(max_size=1100))
def test_decoding_undoes_encoding_without_a_zero(payload):
    coded = cobs.encode(payload)
    assert 0 not in coded
    assert cobs.decode(coded) == payload


@pytest.mark.parametrize(
    ('payload', 'coded'),
    [
        (b'', b'\x01'),
        (b'\0', b'\x01\x01'),
        (b'\0\0', b'\x01\x01\x01'),
        (b'\x11\0\x22', b'\x02\x11\x02\x22'),
        (b'\x45\0\0\x2c\x4c', b'\x02\x45\x01\x03\x2c\x4c'),  # Cheshire and Baker, figure 2
        (b'x' * 255, b'\xff' + b'x' * 254 + b'\x02x'),
    ],
)
def test_known_stuffings(payload, coded):
    assert cobs.encode(payload) == coded
    assert cobs.decode(coded) == payload


@given(st.binary(min_size=254, max_size=254).filter(lambda block: 0 not in block))
def test_a_full_last_block_may_go_without_its_empty_code(block):
    assert cobs.decode(b'\xff' + block) == block


@pytest.mark.parametrize('coded', [b'\x03a', b'\xff' + b'x' * 253, b'\x02a\x00'])
def test_codes_that_lead_past_the_end_are_refused(coded):
    assert cobs.decode(coded) is None


def test_the_crc_is_ccitt_false():
    # Check value of the catalogue of parametrised CRC algorithms for CRC-16/IBM-3740: 0x29B1.
    sealed = crc.seal(b'')
    assert crc.binascii.crc_hqx(b'123456789', 0xFFFF) == 0x29B1
    assert sealed[:2] == b'\0\0'  # Adler-32 of nothing is 0x00000001


def test_the_sum_sees_what_the_crc_cannot():
    sealed = bytearray(crc.seal(b'0123456789'))
    for k, bits in enumerate((0x01, 0x10, 0x21)):  # 0x11021, the polynomial: its CRC is nothing
        sealed[2 + k] ^= bits
    assert crc.binascii.crc_hqx(bytes(sealed[:-2]), 0xFFFF).to_bytes(2, 'little') == sealed[-2:]
    assert not crc.is_sealed(bytes(sealed))


def test_a_block_shorter_than_its_checks_is_not_sealed():
    assert not crc.is_sealed(crc.seal(b''))


@given(st.binary(min_size=1, max_size=300), st.data())
def test_up_to_three_flipped_bits_are_always_seen(payload, data):
    block = bytearray(crc.seal(payload))
    bits = st.integers(0, 8 * len(block) - 1)
    for bit in data.draw(st.sets(bits, min_size=1, max_size=3)):
        block[bit // 8] ^= 1 << bit % 8
    assert crc.is_sealed(crc.seal(payload))
    assert not crc.is_sealed(bytes(block))
