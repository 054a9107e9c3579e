"""Odometry of a foot around a loop of 100 m with three IMUs, through the whole chain.

`python -m benchmarks.loops` walks twenty, and rough ones with strikes, rolling stances and
g-sensitivity; here are the first clean two of the same seeds, for time.
"""

from loop_trials import moved_while_standing, summary, trial
import pytest

pytestmark = [pytest.mark.slow, pytest.mark.no_cover]

SEEDS = range(2)


def test_the_end_and_the_path_of_a_loop_are_found():
    found = summary([trial(seed, rough=False) for seed in SEEDS])
    # Of the distance walked, rms over the seeds: at the end, and along the path.
    assert found.end <= 0.0025
    assert found.path <= 0.0015


@pytest.mark.parametrize('rough', [False, True])
def test_a_minute_of_standing_after_a_walk_moves_nothing(rough):
    assert moved_while_standing(0, rough=rough) < 1e-3  # [m]
