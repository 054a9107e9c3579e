"""What goes wrong on the board: the sketch goes on, counts it, and no false reading gets out."""

from emulated_hub import (
    assert_exact,
    bmi160s,
    BOOT_US,
    changed_sketch,
    FAST,
    is_exact,
    run,
    script,
)
import numpy as np
import pytest

from multiimu_ros.wire import packets
from multiimu_ros.wire.packets import BOOT, HelloRequest, Sync, SyncRequest

BACKENDS = pytest.mark.parametrize('flags', ['', FAST], ids=['wire', 'polled'])
BYTE_S = 10 / 500_000
LATE_US = 40  # by which other interrupts may delay one; Wire's waits for the STOP


def spaces(session, imu):
    """Return (begin, end) of all times without a reading of one IMU, of over two scans [s]."""
    times = np.array([instant for instant, _ in session.of(imu)])
    long = np.flatnonzero(np.diff(times) > 0.025)
    return [(times[k], times[k + 1]) for k in long]


def assert_undamaged(session):
    decoder = session.decoder
    assert (decoder.cobs_errors, decoder.crc_errors, decoder.unknown, decoder.lost) == (0, 0, 0, 0)
    assert session.report['contentions'] == []


@BACKENDS
def test_an_imu_that_dies_and_returns_is_started_again(tmp_path, flags):
    imus = bmi160s(4)
    session = run(tmp_path, script(imus, ['1.0 dead 1', '1.5 alive 1'], seconds=2.5), flags)
    assert_undamaged(session)
    assert session.report['violations'] == []
    assert_exact(session, imus)
    [(begin, end)] = spaces(session, 1)
    assert begin == pytest.approx(1.0, abs=0.011)
    assert 1.6 < end < 2.0  # a reset and a start take 110 ms; it is looked for in turn
    assert not any(spaces(session, k) for k in (0, 2, 3))
    assert session.statuses[-1].imus[1][0] == 3  # then it is looked for, which is no failed read


@BACKENDS
def test_a_bus_that_is_stuck_for_a_second_costs_no_scan(tmp_path, flags):
    imus = bmi160s(8)
    session = run(tmp_path, script(imus, ['1.003 stick 1.0', '2.9 end'], seconds=3), flags)
    assert_undamaged(session)
    assert_exact(session, imus)
    for k in range(8):
        [(begin, end)] = spaces(session, k)
        assert begin == pytest.approx(1.003, abs=0.011)
        assert 2.003 < end < 2.003 + 0.05  # tried every 20 ms; then no IMU needs a new start
    during = session.statuses[-1]
    assert during.recoveries == pytest.approx(49, abs=2)  # of 20 ms each until 2.0 s
    # Scans are read with 100 or 180 Hz; all of them say which IMUs did not answer.
    assert during.imus[0][0] == pytest.approx(100 if not flags else 180, abs=2)
    assert during.overruns == 0


@BACKENDS
def test_no_reading_is_made_of_the_zeros_of_a_stuck_bus(tmp_path, flags):
    imus = bmi160s(8)
    # Steps of 193 us walk through the scan; each time some reading is cut at another byte.
    events = [f'{0.5 + 0.1 * k + 193e-6 * k:.6f} stick 0.03' for k in range(40)]
    session = run(tmp_path, script(imus, events, seconds=4.6), flags)
    assert_undamaged(session)
    assert_exact(session, imus)
    assert session.statuses[-1].recoveries >= 35  # those until the last STATUS


@BACKENDS
def test_a_device_that_missed_clocks_is_clocked_out(tmp_path, flags):
    imus = bmi160s(4)
    session = run(tmp_path, script(imus, ['0.703 wedge 2'], seconds=1.5), flags)
    assert_undamaged(session)
    assert_exact(session, imus)
    assert session.statuses[-1].recoveries == 1
    # All are back with the next scan.
    assert max(np.diff([s.ticks_us for s in session.scans if 2 in s.imus])) < 21_000


def test_what_an_imu_repeats_is_left_out_and_it_is_started_anew(tmp_path):
    imus = bmi160s(2)
    session = run(tmp_path, script(imus, ['1.203 freeze 1'], seconds=2.4))
    assert_undamaged(session)
    assert_exact(session, imus[:1])
    stale = [r for r in session.of(1) if not is_exact(1, 'bmi160', *r)]
    assert len(stale) <= 2  # the one that froze; and once more, which may be an accident of noise
    [(begin, end)] = spaces(session, 1)
    # Fifty scans; then it is looked for in its turn, and starts for 110 ms.
    assert begin == pytest.approx(1.22, abs=0.011)
    assert begin + 0.6 < end < begin + 0.8
    assert session.statuses[-1].imus[1][0] == 49  # one of the fifty passed


def test_what_no_start_can_thaw_stays_left_out(tmp_path):
    session = run(tmp_path, script(bmi160s(2), ['1.203 freeze 1 1'], seconds=3.5))
    assert_undamaged(session)
    assert len([r for r in session.of(1) if r[0] > 1.203]) <= 2


def test_a_multiplexer_that_lost_its_power_is_set_again(tmp_path):
    flags = '-DIMU_PLACES="{3,ANY}"'
    session = run(tmp_path, script([('bmi160', 3, 0x68)], ['1.203 mux'], seconds=1.8), flags)
    assert_undamaged(session)
    assert_exact(session, [('bmi160', 3, 0x68)])
    # The only IMU of a board never changes the channel; one read fails.
    instants = [instant for instant, _ in session.of(0)]
    assert instants[-1] > 1.78
    assert np.diff(instants).max() == pytest.approx(0.02, abs=0.002)


@pytest.mark.parametrize('kind', ['bmi160', 'mpu9250', 'bno055', 'sen0140'])
def test_an_imu_that_lost_its_power_for_a_moment_is_set_up_again(tmp_path, kind):
    address = 0x29 if kind == 'bno055' else 0x68
    imus = [(kind, 0, address), ('bmi160', 1, 0x68)]
    session = run(tmp_path, script(imus, ['1.203 brownout 0'], seconds=3.0, motion='formula'))
    assert_undamaged(session)
    force = session.hellos[-1].imus[0].specific_force_scale
    wrong = [
        instant
        for instant, counts in session.of(0)
        if abs(force * counts[5] - 9.80665) > 0.06  # the noise, and a count of an ADXL345
    ]
    # An MPU measures on, in its smallest range, until its settings are looked at in their turn, an
    # ITG-3200 in one that is not its own; others say zero, or nothing.
    assert len(wrong) <= (9 if kind == 'mpu9250' else 0)  # eight places, one looked at per scan
    assert all(1.2 < instant < 1.3 for instant in wrong)
    assert session.of(0)[-1][0] > 2.97


def test_refused_addresses_are_failed_reads_and_nothing_else(tmp_path):
    imus = bmi160s(2)
    session = run(tmp_path, script(imus, ['0.5 refuse 1 13'], seconds=2.2))
    assert_undamaged(session)
    assert_exact(session, imus)
    scans = [s for s in session.scans if 0.6e6 < s.ticks_us < 2.0e6]
    missed = sum(1 not in s.imus for s in scans)
    assert 10 < missed < 0.2 * len(scans)  # a read has two addresses, the chores take their share
    assert all(0 in s.imus for s in scans)


def test_a_reset_in_mid_stream_begins_anew_with_a_hello(tmp_path):
    imus = bmi160s(2)
    session = run(tmp_path, script(imus, ['1.203 reset'], seconds=2.8))
    assert [hello.reason for hello in session.hellos] == [BOOT, BOOT]
    assert session.decoder.lost == 0
    assert session.decoder.crc_errors + session.decoder.cobs_errors <= 1  # the frame it cut
    numbers = [scan.seq for scan in session.scans]
    begin = numbers.index(0, 1)
    assert numbers == [*range(begin), *range(len(numbers) - begin)]
    assert len(numbers) - begin > 60


def spell(packet):
    return packets.encode(packet).hex(' ')


def test_requests_are_answered_at_the_instant_of_their_last_byte(tmp_path):
    asks = [SyncRequest(0x01020304 + k) for k in range(30)]
    # 30.7 ms apart, so that they come at all phases of a scan.
    events = [f'{0.5 + 0.0307 * k:.4f} send {spell(ask)}' for k, ask in enumerate(asks)]
    session = run(tmp_path, script(bmi160s(8), events, seconds=1.6))
    assert_undamaged(session)
    answers = session.all(Sync)
    assert [answer.token for answer in answers] == [ask.token for ask in asks]
    instants = [0.5 + 0.0307 * k + len(packets.encode(ask)) * BYTE_S for k, ask in enumerate(asks)]
    late = np.array([answer.ticks_us for answer in answers]) - 1e6 * np.array(instants)
    # The board's clock begins a little late; other interrupts delay by some microseconds.
    assert BOOT_US[0] < -late.max() <= -late.min() < BOOT_US[1]
    assert np.ptp(late) < LATE_US


def test_stamps_are_right_while_the_timer_wraps(tmp_path):
    # The 16 bits of the timer wrap every 32.768 ms.  Here last bytes come at that instant, from
    # 80 us before to 80 us after it, so that some interrupts find an overflow that still waits.
    wrap_s, start_s = 0.032768, sum(BOOT_US) / 2e6
    instants = [(30 + k) * wrap_s + start_s + (k - 80) * 1e-6 for k in range(160)]
    asks = [SyncRequest(0x01010101 + k) for k in range(160)]
    events = [
        f'{instant - len(packets.encode(ask)) * BYTE_S:.7f} send {spell(ask)}'
        for instant, ask in zip(instants, asks, strict=True)
    ]
    session = run(tmp_path, script(bmi160s(1), events, seconds=6.4))
    assert_undamaged(session)
    ticks = np.array([answer.ticks_us for answer in session.all(Sync)])
    assert np.ptp(ticks - 1e6 * np.array(instants)) < LATE_US


def test_a_hello_is_sent_when_asked_for_and_only_then(tmp_path):
    ask = spell(HelloRequest())
    damaged = ' '.join([*ask.split()[:-2], '77', '00'])
    events = [f'0.5 send {damaged}', f'0.7 send {ask} {spell(SyncRequest(7))}', f'0.9 send {ask}']
    session = run(tmp_path, script(bmi160s(1), events, seconds=1.2))
    assert_undamaged(session)
    assert [hello.reason for hello in session.hellos] == [0, 1, 1]
    assert session.hellos[0].imus == session.hellos[2].imus
    assert 0.699 < session.hellos[1].ticks_us / 1e6 < 0.72
    assert [answer.token for answer in session.all(Sync)] == [7]


def test_noise_on_the_line_is_no_request(tmp_path):
    rng = np.random.default_rng(3)
    events = [
        f'{0.3 + 0.01 * k:.2f} send {rng.integers(0, 256, 60, dtype=np.uint8).tobytes().hex(" ")}'
        for k in range(100)
    ]
    events.append(f'1.4 send 00 {spell(SyncRequest(9))}')
    session = run(tmp_path, script(bmi160s(2), events, seconds=1.6))
    assert_undamaged(session)
    assert len(session.hellos) == 1
    assert [answer.token for answer in session.all(Sync)] == [9]


def test_the_emulator_tells_what_is_done_wrong(tmp_path):
    both = script([('bmi160', 0, 0x68), ('bmi160', 0, 0x68)], seconds=0.2)
    session = run(tmp_path, both, '-DBUS_CLOCK_HZ=800000')
    assert session.report['contentions'][0]['what'] == 'several answer to 0x68'
    assert session.report['violations'][0]['what'] == 'SCL faster than 400 kHz'


@pytest.mark.parametrize(
    ('table', 'hasty', 'told'),
    [
        ('{0x7E, 0x15, COMMAND, 85}', '{0x7E, 0x15, COMMAND, 70}', 'bmi160: set during a command'),
        ('{0x6B, 0x80, COMMAND, 105}', '{0x6B, 0x80, COMMAND, 90}', 'mpu9250: used within 100 ms'),
        (
            '{0x3D, 0x00, COMMAND, 20}',
            '{0x3D, 0x00, COMMAND, 18}',
            'bno055: used while it changes',
        ),
    ],
)
def test_a_sketch_that_does_not_wait_long_enough_is_told_so(tmp_path, table, hasty, told):
    sketch = changed_sketch(tmp_path, 'models.cpp', table, hasty)
    imus = [('bmi160', 0, 0x68), ('mpu9250', 1, 0x68), ('bno055', 2, 0x29)]
    session = run(tmp_path, script(imus, seconds=1.0), sketch=sketch)
    [violation] = {each['what'] for each in session.report['violations']}
    assert violation.startswith(told)
