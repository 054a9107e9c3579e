"""The page of C++ for people with another board: what it sends is read as any board's."""

from pathlib import Path
import subprocess

from emulated_hub import require
import numpy as np
import pytest

from multiimu_ros.wire import packets
from multiimu_ros.wire.board import Board
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Hello, HelloRequest, Scan, Status, Sync, SyncRequest

HERE = Path(__file__).parent
EXAMPLE = HERE.parents[1] / 'examples' / 'own_board'
SECONDS, RATE = 2.0, 200
START_US = 4_294_000_000  # as in own_board.cpp


@pytest.fixture(scope='module')
def said(tmp_path_factory):
    """Return what the example says within two seconds, asked for a HELLO and the time."""
    require('g++', packages='g++')
    folder = tmp_path_factory.mktemp('own_board')
    (folder / 'Wire.h').touch()
    flags = ['-std=c++11', '-Wall', '-Wextra', '-Werror', '-fsanitize=undefined,address']
    command = ['g++', *flags, f'-I{folder}', f'-I{EXAMPLE}', HERE / 'own_board.cpp']
    subprocess.run([*command, '-o', folder / 'own_board'], check=True)
    asks = packets.encode(HelloRequest()) + b'\x07noise\x00' + packets.encode(SyncRequest(2**24))
    return subprocess.run(
        [folder / 'own_board'], input=asks, check=True, stdout=subprocess.PIPE
    ).stdout


def test_its_packets_are_ours_to_the_byte(said):
    found = FrameDecoder().push(said)
    assert b''.join(packets.encode(packet) for packet in found) == said
    assert {type(packet) for packet in found} == {Hello, Scan, Status, Sync}
    assert [p.reason for p in found if isinstance(p, Hello)] == [packets.BOOT, packets.ASKED]
    assert [p.token for p in found if isinstance(p, Sync)] == [2**24]


def test_nothing_is_lost_and_a_failed_reading_is_left_out(said):
    decoder = FrameDecoder()
    scans = [packet for packet in decoder.push(said) if isinstance(packet, Scan)]
    assert decoder.lost == 0
    assert len(scans) == pytest.approx(SECONDS * RATE, abs=2)
    assert [scan.seq for scan in scans if not scan.imus] == [100]
    for scan in scans:
        first = 100 * scan.seq - 20000
        words = [first + k for k in (4, 5, 6, 0, 1, 2)]
        assert not scan.imus or scan.imus[0] == (0, tuple(words))


def test_its_samples_are_in_si_units_and_its_clock_may_wrap(said):
    board = Board()
    decoder, samples, arrival_ns = FrameDecoder(), [], 10**18
    for frame in said.split(b'\0')[:-1]:
        for scan in decoder.push(frame + b'\0'):
            if isinstance(scan, Scan):  # it comes a millisecond after its instant
                arrival_ns = 10**18 + 1000 * ((scan.ticks_us - START_US) % 2**32 + 1000)
        samples += board.push(frame + b'\0', arrival_ns)
    assert len(samples) >= SECONDS * RATE - 4
    values = np.array([sample.values for sample in samples])
    # Word 4 of reading 0 is -19996 counts of 1 / 16.4 deg/s; word 0 is -20000 of 1 / 4096 g.
    assert values[0, 0] == pytest.approx(np.deg2rad(-19996 / 16.4), rel=1e-6)
    assert values[0, 3] == pytest.approx(-20000 * 9.80665 / 4096, rel=1e-6)
    # The ticks wrap after one second; the reading that failed leaves one gap.
    steps = np.diff([sample.stamp_ns for sample in samples])
    assert board.clock.epochs == 1
    assert np.sort(steps)[-2:] == pytest.approx([5e6, 10e6], rel=0.1)
