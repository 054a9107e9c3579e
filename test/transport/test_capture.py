"""A capture gives back what was written, and says what is wrong with a file."""

from hypothesis import given, strategies as st
import pytest

from multiimu_ros.errors import TransportError
from multiimu_ros.transport.capture import CaptureWriter, read_capture

BLOCKS = st.lists(st.tuples(st.integers(-(2**63), 2**63 - 1), st.binary(max_size=50)))


@given(blocks=BLOCKS)
def test_blocks_come_back(tmp_path_factory, blocks):
    path = tmp_path_factory.mktemp('capture') / 'session'
    with CaptureWriter(path) as capture:
        for arrival_ns, data in blocks:
            capture.write(arrival_ns, data)
    assert list(read_capture(path)) == blocks


@pytest.mark.parametrize('missing', [1, 5, 14])
def test_a_block_cut_short_is_left_out(tmp_path, missing):
    path = tmp_path / 'session'
    with CaptureWriter(path) as capture:
        capture.write(1, b'whole')
        capture.write(2, b'cut')  # 15 bytes with its head
    path.write_bytes(path.read_bytes()[:-missing])
    assert list(read_capture(path)) == [(1, b'whole')]


def test_wrong_files_are_named(tmp_path):
    with pytest.raises(TransportError, match=r'Cannot read the capture .*absent'):
        list(read_capture(tmp_path / 'absent'))
    (tmp_path / 'text').write_text('something else')
    with pytest.raises(TransportError, match='must be a capture'):
        list(read_capture(tmp_path / 'text'))
    with pytest.raises(TransportError, match='Cannot write the capture'):
        CaptureWriter(tmp_path / 'no' / 'place')
