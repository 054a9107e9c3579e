"""The walks of the sources: what is printed stays printed, and each rule does what it says."""

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.experiments import foot, zupt
from multiimu_ros.experiments.board import registered
from multiimu_ros.experiments.foot_walk import make_walk, RATE_HZ
from multiimu_ros.simulation.gait import duration_of


@pytest.fixture(scope='module')
def walk():
    return make_walk(3, rough=True, distance=12.0, count=1)


def test_the_distance_of_the_paper_follows_from_each_of_its_rows():
    for metres, percent in foot.PAPER.values():
        # The percentages are rounded to 0.05 of themselves: 0.2 % of 33.5, 1.4 % of 3.6.
        assert 100 * metres / percent == pytest.approx(foot.DISTANCE, rel=0.05 / percent + 0.001)


def test_weights_are_one_over_sigma_of_the_first_rest(rng):
    spread = np.array([1.0, 2.0, 4.0])
    rest = round(foot.ALIGNING * RATE_HZ)
    values = spread[:, np.newaxis] * rng.standard_normal((rest + 1, 3, 6))
    values[-1] = np.array([1.0, 10.0, 100.0])[:, np.newaxis]
    sigma = values[:rest].std(axis=0)
    expected = (values[-1] / sigma).sum(axis=0) / (1 / sigma).sum(axis=0)
    assert_allclose(foot.weighted(values)[-1], expected, rtol=1e-12)
    # (1 + 10 / 2 + 100 / 4) / (1 + 1/2 + 1/4); a sigma from 600 samples is good to 3 %.
    assert_allclose(foot.weighted(values)[-1], 31 / 1.75, rtol=0.15)


def test_equation_14_adds_what_the_axes_are_off():
    times = np.array([0.0, 4.0, 5.0, 6.0])
    found = SimpleNamespace(
        walk=SimpleNamespace(times=times, end=5.0, distance=10.0), truth=np.zeros((4, 3))
    )
    position = np.array([[9.0, 9, 9], [0, 0, 0], [0, 0, 2], [3, -4, 0]])
    printed, end, path = foot.measures(found, position)
    assert printed == pytest.approx(0.7)
    assert end == pytest.approx(0.5)
    assert path == pytest.approx(np.sqrt(2.0) / 10)  # of 0 and 2, while the foot walks


def test_table_1_is_rerun_with_every_sensor_and_fused(monkeypatch):
    monkeypatch.setattr(foot, 'DISTANCE', 8.0)  # 37.6 m are for the experiment itself
    result = foot.run(2, lambda _: None, walks=1)
    for table in result.tables:
        assert [row['sensor'] for row in table.rows] == list(foot.PAPER)
        assert [row['paper [%]'] for row in table.rows] == [33.5, 11.3, 18.6, 3.6]
        if 'error state' in table.title:
            # Whatever the calibration, the filter finds a walk of 8 m to within a tenth of it.
            assert all(row['ours, path [%]'] < 10.0 for row in table.rows)
    assert len(result.pictures) == 3


def test_a_reset_sets_the_velocity_to_zero_and_else_integrates():
    count = 401
    acceleration = np.tile([1.0, 0.0, -0.5], (count, 1))
    still = np.zeros(count, dtype=bool)
    velocity, position = zupt.reset(acceleration, still)
    # 2 s of constant acceleration; the trapezoid of a line is exact, that of v t is, too.
    assert_allclose(velocity[-1], [2.0, 0.0, -1.0], rtol=1e-12)
    assert_allclose(position[-1], [2.0, 0.0, -1.0], rtol=1e-12)
    still[200] = True
    velocity, _ = zupt.reset(acceleration, still)
    assert_allclose(velocity[[200, 201, 400], 0], [0.0, 0.005, 1.0], rtol=1e-12)


def test_flags_that_last_begin_late_and_end_at_once():
    slow = np.zeros(30, dtype=bool)
    slow[3:6] = True
    slow[10:20] = True
    assert np.flatnonzero(zupt.lasting(slow, 4)).tolist() == list(range(13, 20))


def test_the_printed_rule_stops_a_swinging_foot_and_a_lasting_one_does_not(walk):
    values = registered(walk.rig, walk.raw)[:, 0]
    never, printed, lasting, _ = zupt.flags(values)
    speed = np.linalg.norm(walk.trajectory.at(walk.times).velocity_n, axis=1)
    assert not never.any()
    assert speed[printed].max() > 1.0
    assert speed[lasting].max() < 0.3
    # Two fifths of the walk are stance, less the 0.1 s it takes; the rests come on top.
    assert lasting.mean() > 0.3


def test_acceleration_of_a_foot_is_that_of_the_truth(walk):
    values = registered(walk.rig, walk.raw)[:, 0]
    found = zupt.acceleration_n(values)
    truth = walk.trajectory.at(walk.times)
    exact = np.einsum('nij,nj->ni', truth.R_nb, truth.specific_force_b) - [0, 0, 9.80665]
    swinging = np.linalg.norm(exact, axis=1) < 20.0  # strikes outrun the bandwidth
    # Between strikes; their ringing is low-passed, hence the median.
    assert np.median(np.abs(found - exact)[swinging]) < 0.1


def test_updates_hold_a_board_and_harm_a_hand(monkeypatch):
    cases = {
        name: case._replace(duration=duration)
        for (name, case), duration in zip(
            zupt.CASES.items(), (12.0, duration_of(8.0), 12.0), strict=True
        )
    }
    monkeypatch.setattr(zupt, 'CASES', cases)
    result = zupt.run(0, lambda _: None, boards=1)
    table, _, hand = (
        {row['velocity update']: row['ours, end [m]'] for row in one.rows} for one in result.tables
    )
    assert table['rate, as printed'] < 1e-3 < table['no update']
    assert hand['rate, as printed'] > 2 * hand['no update']
    assert len(result.pictures) == 3
