"""A rough walk: strikes, rolling stances, and how little a smooth walk has of them."""

from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.simulation import foot_realism
from multiimu_ros.simulation.foot_realism import BALL, HEIGHT, rolling, strikes
from multiimu_ros.simulation.gait import duration_of, walk
from multiimu_ros.simulation.motion import STANDARD_GRAVITY, Trajectory
from multiimu_ros.simulation.trajectories import trajectory

DURATION = duration_of(30.0)
TIMES = np.arange(4.0, DURATION, 0.0005)
UP = np.array([0.0, 0.0, STANDARD_GRAVITY])
HEEL = np.arange(1.0, 30.0)  # [s] instants of strikes that stand alone
AHEAD = np.zeros(len(HEEL))


@given(duration=st.floats(8.0, 200.0), seed=st.integers(0, 1000))
@settings(max_examples=20)
def test_a_rough_walk_closes_its_loop_and_stands_still_at_its_end(duration, seed):
    path = trajectory('foot_rough', duration, seed)
    end = path.at(np.array([duration]))
    assert end.still[0]
    assert_allclose(end.position_n[0], 0, atol=1e-9)
    assert_allclose(end.R_nb[0], np.eye(3), atol=1e-9)


def test_a_rough_walk_makes_the_strides_of_the_smooth_one():
    smooth, rough = (trajectory(name, DURATION, 3).at(TIMES) for name in ('foot', 'foot_rough'))
    apart = np.abs(rough.position_n - smooth.position_n).max()
    # An approach at 0.9 m/s for some hundredths of a second is 1 to 2 cm; the rest is less.
    assert 0.003 < apart < 0.02


def test_strikes_are_shocks_of_50_to_150_that_last_some_milliseconds(rng):
    path = Trajectory(strikes(HEEL, HEEL + 0.09, AHEAD, rng), 31.0)
    times = HEEL[:, np.newaxis] + np.arange(-0.05, 0.07, 0.0005)
    force = path.at(times.ravel()).specific_force_b
    shock = np.linalg.norm(force - UP, axis=1).reshape(times.shape)
    # 1.5 v / 10 ms for the forward speeds of 0.3 to 0.9 m/s; the sideways ones add at most 6 %.
    assert shock.max(axis=1).min() >= 45.0
    assert shock.max(axis=1).max() <= 145.0
    # The first swing of the ringing is 0.6 of the strike.
    lasting = 0.0005 * (shock > 0.7 * shock.max(axis=1, keepdims=True)).sum(axis=1)
    assert 0.003 < np.median(lasting) < 0.012
    # The accelerometer of a smooth walk never feels more than 3 g.
    smooth = trajectory('foot', DURATION, 3).at(TIMES).specific_force_b
    assert np.linalg.norm(smooth, axis=1).max() < 3 * STANDARD_GRAVITY


def test_imus_feel_a_strike_differently_by_their_lever_arms(rng):
    path = Trajectory(strikes(HEEL, HEEL + 0.09, AHEAD, rng), 31.0)
    motion = path.at(HEEL[0] + np.arange(0.0, 0.01, 0.0005))
    apart = motion.specific_force_at(np.array([0.0, 0.02, 0.0])) - motion.specific_force_b
    # 1.5 * 0.5 rad/s / 10 ms of roll and of yaw, at 2 cm, are 1.5 m/s^2 each.
    assert 0.2 < np.linalg.norm(apart, axis=1).max() < 4.0


def test_a_stance_rolls_by_some_degrees_at_some_centimetres_per_second(rng):
    path = Trajectory(rolling(HEEL, HEEL + 0.48, AHEAD, rng), 31.0)
    motion = path.at((HEEL[:, np.newaxis] + np.linspace(0.0, 0.48, 49)).ravel())
    speed = np.linalg.norm(motion.velocity_n, axis=1).reshape(len(HEEL), -1)
    middle = speed[:, 12:37]  # without the first and the last quarter
    # Peruzzi et al.: the least velocity of a point of the foot is 1 cm/s on average.
    assert 0.003 < middle.min(axis=1).mean() < 0.011
    assert 0.008 < middle.mean() < 0.02
    pitch = -np.arcsin(motion.R_nb[:, 2, 0]).reshape(len(HEEL), -1)
    assert np.rad2deg(np.ptp(pitch, axis=1)).min() > 2.0
    assert np.rad2deg(np.ptp(pitch, axis=1)).max() < 4.0
    assert np.linalg.norm(motion.position_n, axis=1).max() < 0.01


def test_a_foot_rolls_about_the_ball(rng, monkeypatch):
    for name in ('SIDE_ROLL', 'PIVOT', 'SINK', 'SHEAR'):
        monkeypatch.setattr(foot_realism, name, 0.0)
    heading = np.full(len(HEEL), 0.7)
    path = Trajectory(rolling(HEEL, HEEL + 0.48, heading, rng), 31.0)
    motion = path.at((HEEL[:, np.newaxis] + np.linspace(0.0, 0.48, 49)).ravel())
    # Position turns by 0.7 rad; pitch is about the foot's own axis, which the walk's yaw turns.
    c, s = np.cos(0.7), np.sin(0.7)
    ahead = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    ball = motion.position_n @ ahead + motion.R_nb @ [BALL, 0.0, -HEIGHT]
    # Keyframes are exact; the quintics in between follow the circle to some micrometres.
    assert np.ptp(ball, axis=0).max() < 2e-5
    assert np.ptp(motion.position_n, axis=0).max() > 3e-3


def test_a_smooth_walk_stands_still_in_every_stance(rng):
    motion = Trajectory(walk(DURATION, 4.0, rng), DURATION).at(TIMES)
    walking = TIMES < 4.0 + 24 * 1.2
    assert motion.still[walking].mean() == pytest.approx(0.4, abs=0.05)
    rough = Trajectory(walk(DURATION, 4.0, rng, rough=True), DURATION).at(TIMES)
    assert not rough.still[walking].any()
