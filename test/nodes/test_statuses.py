"""What the fusion node says of an IMU that disagrees, and what wins over it."""

from types import SimpleNamespace

from diagnostics_page import told
import numpy as np
import pytest

from multiimu_ros.fusion.benefit import Benefit
from multiimu_ros.fusion.drift import Disagreement, Gap
from multiimu_ros.fusion.faults import FaultState
from multiimu_ros.nodes.diagnostics import ERROR, OK, WARN
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.nodes.statuses import FusionReport
from multiimu_ros.pipeline import ImuHealth

pytestmark = pytest.mark.ros

CALM = Gap(1e-4, 1e-3, raised=False, rivals=())


def statuses(*imus):
    """Return the statuses of fusion and of IMUs, each a state and gaps that are not calm."""
    health, streams = [], []
    for k, (state, gaps) in enumerate(imus):
        gap = Disagreement(**{'rate': CALM, 'force': CALM, 'turn': CALM} | gaps)
        fault = FaultState(state, 'angular rate: bias', 99.0, 0.1, 1)
        stream = 'ok' if state in ('suspect', 'readmitted') else state
        health.append(ImuHealth(f'imu{k}', stream, 200.0, 0.5, 9, 0, 0, gap, fault))
        streams.append(ImuInput(f'imu{k}/data'))
        streams[k].take(1)
    benefit = Benefit(*(np.array([1e-3, 0.01]) for _ in Benefit._fields))
    pipeline = SimpleNamespace(
        health=lambda: health, benefit=lambda: benefit, frames=9, empty_scans=0, time_jumps=0
    )
    return FusionReport(pipeline, streams).statuses(0)


def test_one_is_named_with_all_that_it_is_off_by():
    rate = Gap(0.0054105, 0.00067, raised=True, rivals=())  # 0.31 deg/s
    turn = Gap(0.012, 0.001, raised=True, rivals=())
    fusion, sick, *_ = statuses(('ok', {'rate': rate, 'turn': turn}), ('ok', {}), ('ok', {}))
    assert sick.level == WARN
    assert sick.message == (
        'recalibrate imu0: its rate is off by 0.31 deg/s, 8 sigma; '
        'its rate in a turn is off by 1.2 %, 12 sigma'
    )
    assert sick.figures['rate beside the others [deg/s]'] == pytest.approx(0.31, rel=1e-3)
    assert (fusion.level, fusion.message) == (OK, 'ok')


def test_the_page_tells_of_every_figure():
    fusion, imu = statuses(('ok', {}))
    assert told('fusion: fusion') == sorted(fusion.figures)
    assert told('fusion: imu<k>') == sorted(imu.figures)


def test_of_two_both_are_named_and_neither_is_left_out():
    pair = [Gap(0.05, 0.005, raised=True, rivals=(1 - k,)) for k in range(2)]
    fusion, *imus = statuses(*(('ok', {'force': gap}) for gap in pair))
    for status in imus:
        assert status.message == (
            'recalibrate imu0 and imu1: their forces differ by 0.05 m/s^2, 10 sigma; '
            'of two nobody can say which is wrong'
        )
    assert (fusion.level, fusion.message) == (OK, 'ok')


@pytest.mark.parametrize(('state', 'level'), [('stuck', ERROR), ('disabled', WARN)])
def test_a_fault_wins_over_a_drift(state, level):
    gap = Gap(0.05, 0.005, raised=True, rivals=())
    fusion, sick, _ = statuses((state, {'force': gap}), ('ok', {}))
    assert (sick.level, sick.message) == (level, state)
    assert fusion.message == 'without imu0'


def test_one_that_the_others_contradict_is_left_out_and_the_reason_told():
    fusion, sick, *_ = statuses(('excluded', {}), ('ok', {}), ('ok', {}))
    assert sick.level == ERROR
    assert sick.message == 'excluded, for the others contradict its angular rate: bias'
    assert sick.figures['exclusions'] == 1
    assert fusion.message == 'without imu0'
    assert fusion.figures['noise of force, fused noise [mm/s^2]'] == pytest.approx(10.0)


def test_two_that_contradict_each_other_warn_and_stay():
    fusion, *imus = statuses(('ambiguous', {}), ('ambiguous', {}))
    for status in imus:
        assert status.level == WARN
        assert 'no majority agrees' in status.message
    assert fusion.level == WARN
    assert fusion.message == (
        'imu0 and imu1 contradict each other, and no majority says which is wrong'
    )


def test_one_that_came_back_is_made_use_of_and_its_past_told():
    fusion, sick, suspect = statuses(('readmitted', {}), ('suspect', {}))
    assert (sick.level, fusion.message) == (OK, 'ok')
    assert (
        sick.message
        == 'ok; readmitted, for the others no longer contradict its angular rate: bias'
    )
    assert (suspect.level, suspect.message) == (OK, 'ok')  # noise makes some all the time
