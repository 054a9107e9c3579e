"""Dead reckoning on the ring: exact on perfect readings, and what a missing arm costs."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.experiments import ring, static, turntable
from multiimu_ros.experiments.board import fuse, part_of, record, registered
from multiimu_ros.simulation.errors import PERFECT
from multiimu_ros.simulation.placements import ring as placed_ring


@pytest.fixture(scope='module')
def perfect():
    motion = turntable.half_turns()
    rig = placed_ring(8)
    raw = record(rig, motion, ring.RATE_HZ, [PERFECT] * 8, np.random.default_rng(0))
    return motion, rig, registered(rig, raw)


def position(perfect, group, *, arms):
    motion, rig, values = perfect
    some = ring.chosen(group)
    fused = fuse(part_of(rig, some), values[:, some], ring.RATE_HZ, arms=arms)
    return ring.reckon(fused, motion).position_n


def test_opposite_arms_cancel_and_others_report_the_way_of_their_midpoint(perfect):
    # Perfect sensors at 100 Hz: what is left is the quadrature of the ramps.
    assert np.abs(position(perfect, (1, 5), arms=False)).max() < 1e-3
    # Half a turn takes the midpoint of neighbours, at 8 cm cos(22.5 deg), to the far side.
    way = np.linalg.norm(position(perfect, (1, 2), arms=False), axis=1).max()
    assert way == pytest.approx(2 * 0.08 * np.cos(np.pi / 8), rel=0.02)


def test_with_the_arm_taken_out_one_imu_knows_that_the_centre_stays(perfect):
    assert np.abs(position(perfect, (3,), arms=True)).max() < 2e-3


def test_stillness_must_last():
    rate = np.full((200, 3), 1.0)
    rate[20:35] = 0.0  # 0.15 s, as in mid-turn
    rate[100:140] = 0.0
    assert np.flatnonzero(ring.is_still(rate)).tolist() == list(range(100, 140))


def test_a_reset_velocity_leaves_half_a_dt_squared_for_every_step():
    acceleration = np.full((101, 3), 0.02)
    velocity, place = ring.integrate(acceleration, np.ones(101, dtype=bool))
    assert not velocity.any()
    assert_allclose(place[-1], 100 * 0.02 / 2 / ring.RATE_HZ**2, rtol=1e-12)


def test_table_91_keeps_the_print_and_eight_imus_win():
    result = static.run(1, lambda _: None, boards=1, duration=12.0)
    rows = result.tables[0].rows
    printed = [list(row.values())[2:] for row in rows if row['whose'] == 'paper']
    assert printed[0] == [0.0509, 0.0430, 0.0339, 0.0258]
    assert len(rows) == 24
    for row in rows:
        assert row['8 IMUs'] < row['1 IMU']


def test_table_92_shows_that_arms_matter_only_where_they_are_left_in():
    result = turntable.run(1, lambda _: None, boards=1)
    left, out = (
        {row['fused']: list(row.values())[column] for row in result.tables[1].rows}
        for column in (1, 2)
    )
    assert left['1&2'] > 14.0  # the way of the midpoint is 14.8 cm
    assert out['1&2'] < 8.0
    assert left['1&5'] == pytest.approx(out['1&5'], rel=0.02)  # balanced: no arm to take out


def test_fours_of_couples_are_balanced_with_the_arms_left_in(perfect):
    # The guard, were it on, would find three of the four to contradict the others.
    for four in turntable.FOURS:
        assert np.abs(position(perfect, four, arms=False)).max() < 1e-3
