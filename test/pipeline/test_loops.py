"""Odometry of a foot around a loop of 100 m with three IMUs, through the whole chain.

`python -m benchmarks.loops` walks twenty, and rough ones with strikes, rolling stances and
g-sensitivity; here are the first clean two and rough four of the same seeds, for time.
"""

from loop_trials import moved_while_standing, summary, trial
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.no_cover]

CLEAN_SEEDS, ROUGH_SEEDS = range(2), range(4)


def test_the_end_and_the_path_of_a_loop_are_found():
    found = summary([trial(seed, rough=False) for seed in CLEAN_SEEDS])
    # Of the distance walked, rms over the seeds: at the end, and along the path.
    assert found.end <= 0.0025
    assert found.path <= 0.0015


def test_a_foot_that_strikes_and_rolls_is_followed_and_the_filter_knows_how_well():
    found = summary([trial(seed, rough=True) for seed in ROUGH_SEEDS])
    assert found.end <= 0.0045
    assert found.path <= 0.0025
    assert 0.8 <= found.nees <= 1.25


@pytest.mark.parametrize('rough', [False, True])
def test_a_minute_of_standing_after_a_walk_moves_nothing(rough):
    assert moved_while_standing(0, rough=rough) < 1e-3  # [m]
