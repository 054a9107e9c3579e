"""The emulated board on a real pseudo-terminal: what comes out is the recording, in real time."""

from contextlib import contextmanager
import os
import select
import threading
import time

import numpy as np
import pytest

from multiimu_ros.errors import TransportError
from multiimu_ros.simulation import placements
from multiimu_ros.simulation.board import EmulatedBoard
from multiimu_ros.simulation.device import counts_of, EmulatedDevice
from multiimu_ros.simulation.faults import FaultPlan
from multiimu_ros.simulation.recording import simulate, Timing
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.simulation.virtual_port import VirtualPort
from multiimu_ros.wire import packets
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Hello, Scan, Sync

PATIENCE = 10.0  # [s] before a test gives up


def recording_of(duration, rate):
    timing = Timing(start_ns=0, stagger=0.0001)
    return simulate(placements.ring(8), trajectory('static', duration), rate, timing=timing)


@contextmanager
def running(recording, link, *faults):
    """Run a board in a thread; yield the host times at which the motion began."""
    plan, starts, stop = FaultPlan(8), [], threading.Event()
    for fault in faults:
        plan.command(fault)
    port = VirtualPort(link)
    board = EmulatedBoard(EmulatedDevice(recording, plan), port, plan, starts.append)

    def run():
        while not (stop.is_set() or board.finished):
            board.step()

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield starts
    finally:
        stop.set()
        thread.join()
        port.unplug()


def read_some(file):
    """Read what is there; nothing means that the port is gone, before or during the reading."""
    try:
        return os.read(file, 65536)
    except OSError:
        return b''


def read_until(file, decoder, enough):
    """Collect packets until there are enough, or the port is gone."""
    sent, end = [], time.monotonic() + PATIENCE
    while not enough(sent):
        assert time.monotonic() < end, f'only {len(sent)} packets came'
        if not select.select([file], [], [], 0.5)[0]:
            continue  # a dead board must fail a test, not hang it
        data = read_some(file)
        if not data:
            break
        sent += decoder.push(data)
    return sent


def scans_in(sent):
    return [packet for packet in sent if isinstance(packet, Scan)]


def test_eight_imus_at_1000_hz_decode_to_exactly_the_counts_of_the_recording(tmp_path):
    recording, decoder = recording_of(1.0, 1000.0), FrameDecoder()
    with running(recording, tmp_path / 'board'):
        file = os.open(tmp_path / 'board', os.O_RDWR | os.O_NOCTTY)
        began = time.monotonic()
        sent = read_until(file, decoder, lambda p: scans_in(p) and scans_in(p)[-1].seq > 900)
        took = time.monotonic() - began
        os.close(file)
    assert isinstance(sent[0], Hello)
    scans = scans_in(sent)
    read = np.array([[scan.imus[k][1] for k in range(8)] for scan in scans])
    # The first scans fell into the moment that the board took to boot.
    first = next(k for k in range(1000) if np.array_equal(counts_of(recording)[k], read[0]))
    assert np.array_equal(read, counts_of(recording)[first : first + len(read)])
    assert (decoder.crc_errors, decoder.lost) == (0, 0)
    # Real time: 900 scans take 0.9 s; a busy machine may add to it.
    assert 0.85 < took < 3.0


def test_the_start_is_told_on_the_host_clock_and_sync_agrees_with_it(tmp_path):
    with running(recording_of(5.0, 100.0), tmp_path / 'board') as starts:
        before = time.time_ns()
        file = os.open(tmp_path / 'board', os.O_RDWR | os.O_NOCTTY)
        decoder = FrameDecoder()
        (hello, *_) = read_until(file, decoder, bool)
        os.write(file, packets.encode(packets.SyncRequest(3)))
        sent = read_until(file, decoder, lambda p: any(isinstance(x, Sync) for x in p))
        after = time.time_ns()
        os.close(file)
    (start_ns,) = starts
    (sync,) = (packet for packet in sent if isinstance(packet, Sync))
    assert before <= start_ns <= after
    # The device booted a little after time 0 and answered before now.
    assert 0 <= sync.ticks_us - hello.ticks_us <= (after - start_ns) / 1000


def test_unplugging_ends_the_readers_file_and_replugging_boots_under_the_same_path(tmp_path):
    link = tmp_path / 'board'
    with running(recording_of(30.0, 100.0), link, 'unplug@0.3-0.5') as starts:
        file = os.open(link, os.O_RDWR | os.O_NOCTTY)
        first = scans_in(read_until(file, FrameDecoder(), lambda _: False))
        os.close(file)
        end = time.monotonic() + PATIENCE
        while not link.exists():
            assert time.monotonic() < end
            time.sleep(0.01)
        file = os.open(link, os.O_RDWR | os.O_NOCTTY)
        again = read_until(file, FrameDecoder(), lambda p: len(p) > 5)
        os.close(file)
    assert 10 <= len(first) <= 30  # 0.3 s at 100 Hz
    assert (again[0].reason, scans_in(again)[0].seq) == (packets.BOOT, 0)
    assert len(starts) == 1


def test_a_reader_that_stalls_loses_bytes_and_they_are_counted(tmp_path):
    port = VirtualPort(tmp_path / 'board')
    file = os.open(port.path, os.O_RDWR | os.O_NOCTTY)
    port.make_raw()
    for _ in range(100):
        port.write(b'x' * 1000)
    received = len(os.read(file, 200_000))
    os.close(file)
    # A terminal holds 4 kB and its driver some more; nothing blocks, the rest is gone.
    assert 0 < received <= 100_000 - port.lost_bytes < 50_000
    port.unplug()
    port.unplug()  # pulled twice is pulled once
    port.make_raw()
    assert (port.read(), port.opened()) == (b'', False)


def test_a_port_without_a_link_has_the_path_of_its_terminal():
    port = VirtualPort()
    assert port.path.startswith('/dev/pts/')
    port.plug()  # it is in already
    port.unplug()


def test_a_link_never_replaces_a_file(tmp_path):
    (tmp_path / 'notes').write_text('mine')
    with pytest.raises(TransportError, match='must not be a file that exists'):
        VirtualPort(tmp_path / 'notes')
    with pytest.raises(TransportError, match='Cannot make the link'):
        VirtualPort(tmp_path / 'nowhere' / 'board')
    assert (tmp_path / 'notes').read_text() == 'mine'
