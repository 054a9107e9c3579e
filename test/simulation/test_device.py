"""The emulated board sends exactly the recording, with a clock and faults of its own."""

import numpy as np
import pytest

from multiimu_ros.simulation import placements
from multiimu_ros.simulation.device import counts_of, EmulatedDevice
from multiimu_ros.simulation.errors import BMI160, PERFECT
from multiimu_ros.simulation.faults import FaultPlan
from multiimu_ros.simulation.recording import simulate, Timing
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.wire import packets
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Hello, Scan, Status, Sync

TIMING = Timing(start_ns=0)
RECORDING = simulate(placements.row(3), trajectory('hand', 8.5), 100.0, timing=TIMING)


def device(*faults, recording=RECORDING, **options):
    plan = FaultPlan(len(recording.raw))
    for fault in faults:
        plan.command(fault)
    return EmulatedDevice(recording, plan, **options)


def scans(board, until=100.0):
    """Return the scans that are due until then, decoded as a driver would."""
    sent = FrameDecoder().push(b''.join(board.frames(until)))
    return [packet for packet in sent if isinstance(packet, Scan)]


def counts(sent, imu):
    return np.array([scan.imus[imu][1] for scan in sent])


def test_the_scans_hold_exactly_the_counts_of_the_recording():
    board = device()
    sent = scans(board)
    assert board.finished
    assert [scan.seq for scan in sent] == list(range(850))
    for imu in range(3):
        assert np.array_equal(counts(sent, imu), counts_of(RECORDING)[:, imu])


def test_counts_times_the_scales_of_hello_are_the_recording():
    (hello,) = FrameDecoder().push(device().hello(0.0))
    scale = np.repeat([hello.imus[0].angular_rate_scale, hello.imus[0].specific_force_scale], 3)
    values = counts(scans(device()), 0) * scale
    samples = RECORDING.raw[0]
    # HELLO carries the scales in single precision: 6e-8 relative.
    np.testing.assert_allclose(
        values, np.hstack((samples.angular_rate, samples.specific_force)), rtol=1e-7
    )


def test_hello_says_who_is_there():
    (hello,) = FrameDecoder().push(device().hello(0.0))
    assert (hello.rate_hz, hello.reason, len(hello.imus)) == (100, packets.BOOT, 3)
    assert packets.MODELS[hello.imus[0].model] == 'BMI160'
    ranges = hello.imus[0].angular_rate_range, hello.imus[0].specific_force_range
    # BST-BMI160-DS000: 16.4 LSB/(deg/s) reach 1998 deg/s in 16 bits, 4096 LSB/g reach 8 g.
    assert ranges == (1998, 8)


def test_a_frame_goes_out_when_its_last_imu_has_been_read_and_not_before():
    board = device()
    due = 2 * 0.0004 + 0.0004  # [s] two staggers and the last read
    assert board.next_due() == pytest.approx(due)
    assert scans(board, due - 1e-6) == []
    assert len(scans(board, due + 1e-6)) == 1


def test_the_device_clock_is_fast_and_stamps_each_imu():
    sent = scans(device(skew_ppm=5000))
    # 1 s is 1.005 s; 0.4 ms are 402 us.
    assert sent[100].ticks_us - sent[0].ticks_us == 1_005_000
    assert [sent[0].imus[k][0] for k in range(3)] == [0, 402, 804]


def test_the_device_clock_wraps_after_32_bits():
    assert device().ticks(2**32 / 1e6 + 1.0) == 1_000_000


def test_boot_starts_clock_and_sequence_anew_but_not_the_motion():
    board = device()
    before = scans(board, 2.0)
    board.boot(3.0)
    after = scans(board, 4.0)
    assert (before[-1].seq, after[0].seq, after[0].ticks_us) == (199, 0, 0)
    assert after[0].imus[0][1] == tuple(counts_of(RECORDING)[300, 0])


def test_requests_are_answered_with_the_device_time():
    board = device(skew_ppm=1000)
    request = packets.encode(packets.SyncRequest(7)) + packets.encode(packets.HelloRequest())
    sync, hello = FrameDecoder().push(b'noise\0' + board.answer(b'?' + b'\0' + request, 2.0))[-2:]
    assert sync == Sync(7, 2_002_000)
    assert isinstance(hello, Hello)
    assert (hello.reason, hello.ticks_us) == (packets.ASKED, 2_002_000)


def test_a_dead_imu_is_missing_and_counted_in_the_status():
    board = device('dead:1@1-2')
    sent = FrameDecoder().push(b''.join(board.frames(3.5)))
    missing = [p.seq for p in sent if isinstance(p, Scan) and 1 not in p.imus]
    # The IMU is read 0.4 ms after the scan begins, so the first of its missing samples is 100.
    assert missing == list(range(100, 200))
    statuses = [p for p in sent if isinstance(p, Status)]
    assert statuses[-1].imus[1][0] == 100
    assert statuses[-1].imus[0] == (0, pytest.approx(26.0))


def test_a_stuck_imu_repeats_its_reading_and_then_recovers():
    rows = counts(scans(device('stuck:2@4.5-6', 'stuck:2@7-8')), 2)
    true = counts_of(RECORDING)[:, 2]
    assert np.all(rows[450:600] == true[450])
    assert np.array_equal(rows[600:700], true[600:700])
    assert np.all(rows[700:800] == true[700])  # the second time it holds another reading


def test_garbage_fills_the_16_bits():
    rows = counts(scans(device('garbage:0@4-6')), 0)
    assert np.abs(rows[400:600]).max() > 30000
    assert np.array_equal(rows[:400], counts_of(RECORDING)[:400, 0])


def test_a_share_of_the_readings_fails():
    sent = scans(device(dropout=0.1))
    present = np.mean([len(scan.imus) / 3 for scan in sent])
    # 2400 draws: standard error 0.6 %, times 4.
    assert abs(present - 0.9) < 0.025


def test_recordings_that_no_board_could_send_are_refused():
    path = trajectory('static', 1.0)
    with pytest.raises(ValueError, match='must be of IMUs with steps, got perfect'):
        device(recording=simulate(placements.row(1), path, 100.0, PERFECT))
    lossy = simulate(
        placements.row(3), path, 1000.0, BMI160, timing=Timing(start_ns=0, dropout=0.2)
    )
    with pytest.raises(ValueError, match='must have no dropouts'):
        device(recording=lossy)
