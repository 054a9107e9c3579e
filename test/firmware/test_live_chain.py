"""The whole chain in real time, from the compiled sketch to the fused IMU."""

from contextlib import suppress
import os

from diagnostic_msgs.msg import DiagnosticArray
from emulated_hub import bmi160s, live_port, script
from live_chain import process, wait_until
import numpy as np
import pytest
from ros_helpers import ros_peer

from multiimu_ros.bags import read_messages
from multiimu_ros.rig import save_rig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate, Timing
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.transport.capture import read_capture
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Scan

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SECONDS, SKEW_PPM = 20.0, 3000.0
SENSOR_HZ = 400  # at which the emulated BMI160s sample, as the sketch sets them
RATE, FORCE = slice(13, 16), slice(25, 28)  # among the doubles of an Imu
TOPICS = [f'/imu{k}/data_raw' for k in range(8)]


def prepare(folder):
    """Write what the sensors feel, one table for each; return the motion and their readings."""
    path = trajectory('hand', SECONDS + 2.0)
    timing = Timing(stagger=0.0, start_ns=0)
    recording = simulate(ring(8), path, SENSOR_HZ, seed=4, timing=timing)
    save_rig(calibrated_rig(recording.rig, 4), folder / 'rig.yaml')
    tables = []
    for k, raw in enumerate(recording.raw):
        values = np.hstack([raw.angular_rate, raw.specific_force])
        table = np.column_stack([raw.stamp_ns / 1e9, values])
        np.savetxt(folder / f'imu{k}.csv', table, '%.9f', ',')
        tables.append(values)
    return path, tables


def play(folder):
    """Run the chain on the emulated board; return its report and the driver's last words."""
    domain = int(os.environ['ROS_DOMAIN_ID'])
    text = script(bmi160s(8), seconds=SECONDS, motion=f'csv {folder}/imu%d.csv', skew_ppm=SKEW_PPM)
    rig = ('--ros-args', '-p', f'rig_file:={folder}/rig.yaml')
    topics = (*TOPICS, '/imu/data', '/odom')
    with ros_peer() as peer, live_port(folder, text) as board:
        heard = peer.collect(DiagnosticArray, '/diagnostics')
        port = ('--ros-args', '-p', f'port:={board.path}', '-p', f'capture_file:={folder}/capture')
        with (
            process('record', '-o', folder / 'bag', *topics, domain=domain),
            process('fusion', *rig, domain=domain),
            process('registration', *rig, domain=domain),
            process('calibration', *rig, domain=domain),
        ):
            wait_until(
                lambda: (
                    peer.node.count_publishers('/imu/data')
                    and peer.node.count_subscribers('/odom')
                ),
                60.0,
                'the graph',
            )
            with process('driver', *port, domain=domain) as driver:
                # Other tests share the processors; a clock is judged by when the driver reads.
                with suppress(PermissionError):
                    os.sched_setscheduler(driver.pid, os.SCHED_RR, os.sched_param(1))
                peer.wait_until(lambda: board.has('end'), SECONDS + 30.0)
                peer.spin(2.5)  # what is on its way arrives, the driver says how it went
                report = board.end()
        said = [s for msg in heard for s in msg.status if s.name == 'driver: board']
    return report, [{pair.key: pair.value for pair in s.values} for s in said]


def numbers(bag, topic):
    """Return stamps [ns], angular rate and specific force of a topic, (N,) and (N, 6)."""
    messages = [message.data for message in read_messages(bag, [topic])]
    stamps = np.array([np.frombuffer(data[4:12], '<i4') for data in messages], np.int64)
    doubles = np.array([np.frombuffer(data[-8 * 37 :], '<f8') for data in messages])
    return stamps @ [10**9, 1], np.hstack([doubles[:, RATE], doubles[:, FORCE]])


@pytest.fixture(scope='module')
def session(tmp_path_factory):
    folder = tmp_path_factory.mktemp('live')
    path, tables = prepare(folder)
    report, driver = play(folder)
    return folder / 'bag', path, tables, report, driver


def test_nothing_is_lost_and_nothing_is_violated(session):
    bag, _, _, report, driver = session
    assert report['violations'] == report['contentions'] == []
    assert report['dropped_bytes'] == report['overrun_bytes'] == 0
    last = driver[-1]
    for figure in (
        'lost scans',
        'crc errors',
        'cobs errors',
        'unknown packets',
        'held back scans',
    ):
        assert last[figure] == '0', figure
    assert last['board overruns'] == last['board bus recoveries'] == '0'
    stamps = [numbers(bag, topic)[0] for topic in TOPICS]
    fused = numbers(bag, '/imu/data')[0]
    # The gyroscopes start in 0.15 s; publishers and subscribers have found each other in 1 s.
    assert all(len(each) > 100 * (SECONDS - 1.5) for each in stamps)
    for each in [*stamps, fused]:
        assert np.diff(each).min() > 0
        assert np.diff(each).max() < 12e6  # one period, and what its stamp may bend


def earliest_late_s(capture, begin_s, end_s):
    """Return how late the most punctual scan of a time was heard, on the emulator's own clock."""
    decoder, speed = FrameDecoder(), 1 + 1e-6 * SKEW_PPM
    scans = (
        (packet.ticks_us / 1e6, arrival_ns / 1e9)
        for arrival_ns, data in read_capture(capture)
        for packet in decoder.push(data)
        if isinstance(packet, Scan)
    )
    return min(heard - ticks / speed for ticks, heard in scans if begin_s < ticks < end_s)


def test_the_skew_is_found_within_10_ppm(session):
    bag, *_, driver = session
    # The board counts 3000 ppm too many.  A host that is too busy to hear even one scan of some
    # seconds in time tilts the line: that much is its own.
    third = SECONDS / 3
    first = earliest_late_s(bag.with_name('capture'), 0.0, third)
    last = earliest_late_s(bag.with_name('capture'), 2 * third, SECONDS)
    busy_ppm = 1e6 * abs(last - first) / third
    found = float(driver[-1]['clock skew [ppm]'])
    assert found == pytest.approx(SKEW_PPM, abs=10 + busy_ppm)


def test_every_published_reading_is_one_of_the_sensors(session):
    bag, _, tables, report, _ = session
    for topic, table in zip(TOPICS, tables, strict=True):
        stamps, values = numbers(bag, topic)
        times = (stamps - report['opened_ns']) / 1e9
        rows = np.floor(times * SENSOR_HZ).astype(int)
        near = rows[:, None] + np.arange(-50, 51)
        gaps = np.abs(table[np.clip(near, 0, len(table) - 1)] - values[:, None]).max(axis=2)
        # Tables have nine digits, scale factors are of single precision.
        assert gaps.min(axis=1).max() < 1e-5
        # Stamps find their way within seconds; then it is the sample of that instant, of 2.5 ms.
        off = near[np.arange(len(near)), gaps.argmin(axis=1)] - rows
        assert np.abs(off[times > 0.5 * SECONDS]).max() <= 1


def test_the_fused_rate_is_the_true_one(session):
    bag, path, _, report, _ = session
    stamps, values = numbers(bag, '/imu/data')
    times = (stamps - report['opened_ns']) / 1e9
    moving = (times > 5.0) & (times < SECONDS - 1.0)
    truth = path.at(times[moving] - 0.5 / SENSOR_HZ).angular_rate_b  # a sample's mean age
    error = values[moving, :3] - truth
    # Ages of 0 to 2.5 ms, at the angular acceleration of a hand; noise is ten times less.
    alpha = np.gradient(truth, times[moving], axis=0)
    assert np.sqrt(np.mean(error**2)) < 1.25e-3 * np.sqrt(np.mean(alpha**2)) + 0.002
