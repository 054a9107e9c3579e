"""Scripted sessions of the compiled sketch: every scan comes, and says what the sensors held."""

from emulated_hub import assert_clean, assert_exact, bmi160s, FAST, run, script
import numpy as np
import pytest

from multiimu_ros.wire.packets import ASKED, BOOT, MODELS

SECONDS = 2.0
# All eight places have a BMI160 that measures: reset 20 ms, gyroscope 85 ms, looking for them.
ALL_READY_S = 0.2
SOME_EMPTY_S = 0.95  # where a place stays empty, the sketch waits 0.9 s for a BNO055
MIXED = [
    ('bmi160', 0, 0x68),
    ('mpu9250', 1, 0x68),
    ('bno055', 2, 0x29),
    ('sen0140', 3, 0x68),
    ('mpu9255', 4, 0x69),
]


def intervals_us(session):
    return np.diff([scan.ticks_us for scan in session.scans])


def assert_complete(session, count, rate_hz):
    assert all(sorted(scan.imus) == list(range(count)) for scan in session.scans)
    begin_s = ALL_READY_S if count == 8 else SOME_EMPTY_S
    assert session.scans[0].ticks_us < 1e6 * begin_s
    assert len(session.scans) >= (SECONDS - begin_s) * rate_hz - 2  # the last is on the line
    assert np.mean(intervals_us(session)) == pytest.approx(1e6 / rate_hz, rel=1e-3)


@pytest.mark.parametrize('count', [1, 2, 4, 8])
def test_every_scan_at_100_hz_is_exact(tmp_path, count):
    imus = bmi160s(count)
    session = run(tmp_path, script(imus, seconds=SECONDS))
    assert_clean(session)
    assert_exact(session, imus)
    assert_complete(session, count, 100)
    # Whatever comes in between delays a scan by less than it may take.
    assert np.abs(intervals_us(session) - 10_000).max() < 600


def test_the_fast_backend_reads_eight_at_180_hz(tmp_path):
    imus = bmi160s(8)
    session = run(tmp_path, script(imus, seconds=SECONDS), FAST)
    assert_clean(session)
    assert_exact(session, imus)
    assert_complete(session, 8, 180)


@pytest.mark.parametrize('flags', ['', FAST.replace('180', '100')], ids=['wire', 'polled'])
def test_all_types_work_side_by_side(tmp_path, flags):
    session = run(tmp_path, script(MIXED, seconds=SECONDS), flags)
    assert_clean(session)
    assert_exact(session, MIXED)
    assert_complete(session, len(MIXED), 100)
    first, last = session.hellos[0], session.hellos[-1]
    assert (first.reason, last.reason) == (BOOT, ASKED)
    assert [MODELS[info.model] for info in last.imus] == [
        'BMI160',
        'MPU-9250',
        'BNO055',
        'SEN0140',
        'MPU-9250',
    ]
    assert [(info.channel, info.address) for info in last.imus] == [place[1:] for place in MIXED]


def test_at_rest_with_z_up_the_specific_force_is_plus_one_g(tmp_path):
    session = run(tmp_path, script(MIXED, seconds=SECONDS, motion='formula'))
    for info in session.hellos[-1].imus:
        counts = np.array([counts for _, counts in session.of(info.imu)])
        force = info.specific_force_scale * counts[:, 3:]
        rate = info.angular_rate_scale * counts[:, :3]
        # The formula's noise is evenly spread to 0.03 m/s^2; half a count of an ADXL345 is 0.02.
        np.testing.assert_allclose(force, force * 0 + [0, 0, 9.80665], atol=0.051)
        # It swings about z by 1 rad/s at 1 Hz.
        assert np.abs(rate[:, :2]).max() < 0.012
        assert 0.97 < np.abs(rate[:, 2]).max() < 1.02
    temperatures = [celsius for _, celsius in session.statuses[-1].imus.values()]
    np.testing.assert_allclose(temperatures, 26.0, atol=0.01)  # the last digit of STATUS


def test_two_on_one_channel_are_told_apart_by_their_addresses(tmp_path):
    flags = '-DIMU_PLACES="{3,0x68},{3,0x69}"'
    imus = [('bmi160', 3, 0x68), ('bmi160', 3, 0x69)]
    session = run(tmp_path, script(imus, seconds=SECONDS), flags)
    assert_clean(session)
    assert_exact(session, imus)
    assert len(session.scans) > 170  # no place is empty, so the first comes soon
    assert all(sorted(scan.imus) == [0, 1] for scan in session.scans)


def test_one_that_is_plugged_in_later_is_announced(tmp_path):
    events = ['0 dead 1', '1.1 alive 1']
    session = run(tmp_path, script(bmi160s(2), events, seconds=SECONDS))
    assert_clean(session)
    assert [[info.imu for info in hello.imus] for hello in session.hellos] == [[0], [0, 1]]
    begin_s = session.of(1)[0][0]
    assert session.hellos[-1].ticks_us / 1e6 < begin_s < 1.6


def test_the_same_script_gives_the_same_bytes(tmp_path):
    text = script(MIXED, ['1.0 send 03 11 22 00', '1.1 dead 0'], seconds=1.3)
    assert run(tmp_path, text).data == run(tmp_path, text).data


@pytest.mark.parametrize('flags', ['', FAST], ids=['wire', 'polled'])
def test_every_scan_is_on_the_line_with_the_same_delay(tmp_path, flags):
    events = ['1.0 dead 1', '1.2 dead 2', '1.4 stick 0.3']
    session = run(tmp_path, script(bmi160s(8), events, seconds=2.0), flags)
    counts = np.array([len(scan.imus) for scan in session.scans])
    delays = np.array(session.delays_us())
    earliest = [delays[counts == count].min() for count in (0, 6, 7, 8)]
    # The host's clock follows the earliest arrivals: what is sooner there bends it.
    assert np.ptp(earliest) < 200
    # A HELLO or a STATUS before it, or another scan, holds one back.
    assert np.percentile(delays, 90) < min(earliest) + 600


def test_a_stuck_bus_does_not_delay_the_scans_after_it(tmp_path):
    session = run(tmp_path, script(bmi160s(1), ['1.203 stick 0.1'], seconds=1.8))
    delays = np.array(session.delays_us())
    instants = np.array([scan.ticks_us for scan in session.scans])
    before, after = delays[instants < 1.2e6], delays[instants > 1.4e6]
    assert after.min() == pytest.approx(before.min(), abs=100)  # of 1.6 ms; the bus had 3 ms more


def test_what_is_too_fast_for_so_many_is_counted_on_both_sides(tmp_path):
    imus = bmi160s(8)
    session = run(tmp_path, script(imus, seconds=2.2), '-DSCAN_RATE_HZ=200')
    assert session.report['violations'] == session.report['contentions'] == []
    decoder = session.decoder
    assert (decoder.cobs_errors, decoder.crc_errors, decoder.unknown) == (0, 0, 0)
    assert_exact(session, imus)
    # Wire reads eight IMUs 145 times a second; what is left out is known to both.
    seen = [scan.seq for scan in session.scans if scan.ticks_us < session.statuses[-1].ticks_us]
    missing = seen[-1] + 1 - len(seen)
    assert 0.1 * len(seen) < missing < 0.5 * len(seen)
    assert session.statuses[-1].overruns == pytest.approx(missing, abs=2)
    assert intervals_us(session).max() < 16_000  # never more than two in a row
