"""Every named motion obeys mechanics: integrated, its rate and force lead back to its pose."""

from itertools import accumulate

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import ConfigError
from multiimu_ros.simulation import gait
from multiimu_ros.simulation.motion import STANDARD_GRAVITY
from multiimu_ros.simulation.trajectories import make_motion, MOTIONS, trajectory

UP = np.array([0.0, 0.0, STANDARD_GRAVITY])


def exp(turns):
    return Rotation.from_rotvec(turns).as_matrix()


def integrate(motion, step):
    """Dead-reckon rate and force, sampled at half steps; fourth order (Magnus, Simpson)."""
    w0, wm, w1 = (motion.angular_rate_b[k : len(motion.time) - 2 + k : 2] for k in range(3))
    turns = step / 6 * (w0 + 4 * wm + w1) + step**2 / 12 * np.cross(w0, w1)
    R = np.array(list(accumulate(exp(turns), np.matmul, initial=motion.R_nb[0])))
    # The attitude at half a step, for Simpson: from the start of the step, by the half turn.
    middle = R[:-1] @ exp(step / 24 * (5 * w0 + 8 * wm - w1))
    force = motion.specific_force_b
    a0 = np.einsum('nij,nj->ni', R[:-1], force[:-2:2]) - UP
    am = np.einsum('nij,nj->ni', middle, force[1:-1:2]) - UP
    a1 = np.einsum('nij,nj->ni', R[1:], force[2::2]) - UP
    velocity = np.vstack((motion.velocity_n[:1], step / 6 * (a0 + 4 * am + a1))).cumsum(axis=0)
    moves = step * velocity[:-1] + step**2 / 6 * (a0 + 2 * am)
    position = np.vstack((motion.position_n[:1], moves)).cumsum(axis=0)
    return R, position


@pytest.mark.parametrize(
    ('name', 'step'),
    # The jerk of a foot jumps by some 1e4 rad/s^3 at keyframes, which costs any method its order.
    [('static', 0.01), ('turntable', 0.01), ('slider', 0.01), ('hand', 0.002), ('foot', 0.0005)],
)
def test_integrated_rate_and_force_reproduce_the_pose_within_a_millimetre(name, step):
    times = np.arange(round(2 * 60.0 / step) + 1) * step / 2
    motion = trajectory(name, 60.0, seed=5).at(times)
    R, position = integrate(motion, step)
    assert_allclose(position, motion.position_n[::2], atol=1e-3)
    # Tilt is tested by the position (1e-7 rad make 1.8 mm in a minute), yaw by this.
    assert_allclose(R, motion.R_nb[::2], atol=1e-6)


@pytest.mark.parametrize('name', MOTIONS)
def test_rates_are_the_derivatives_of_the_pose(name):
    h = 1e-5
    times = np.linspace(0.5, 29.5, 301)
    path = trajectory(name, 30.0, seed=2)
    before, now, after = (path.at(times + k * h) for k in (-1, 0, 1))
    turned = np.einsum('nji,njk->nik', before.R_nb, after.R_nb) / (4 * h)
    turned -= turned.transpose(0, 2, 1)
    rate = np.column_stack((turned[:, 2, 1], turned[:, 0, 2], turned[:, 1, 0]))
    velocity = (after.position_n - before.position_n) / (2 * h)
    angular = (after.angular_rate_b - before.angular_rate_b) / (2 * h)
    # Central differences: h^2 / 6 of third derivatives up to 1e5, and rounding 1e-16 / h.
    assert_allclose(now.angular_rate_b, rate, atol=1e-5)
    assert_allclose(now.velocity_n, velocity, atol=1e-5)
    # Jerk jumps at keyframes, by up to 1e4 rad/s^3.
    assert_allclose(now.angular_acceleration_b, angular, atol=0.2)


def test_at_rest_with_z_up_the_force_is_plus_g():
    motion = make_motion('hand', 2.0, 100.0)
    assert motion.still.all()
    assert_allclose(motion.specific_force_b, np.tile(UP, (200, 1)), rtol=1e-12)


@given(seed=st.integers(0, 1000), arm=st.tuples(*[st.floats(-0.2, 0.2)] * 3))
def test_lever_arm_force_is_that_of_the_point_itself(seed, arm):
    h = 1e-4
    times = np.linspace(5.0, 7.0, 21)
    path = trajectory('hand', 10.0, seed=seed)
    before, now, after = (path.at(times + k * h) for k in (-1, 0, 1))
    point = [m.position_n + m.R_nb @ np.array(arm) for m in (before, now, after)]
    acceleration = (point[0] - 2 * point[1] + point[2]) / h**2
    felt = np.einsum('nji,nj->ni', now.R_nb, acceleration + UP)
    # Second differences: h^2 / 12 of a fourth derivative up to 1e6, and rounding 1e-16 / h^2.
    assert_allclose(now.specific_force_at(np.array(arm)), felt, atol=2e-2)


@pytest.mark.parametrize('name', MOTIONS)
def test_every_motion_stands_still_first_and_last_and_nowhere_while_it_moves(name):
    motion = make_motion(name, 40.0, 200.0, seed=3)
    assert motion.still[motion.time < 4.0].all()
    assert motion.still[-1]
    speed = np.linalg.norm(np.hstack((motion.velocity_n, motion.angular_rate_b)), axis=1)
    assert speed[motion.still].max() == 0.0
    # Only the first and last sample of a move may be slow without being still.
    assert np.count_nonzero((speed < 1e-6) & ~motion.still) < 0.01 * len(speed)


def test_the_hand_moves_as_hands_do():
    motion = make_motion('hand', 120.0, 200.0, seed=1)
    rate = motion.angular_rate_b[~motion.still]
    # The range of the brief: about 3 rad/s rms, decimetres; a rest of 1.5 s and more each 8 s.
    assert 2.0 < np.sqrt(np.square(rate).sum(axis=1).mean()) < 4.0
    assert 0.2 < np.ptp(motion.position_n, axis=0).max() < 1.5
    assert 0.1 < motion.still.mean() < 0.4


def test_the_turntable_turns_half_a_turn_and_back_about_z_only():
    motion = make_motion('turntable', 30.0, 100.0)
    assert_allclose(motion.angular_rate_b[:, :2], 0, atol=1e-12)
    assert_allclose(motion.R_nb[motion.time == 7.5][0], np.diag([-1, -1, 1]), atol=1e-9)
    assert_allclose(motion.R_nb[motion.time == 11.5][0], np.eye(3), atol=1e-9)


def test_the_slider_slides_and_turns_in_four_phases():
    motion = make_motion('slider', 12.0, 100.0)
    rests = [motion.position_n[motion.time == t, 0][0] for t in (5.75, 7.75, 9.75, 11.75)]
    assert_allclose(rests, [0.5, 0.5, 0, 0], atol=1e-9)


@given(duration=st.floats(8.0, 300.0), seed=st.integers(0, 1000))
def test_the_walk_closes_its_loop_in_time(duration, seed):
    path = trajectory('foot', duration, seed)
    end = path.at(np.array([duration]))
    assert end.still[0]
    assert_allclose(end.position_n[0], 0, atol=1e-9)
    assert_allclose(end.R_nb[0], np.eye(3), atol=1e-9)


@given(half=st.integers(2, 200))
def test_strides_around_the_loop_add_up_to_zero(half):
    heading = gait.headings(2 * half)
    assert len(heading) == 2 * half
    assert_allclose([np.cos(heading).sum(), np.sin(heading).sum()], 0, atol=1e-9)


def test_a_walk_is_as_long_as_asked_and_swings_like_a_foot():
    motion = make_motion('foot', gait.duration_of(100.0), 200.0, seed=4)
    walked = np.abs(np.diff(motion.position_n[:, :2], axis=0))
    assert 100.0 <= np.hypot(*walked.T).sum() < 106.0
    # A swing is several rad/s; a stance lasts 0.4 of a stride, and the rests come on top.
    assert 5.0 < np.abs(motion.angular_rate_b[:, 1]).max() < 10.0
    assert 0.4 < motion.still.mean() < 0.55


def test_a_walk_too_short_for_a_loop_is_standing():
    assert make_motion('foot', 6.0, 100.0).still.all()


def test_a_motion_is_the_same_for_the_same_seed_only():
    one, same, other = (make_motion('hand', 10.0, 50.0, seed=s) for s in (1, 1, 2))
    assert np.array_equal(one.specific_force_b, same.specific_force_b)
    assert not np.array_equal(one.specific_force_b, other.specific_force_b)


def test_unknown_motions_and_durations_are_refused():
    with pytest.raises(ConfigError, match='`motion` must be one of static, turntable'):
        trajectory('swim', 10.0)
    with pytest.raises(ConfigError, match='`duration` must be a positive'):
        trajectory('hand', float('nan'))
