"""Odometry of a foot around loops of 100 m with three IMUs, through the whole chain.

The same loops as those of `python -m benchmarks.loops`: clean ones, and rough ones with strikes,
rolling stances and g-sensitivity.
"""

from loop_trials import informed_trial, moved_while_standing, summary, trial
import pytest

pytestmark = pytest.mark.slow

SEEDS = range(20)


@pytest.mark.long
def test_the_end_and_the_path_of_a_loop_are_found():
    found = summary([trial(seed, rough=False) for seed in SEEDS])
    # Of the distance walked, rms over the seeds: at the end, and along the path.
    assert found.end <= 0.0025
    assert found.path <= 0.0015


@pytest.mark.long
def test_a_filter_that_is_told_of_a_clean_foot_knows_how_well_it_follows():
    found = summary([informed_trial(seed) for seed in SEEDS])
    assert found.end <= 0.0025
    assert found.path <= 0.0015
    assert 0.8 <= found.nees <= 1.25


@pytest.mark.long
def test_a_foot_that_strikes_and_rolls_is_followed_and_the_filter_knows_how_well():
    found = summary([trial(seed, rough=True) for seed in SEEDS])
    assert found.end <= 0.0045
    assert found.path <= 0.0025
    assert 0.8 <= found.nees <= 1.25


@pytest.mark.parametrize('rough', [False, True])
def test_a_minute_of_standing_after_a_walk_moves_nothing(rough):
    assert moved_while_standing(0, rough=rough) < 1e-3  # [m]
