"""`fusion/health`: what it says of states and noise, and a fault as a program sees it, live."""

from types import SimpleNamespace

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from ros_helpers import imu_message, imu_values, node_process, ros_peer
from sensor_msgs.msg import Imu as ImuMessage
from std_srvs.srv import SetBool
import yaml

from multiimu_ros.fusion.benefit import Benefit
from multiimu_ros.fusion.drift import Disagreement, Gap
from multiimu_ros.fusion.faults import FaultState
from multiimu_ros.nodes.diagnostics import ERROR, OK, STALE, WARN
from multiimu_ros.nodes.health import HealthReport
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.pipeline import ImuHealth

pytestmark = pytest.mark.ros

CALM = Gap(0.0, 1.0, raised=False, rivals=())
BIAS = 'angular rate: bias'
SECOND = 10**9
NAMES = ('imu0', 'imu1', 'imu2')
RATE_SIGMA, FORCE_SIGMA = 1e-3, 1e-2  # of one reading at 100 Hz


class Bench:
    """A report on IMUs whose states the test sets; `noise` is that of every benefit figure."""

    def __init__(self, *states, chi=1.5, noise=(1e-3, 0.01)):
        self._chi = chi
        self.benefit = Benefit(*(scale * np.array(noise) for scale in (1.0, 2.0, 2.5, 0.5)))
        self.streams = [ImuInput(f'imu{k}/data') for k in range(len(states))]
        for stream in self.streams:
            stream.take(1)
        self.become(*states)
        pipeline = SimpleNamespace(health=lambda: self._health, benefit=lambda: self.benefit)
        self.report = HealthReport(pipeline, self.streams)

    def become(self, *states):
        """Set states: that of the guard where it has one, else that of the stream."""
        self._health = [
            ImuHealth(
                f'imu{k}', 'ok' if state in ('suspect', 'readmitted') else state, 200.0, 0.5,
                9, 0, 0, Disagreement(CALM, CALM, CALM),
                FaultState(state, '' if state == 'ok' else BIAS, self._chi, 0.125, 1),
            )
            for k, state in enumerate(states)
        ]  # fmt: skip

    def says(self, stamp_ns=SECOND):
        return self.report.statuses(stamp_ns)


def test_an_array_in_order_says_what_it_gains():
    array, *imus = Bench('ok', 'suspect', 'readmitted').says()
    assert (array.level, array.message) == (OK, '3 of 3 IMUs agree')
    assert array.figures == {
        'imus [-]': 3,
        'imus_in_use [-]': 3,
        'angular_rate_fused_noise [rad/s]': 1e-3,
        'angular_rate_best_single [rad/s]': 2e-3,
        'angular_rate_ideal [rad/s]': 0.5e-3,
        'angular_rate_gain [-]': 2.0,
        'specific_force_fused_noise [m/s^2]': 0.01,
        'specific_force_best_single [m/s^2]': 0.02,
        'specific_force_ideal [m/s^2]': 0.005,
        'specific_force_gain [-]': 2.0,
    }
    assert [imu.figures['state'] for imu in imus] == ['ok', 'suspect', 'readmitted']
    assert [imu.figures['reason'] for imu in imus] == ['', '', BIAS]
    assert [imu.level for imu in imus] == [OK] * 3


@pytest.mark.parametrize(
    ('states', 'level', 'message'),
    [
        (('ok', 'excluded', 'ok'), WARN, f'without imu1: {BIAS}'),
        (('disabled', 'ok', 'stuck'), WARN, 'without imu0: by hand; imu2: readings do not change'),
        (('ambiguous', 'ambiguous'), WARN,
         'imu0 and imu1 contradict each other, and no majority says which is wrong'),
        (('absent', 'invalid'), STALE, 'no IMU is usable'),
    ],
)  # fmt: skip
def test_the_array_names_those_it_does_without_and_why(states, level, message):
    array, *imus = Bench(*states).says()
    assert (array.level, array.message) == (level, message)
    assert len(imus) == len(states)
    used = sum(state in ('ok', 'ambiguous') for state in states)
    assert array.figures['imus_in_use [-]'] == used


def test_where_nothing_can_be_compared_nobody_claims_agreement():
    array, _ = Bench('ok', chi=np.nan).says()
    assert (array.level, array.message) == (OK, '1 of 1 IMUs are in use, and not compared')


def test_an_imu_that_never_came_is_absent_and_stale():
    bench = Bench('ok', 'ok')
    bench.streams[1] = ImuInput('imu1/data')
    bench.report = HealthReport(bench.report._pipeline, bench.streams)
    array, _, never = bench.says()
    assert (never.level, never.figures['state']) == (STALE, 'absent')
    assert never.message == 'nothing came yet on imu1/data'
    assert array.message == 'without imu1: no reading comes'


def test_a_state_lasts_from_its_first_stamp_or_as_the_guard_says():
    bench = Bench('ok', 'ok')
    assert np.isnan(bench.says(0)[1].figures['since [s]'])  # nothing has been fused yet
    assert bench.says(10 * SECOND)[1].figures['since [s]'] == 0.0
    assert bench.says(12 * SECOND)[1].figures['since [s]'] == 2.0
    bench.become('stuck', 'excluded')
    bench.says(13 * SECOND)
    _, stuck, excluded = bench.says(16 * SECOND)
    assert (stuck.figures['since [s]'], stuck.level) == (3.0, ERROR)
    assert excluded.figures['since [s]'] == 0.125
    assert bench.says(5 * SECOND)[1].figures['since [s]'] == 0.0  # time has jumped back


@pytest.fixture
def rig_file(tmp_path):
    imus = [{'name': name, 'frame_id': f'{name}_link'} for name in NAMES]
    path = tmp_path / 'rig.yaml'
    path.write_text(yaml.safe_dump({'version': 1, 'rig': {'name': 'three'}, 'imus': imus}))
    return path


class Board:
    """Three IMUs that lie still and send at 100 Hz by their stamps, faster by the clock."""

    def __init__(self, peer, rng):
        self._peer, self._rng = peer, rng
        self.stamp_ns = 10**18

    def send(self, scans, bias=0.0):
        """Send scans, with a bias on the x rate of the last IMU [rad/s]; return the last stamp."""
        for _ in range(scans):
            self.stamp_ns += SECOND // 100
            for name in NAMES:
                sigmas = [RATE_SIGMA] * 3 + [FORCE_SIGMA] * 3
                values = self._rng.normal([0, 0, 0, 0, 0, 9.80665], sigmas)
                values[0] += bias if name == NAMES[-1] else 0.0
                message = imu_message(f'{name}_link', self.stamp_ns, values)
                self._peer.send(f'{name}/data_registered', message)
            self._peer.spin(0.004)
        return self.stamp_ns


def stamp_of(msg):
    return msg.header.stamp.sec * SECOND + msg.header.stamp.nanosec


def figures(status):
    return {pair.key: pair.value for pair in status.values}


def first_that(reports, begin_ns, state):
    """Return the first report after `begin_ns` in which the last IMU is in this state."""
    return next(
        report
        for report in reports
        if stamp_of(report) >= begin_ns and figures(report.status[-1])['state'] == state
    )


def test_a_bias_is_excluded_named_and_forgiven_without_a_jump(rig_file, rng):
    with node_process('fusion', rig_file=rig_file), ros_peer() as peer:
        reports = peer.collect(DiagnosticArray, 'fusion/health')
        imus = peer.collect(ImuMessage, 'imu/data')
        topics = [f'{name}/data_registered' for name in NAMES]
        peer.wait_for_matches(topics, ['fusion/health', 'imu/data'])
        board = Board(peer, rng)
        begin_ns = board.send(300)
        end_ns = board.send(100, bias=np.deg2rad(5.0))
        board.send(300)
        peer.wait_until(lambda: figures(reports[-1].status[-1])['state'] == 'readmitted')
        peer.call(SetBool, 'fusion/enable_imu2', SetBool.Request(data=False))
        peer.wait_until(lambda: figures(reports[-1].status[-1])['state'] == 'disabled')
        disabled = reports[-1]
        peer.call(SetBool, 'fusion/enable_imu2', SetBool.Request(data=True))
        board.send(100)
        peer.wait_until(lambda: reports[-1].status[0].message == '3 of 3 IMUs agree')
    excluded = first_that(reports, begin_ns, 'excluded')
    array, *_, sick = excluded.status
    # Five times a second would be once in half a second of these stamps.
    assert stamp_of(excluded) - begin_ns <= SECOND // 10
    assert (array.hardware_id, array.name, sick.name) == ('three', 'array', 'imu2')
    assert (array.level, sick.level) == (WARN, ERROR)
    reason = figures(sick)['reason']
    assert reason.startswith('angular rate: ')
    assert array.message == f'without imu2: {reason}'
    assert figures(array)['without'] == 'imu2'
    assert (figures(sick)['exclusions [-]'], float(figures(sick)['weight [-]'])) == ('1', 0.0)
    assert float(figures(sick)['chi_square [-]']) > 40.0
    returned = first_that(reports, end_ns, 'readmitted')
    assert returned.status[0].message == '3 of 3 IMUs agree'
    assert disabled.status[0].message == 'without imu2: by hand'
    # Two IMUs are left at the least.  A third of the 5 deg/s would be 41 of these sigmas.
    sigma = RATE_SIGMA / np.sqrt(2.0)
    rates = np.array([imu_values(imu)[:3] for imu in imus if stamp_of(imu) > begin_ns - SECOND])
    assert len(rates) > 400
    assert np.abs(rates).max() < 5.0 * sigma
