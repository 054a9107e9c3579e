"""Stances, strides and sums of walks whose figures are known."""

from dataclasses import replace

from made_up_walks import made, STANCE, stepping, SWING, waved
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.report.walk_summary import (
    find_stances,
    position_sigma,
    strides,
    summarise,
    worst_horizontal,
)


def test_every_stance_is_found_where_it_was():
    stances = find_stances(stepping(strides=8, length=1.25))
    assert_allclose(stances.place[:, 0], 1.25 * np.arange(9), atol=1e-12)


def test_strides_have_their_length_and_time_but_for_the_rests():
    walk = stepping(strides=8, length=1.25)
    length, time = strides(walk, find_stances(walk))
    assert_allclose(length, 1.25)
    assert np.isnan(time[[0, -1]]).all()  # before the first and after the last the foot rests
    assert_allclose(time[1:-1], STANCE + SWING, atol=0.01)  # one frame


def test_stairs_count_along_the_slope():
    summary = summarise(stepping(length=0.8, rise=0.6), foot=True)
    assert_allclose(summary.stride_length, 1.0)  # a 3-4-5 triangle


def test_a_detector_that_drops_out_makes_no_stance():
    walk = stepping()
    still = walk.still.copy()
    still[::7] = False
    flickering = find_stances(replace(walk, still=still))
    assert len(flickering) == len(find_stances(walk))


def test_a_foot_that_looks_still_in_mid_swing_does_not_stand():
    walk = stepping(strides=1)
    still = walk.still.copy()
    fastest = int(np.argmax(walk.velocity_n[:, 0]))
    still[fastest - 3 : fastest + 4] = True  # 70 ms
    assert len(find_stances(replace(walk, still=still))) == 2


def test_a_walk_in_figures():
    walk = stepping(strides=8, length=1.25)
    summary = summarise(walk, foot=True)
    assert_allclose(summary.duration, (len(walk) - 1) / 100)
    assert_allclose(summary.distance, 10.0)
    assert_allclose(summary.from_start, [10.0, 0.0, 0.0], atol=1e-12)
    assert_allclose(summary.position_sigma, [0.4, 0.1])  # of y, which is the worse, and of z
    assert summary.stances == 9
    assert (summary.gaps, summary.longest_gap) == (0, 0.0)


def test_the_way_around_a_corner_is_no_short_cut():
    walk = stepping(strides=8, length=1.25)
    bent = walk.position_n.copy()
    after = bent[:, 0] > 5.0
    bent[after] = np.column_stack([0 * bent[:, 0] + 5.0, bent[:, 0] - 5.0, bent[:, 2]])[after]
    summary = summarise(replace(walk, position_n=bent), foot=True)
    assert_allclose(summary.distance, 10.0)
    assert_allclose(summary.from_start, [5.0, 5.0, 0.0], atol=1e-12)


def test_a_hand_has_a_path_and_no_stances():
    walk = waved()
    summary = summarise(walk, foot=False)
    steps = np.linalg.norm(np.diff(walk.position_n, axis=0), axis=1)
    assert_allclose(summary.distance, steps.sum())
    assert summary.stances == 0
    assert np.isnan([summary.stride_length, summary.stride_time]).all()


@pytest.mark.parametrize('foot', [True, False])
def test_a_rig_that_never_rests_has_a_distance(foot):
    summary = summarise(waved(rests=False), foot=foot)
    assert summary.still_share == 0.0
    assert summary.distance > 1.0


def test_the_worst_direction_is_found_whatever_the_axes():
    turn = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    P = turn @ np.diag([9.0, 1.0, 100.0]) @ turn.T
    assert_allclose(worst_horizontal(P[np.newaxis]), [3.0])


def test_rounding_below_zero_is_no_sigma():
    walk = made(np.zeros((2, 3)), np.ones(2, bool), position_covariance=np.full((2, 3, 3), -1e-20))
    assert_allclose(position_sigma(walk), 0.0)
