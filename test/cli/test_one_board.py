"""IMUs of one body are grouped at any mounting and delay, strangers are not."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.pose_tracker import PoseTracker
from multiimu_ros.cli.one_board import closeness, compare, group_boards, shared_share
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory


def followed(samples):
    tracker = PoseTracker()
    tracker.push(samples)
    return tracker.view()


def recorded(motion, imus, seed=0):
    raw = simulate(ring(imus), trajectory(motion, 60.0, seed), 100.0, seed=seed).raw
    return list(raw)


def late(samples, seconds):
    shift_ns = round(1e9 * seconds)
    return ImuSamples(samples.stamp_ns + shift_ns, samples.angular_rate, samples.specific_force)


def turned(samples, rotation):
    return ImuSamples(
        samples.stamp_ns,
        rotation.apply(samples.angular_rate),
        rotation.apply(samples.specific_force),
    )


@pytest.fixture(scope='module')
def hands():
    """Return two boards in two hands: of three and of two IMUs."""
    return recorded('hand', 3), recorded('hand', 2, seed=5)


def grouped(parts):
    boards = group_boards({f'imu{k}': followed(part) for k, part in enumerate(parts)})
    return [board.topics for board in boards]


def test_two_boards_are_told_apart_and_the_larger_comes_first(hands):
    assert grouped([*hands[1], *hands[0]]) == [['imu2', 'imu3', 'imu4'], ['imu0', 'imu1']]


@pytest.mark.parametrize('seconds', [-1.7, 0.05, 1.7])
def test_a_clock_that_is_off_by_less_than_two_seconds_does_not_part_a_board(hands, seconds):
    first, second, third = hands[0]
    assert grouped([first, late(second, seconds), third]) == [['imu0', 'imu1', 'imu2']]


def test_a_mounting_does_not_part_a_board(hands):
    other = turned(hands[0][1], Rotation.from_euler('xyz', [100.0, 20.0, -50.0], degrees=True))
    assert closeness(followed(hands[0][0]), followed(other)) > 0.99  # only noise and bias differ


def test_the_same_schedule_in_other_hands_is_another_board():
    parts = [recorded('calibration', 1)[0], recorded('calibration', 1, seed=4)[0]]
    assert len(grouped(parts)) == 2


def test_recordings_of_different_times_are_different_boards(hands):
    assert grouped([hands[0][0], late(hands[0][1], 100.0)]) == [['imu0'], ['imu1']]


def test_imus_that_never_turn_count_as_one_board():
    assert grouped(recorded('static', 2)) == [['imu0', 'imu1']]


def test_one_that_lies_on_the_table_is_no_part_of_the_board_that_moves(hands):
    assert grouped([*hands[0], recorded('static', 1)[0]]) == [['imu0', 'imu1', 'imu2'], ['imu3']]


def test_what_is_missing_of_a_recording_counts_neither_way(hands):
    since = (hands[0][1].stamp_ns - hands[0][1].stamp_ns[0]) / 1e9
    holed = hands[0][1].select((since < 20.0) | (since > 40.0))
    one, other = followed(hands[0][0]), followed(holed)
    assert closeness(one, other) > 0.99  # as without the hole
    assert shared_share([one, other], other) == pytest.approx(2 / 3, abs=0.01)  # 20 of 60 s
    assert shared_share([one, other], one) == 1.0


def test_less_than_ten_seconds_are_no_evidence():
    speed = np.abs(np.sin(np.arange(90.0)))
    assert compare(speed, speed) == -1.0


def test_nothing_is_like_nothing():
    assert group_boards({}) == []
    assert closeness(PoseTracker().view(), PoseTracker().view()) == -1.0
    assert shared_share([], PoseTracker().view()) == 1.0
