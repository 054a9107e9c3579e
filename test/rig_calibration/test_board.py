"""What a board is made of: sound samples in SI, or one sentence that says what is wrong."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from rig_runs import bare_rig, rests_of, scaled

from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig_calibration.board import pose_means, take_board
from multiimu_ros.samples import ImuSamples

COUNT = 400
G_IN_COUNTS = 16384  # MPU-6050 at 2 g


def still(rng, count=COUNT):
    """Return a resting IMU that is turned by 1 rad/s for a tenth of the time."""
    rate = 0.01 * rng.standard_normal((count, 3))
    rate[: count // 10, 0] += 1.0
    force = np.array([0.0, 0.0, 9.81]) + 0.02 * rng.standard_normal((count, 3))
    return ImuSamples(5_000_000 * np.arange(count), rate, force)


def test_readings_in_si_are_taken(rng):
    board = take_board(bare_rig(2), [still(rng), still(rng)])
    assert [len(track.samples) for track in board.tracks] == [COUNT, COUNT]
    assert board.gravity == 9.80665


@pytest.mark.parametrize(
    ('factors', 'reason'),
    [
        ({'force': 1 / 9.81}, 'that is g, and must be m/s'),
        ({'force': 1000 / 9.81}, 'counts or milli-g'),
        ({'force': G_IN_COUNTS / 9.81}, 'counts or milli-g'),
        ({'force': 0.01}, 'gravity was taken out, and must stay in'),
        ({'rate': 100 * 180 / np.pi}, 'deg/s or counts, and must be rad/s'),
    ],
)
def test_another_unit_is_named_in_one_sentence(rng, factors, reason):
    with pytest.raises(CalibrationError, match=reason) as error:
        take_board(bare_rig(2), [still(rng), scaled(still(rng), **factors)])
    message = str(error.value)
    assert message.startswith('`imu1` reads')
    assert message.endswith('record again.')
    assert '\n' not in message


def test_too_few_samples_are_refused_by_name(rng):
    with pytest.raises(
        CalibrationError, match='`imu1` must have at least 100 sound samples, got 9'
    ):
        take_board(bare_rig(2), [still(rng), still(rng).select(slice(0, 9))])


def test_the_mean_of_a_rest_is_that_of_its_samples_and_nan_where_nothing_was_heard(rng):
    board = take_board(bare_rig(1), [still(rng)])
    means = pose_means(board.tracks[0].samples, rests_of(board, (0.1, 0.5), (90.0, 99.0)))
    expected = board.tracks[0].samples.specific_force[20:101].mean(axis=0)
    assert_allclose(means[0], expected, rtol=1e-12)
    assert np.isnan(means[1]).all()
