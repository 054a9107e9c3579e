"""Scores of made-up errors, whose values are known."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from report_runs import still_truth, track_like
from scipy.spatial.transform import Rotation

from multiimu_ros.report import scores
from multiimu_ros.simulation.placements import ring

TRUTH = still_truth()
N = len(TRUTH.stamp_ns)


def rms(key, errors):
    return next(q for q in scores.QUANTITIES if q.key == key).rms(errors)


def test_rate_and_force_count_per_axis_attitude_and_position_as_lengths():
    later = np.linspace(0, 1, N)[:, np.newaxis] > 0.5  # after the second that is aligned
    tilt = Rotation.from_rotvec([0.003, 0.004, 0.0]).as_matrix()
    track = track_like(
        TRUTH,
        angular_rate=TRUTH.angular_rate + np.array([0.1, 0.2, 0.2]),
        specific_force=TRUTH.specific_force + np.array([0.0, 0.0, 0.3]),
        R_nb=np.where(later[:, :, np.newaxis], tilt, np.eye(3)),
        position_n=later * [3.0, 0.0, 4.0],
    )
    errors = scores.errors_of(track, TRUTH)
    assert_allclose(rms('angular_rate', errors), np.sqrt(0.09 / 3))
    assert_allclose(rms('specific_force', errors), np.sqrt(0.09 / 3))
    # Half of the instants are off by 5 mrad (a 3-4-5 triangle), half by nothing.
    assert_allclose(rms('attitude_n', errors), 0.005 / np.sqrt(2), rtol=1e-6)
    assert_allclose(rms('position_n', errors), 5.0 / np.sqrt(2))


def test_yaw_and_origin_are_no_errors():
    turn = Rotation.from_euler('z', 70, degrees=True)
    path = np.column_stack([np.linspace(0, 2, N), np.zeros((N, 2))])
    truth = still_truth()
    object.__setattr__(truth, 'position_n', path)
    elsewhere = turn.apply(path) + np.array([5.0, -3.0, 1.0])
    turned = turn.as_matrix() @ truth.R_nb
    track = track_like(truth, position_n=elsewhere, R_nb=turned, odom_R_nb=turned)
    errors = scores.errors_of(track, truth)
    assert_allclose(errors.attitude_n, 0.0, atol=1e-12)
    assert_allclose(errors.position_n, 0.0, atol=1e-12)


def rows(fused_size, noise=None):
    sizes = {'imu0': 3.0, 'imu1': 2.0, 'imu2': 4.0, 'imu3': 5.0}
    made = {name: constant(size) for name, size in sizes.items()}
    return scores.compare(made, constant(1.5), constant(fused_size), noise or {})


def constant(size):
    return scores.Errors(TRUTH.stamp_ns, *(np.full((N, 3), size) for _ in range(4)))


def test_best_is_chosen_and_ideal_is_the_typical_one_over_root_k():
    first = rows(1.0)[0]
    assert (first.best_imu, first.best, first.mean, first.fused) == ('imu1', 2.0, 1.5, 1.0)
    assert first.gain == 2.0
    # rms of 3, 2, 4, 5 is sqrt(54 / 4); over sqrt(4).
    assert_allclose(first.ideal, np.sqrt(54) / 4)


def test_where_the_noise_is_known_it_is_the_ideal():
    assert rows(1.0, {'angular_rate': 6.0})[0].ideal == 3.0


@pytest.mark.parametrize(('fused', 'lost'), [(1.9, 0), (2.0, 3), (np.nan, 3)])
def test_a_tie_and_nan_do_not_win(fused, lost):
    assert len(scores.not_won(rows(fused))) == lost  # rate, force, attitude; position is free


def test_noise_of_one_sample_is_density_times_root_rate():
    noise = scores.noise_of_one_sample(ring(8), 200.0)
    # BMI160: 0.007 deg/s/sqrt(Hz) and 180 ug/sqrt(Hz).
    assert_allclose(noise['angular_rate'], np.deg2rad(0.007) * np.sqrt(200))
    assert_allclose(noise['specific_force'], 180e-6 * 9.80665 * np.sqrt(200))


def test_json_holds_the_table_in_si():
    table = scores.as_json(rows(1.0))
    assert table['position_n']['best_imu'] == 'imu1'
    assert_allclose(table['position_n']['fused'], np.sqrt(3))


def test_the_settling_can_be_left_out():
    late = constant(1.0).after(int(TRUTH.stamp_ns[-1]))
    assert len(late.stamp_ns) == len(late.position_n) == 1
