"""Faults come and go as scheduled or commanded, and nonsense is refused with an example."""

import numpy as np
import pytest

from multiimu_ros.errors import ConfigError
from multiimu_ros.simulation.faults import FaultPlan


def test_a_scheduled_fault_holds_from_its_start_up_to_its_stop():
    plan = FaultPlan(8)
    plan.command('dead:3@10-15.5')
    states = [plan.kind_of(3, now) for now in (9.9, 10.0, 15.4, 15.5)]
    assert states == [None, 'dead', 'dead', None]
    assert plan.kind_of(2, 12.0) is None


def test_a_fault_without_times_stays_until_healed():
    plan = FaultPlan(2)
    plan.command('stuck:1\n', now=5.0)
    assert [plan.kind_of(1, now) for now in (4.9, 5.0, np.inf)] == [None, 'stuck', None]
    assert plan.kind_of(1, 1e9) == 'stuck'
    plan.command('heal:1', now=6.0)
    assert plan.kind_of(1, 6.0) is None


def test_healing_leaves_other_imus_the_port_and_the_future_alone():
    plan = FaultPlan(2)
    for text in ('dead:0', 'garbage:1', 'unplug', 'stuck:1@20-30'):
        plan.command(text)
    plan.command('heal:1', now=1.0)
    assert [plan.kind_of(0, 2.0), plan.kind_of(1, 2.0), plan.kind_of(1, 25.0)] == [
        'dead', None, 'stuck',
    ]  # fmt: skip
    assert plan.unplugged(2.0)


def test_the_board_is_unplugged_and_replugged():
    plan = FaultPlan(1)
    plan.command('unplug@1-2')
    plan.command('unplug', now=5.0)
    assert plan.unplugged(6.0)
    plan.command('replug', now=6.0)
    assert [plan.unplugged(now) for now in (0.5, 1.5, 2.5, 7.0)] == [False, True, False, False]


@pytest.mark.parametrize('text', ['', 'dead', 'dead:', 'explode:1', 'unplug:1', 'dead:1@5', 'a b'])
def test_nonsense_is_refused_with_an_example(text):
    with pytest.raises(ConfigError, match='`fault` must look like `dead:3@10-15`'):
        FaultPlan(8).command(text)


def test_unknown_imus_and_odd_times_are_refused():
    with pytest.raises(ConfigError, match='one of the IMUs 0 to 7, got 8'):
        FaultPlan(8).command('dead:8')
    with pytest.raises(ConfigError, match='times in seconds'):
        FaultPlan(8).command('dead:0@1.2.3-4')
