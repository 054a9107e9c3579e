"""One protocol, two programs: the sketch's packets are those of `multiimu_ros.wire`."""

from pathlib import Path
import subprocess
import zlib

from emulated_hub import bmi160s, FIRMWARE, require, run, script
import numpy as np
import pytest

from multiimu_ros.wire import cobs, crc, packets
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Hello, HelloRequest, Scan, Status, Sync, SyncRequest

GOLDEN = Path(__file__).with_name('golden.hex')
LONGEST = 12 + 8 * 16  # a HELLO of eight IMUs


@pytest.fixture(scope='module')
def twin(tmp_path_factory):
    """Return a function that hands lines to the sketch's packet.cpp, built for this machine."""
    require('g++', packages='g++')
    program = tmp_path_factory.mktemp('twin') / 'frames'
    sources = [Path(__file__).with_name('frames.cpp'), FIRMWARE / 'imu_hub' / 'packet.cpp']
    flags = ['-std=c++11', '-Wall', '-Wextra', '-Werror', '-fsanitize=undefined,address']
    subprocess.run(
        ['g++', *flags, '-Wno-unknown-pragmas', f'-I{FIRMWARE}/imu_hub', *sources, '-o', program],
        check=True,
    )

    def ask(sign, texts):
        lines = ''.join(f'{sign} {text.hex()}\n' for text in texts)
        said = subprocess.run([program], input=lines, text=True, check=True, capture_output=True)
        return [bytes.fromhex(line) for line in said.stdout.split('\n')[:-1]]

    return ask


def random_packets(rng):
    """Return packets of all lengths; half of them mostly zeros, and some all 255."""
    for length in range(1, LONGEST + 1):
        for share in (0.0, 0.7):
            packet = rng.integers(0, 256, length)
            packet[rng.random(length) < share] = 0
            yield packet.astype(np.uint8).tobytes()
        yield b'\xff' * length
    # Sums between 65521 and 65535 are rare, and need the last subtraction.
    many = (rng.integers(0, 256, 60, dtype=np.uint8).tobytes() for _ in range(40_000))
    yield from (packet for packet in many if zlib.adler32(packet) >> 16 < 15)


def test_frames_are_the_same(twin, rng):
    sent = list(random_packets(rng))
    assert twin('+', sent) == [cobs.encode(crc.seal(packet)) + b'\0' for packet in sent]


def test_requests_are_understood(twin):
    requests = [HelloRequest(), *(SyncRequest(token) for token in (0, 1, 255, 256, 2**32 - 1))]
    frames = [packets.encode(request)[:-1] for request in requests]
    found = twin('-', frames)
    assert [packets.decode(payload) for payload in found] == requests


def test_damaged_requests_are_not(twin):
    frame = packets.encode(SyncRequest(0x00FF1200))[:-1]
    damaged = [
        frame[:k] + bytes([frame[k] ^ 1 << bit]) + frame[k + 1 :]
        for k in range(len(frame))
        for bit in range(8)
    ]
    cut = [frame[:k] for k in range(1, len(frame))] + [frame[k:] for k in range(1, len(frame))]
    longer = [frame + b'\x01', b'\x01' + frame]
    assert set(twin('-', damaged + cut + longer)) == {b''}


def frames_of(data):
    return [frame + b'\0' for frame in data.split(b'\0')[:-1]]


def session(folder):
    """Return what the compiled sketch says in 1.2 s: each kind of packet."""
    asks = [HelloRequest(), SyncRequest(0x00C0FFEE)]
    spelled = ' '.join(packets.encode(ask).hex(' ') for ask in asks)
    imus = [*bmi160s(1), ('sen0140', 3, 0x68)]
    return run(folder, script(imus, [f'1.0 send {spelled}', '1.1 dead 0'], seconds=1.2)).data


def without_times(data):
    """Return the packets, with everything that says when left out."""
    for packet in FrameDecoder().push(data):
        match packet:
            case Hello():
                yield packet.imus, packet.rate_hz, packet.reason, packet.firmware, packet.protocol
            case Scan(seq, _, imus):
                yield seq, sorted(imus)
            case Status(_, overruns, recoveries, imus):
                yield overruns, recoveries, imus
            case Sync(token, _):
                yield token


def test_the_compiled_sketch_speaks_our_protocol_to_the_byte(tmp_path):
    data = session(tmp_path)
    decoder = FrameDecoder()
    found = decoder.push(data)
    assert {type(packet) for packet in found} == {Hello, Scan, Status, Sync}
    # Decoded and encoded again, nothing has changed: no byte has a meaning that we do not know.
    assert [packets.encode(packet) for packet in found] == frames_of(data)


def test_the_golden_bytes_are_read():
    data = bytes.fromhex(GOLDEN.read_text())
    found = FrameDecoder().push(data)
    assert {type(packet) for packet in found} == {Hello, Scan, Status, Sync}
    assert [packets.encode(packet) for packet in found] == frames_of(data)


def test_the_golden_bytes_are_those_of_the_compiled_sketch(tmp_path):
    # Another compiler, or a faster sketch, may say it some microseconds earlier.  After a change
    # of what is said: `PYTHONPATH=test python test/firmware/test_packet_twin.py`.
    golden = bytes.fromhex(GOLDEN.read_text())
    assert list(without_times(session(tmp_path))) == list(without_times(golden))


def _write_golden():
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        frames = frames_of(session(Path(folder)))
    GOLDEN.write_text('\n'.join(frame.hex() for frame in frames) + '\n')


if __name__ == '__main__':
    _write_golden()
