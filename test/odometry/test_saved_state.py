"""A state in a file, and starts in the middle of a motion, with and without one."""

import json

import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import filters, FORCE_DENSITY, RATE_DENSITY, read, to_start_frame
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import ConfigError
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.saved_state import (
    ANY_HEADING,
    load_state,
    Origin,
    Owner,
    place,
    save_state,
    snapshot,
    TURNING,
)
from multiimu_ros.rig import parse_rig
from multiimu_ros.rotations import exp_so3, log_so3
from multiimu_ros.simulation.trajectories import make_motion

DENSITIES = RATE_DENSITY, FORCE_DENSITY
SECOND = 1_000_000_000


def rig(name='ring', **imu):
    """Return a rig of one IMU."""
    content = {'name': 'imu0', 'frame_id': 'imu0', **imu}
    return parse_rig({'version': 1, 'rig': {'name': name}, 'imus': [content]}, 'test')


OWNER = Owner(rig(), 'foot', (0.1, 0.0, 0.0))


class Walk:
    """A simulated foot whose filters may start anywhere."""

    def __init__(self, seed, duration=30.0, rate_hz=100):
        self.rate_hz = rate_hz
        self.motion = make_motion('foot', duration, rate_hz, seed)
        self.rate, self.force, *_ = read(self.motion, np.random.default_rng(seed), rate_hz)
        self.R, self.position, self.velocity = to_start_frame(self.motion)

    def run(self, start, end, detector, attitude, odometry):
        """Push the samples from `start` to `end` [s]."""
        for k in range(round(start * self.rate_hz), round(end * self.rate_hz)):
            readings = self.rate[k], self.force[k], *DENSITIES
            flags = detector.push(1 / self.rate_hz, *readings)
            for each in (attitude, odometry):
                each.push(Sample(1 / self.rate_hz, *readings, *flags))


def saved(stamp_ns=10 * SECOND, seed=1, end=12.0):
    """Return what is saved in the middle of a walk."""
    detector, attitude, odometry = filters('foot')
    Walk(seed).run(0.0, end, detector, attitude, odometry)
    pose = odometry.state, odometry.R_nb, odometry.P
    return snapshot(
        OWNER, stamp_ns, pose, (attitude.R_nb, attitude.P), attitude.gyro_bias
    ), odometry  # fmt: skip


@pytest.mark.compiled
def test_what_is_saved_is_what_is_loaded(tmp_path):
    state, odometry = saved()
    path = tmp_path / 'state.json'
    for _ in range(2):  # the second replaces the first
        save_state(state, path)
    assert load_state(path, OWNER, 11 * SECOND) == state
    assert [file.name for file in tmp_path.iterdir()] == ['state.json']
    assert_allclose(state.position_n, odometry.position_n, rtol=0)
    assert_allclose(state.covariance, odometry.P, rtol=1e-9, atol=1e-15)


@pytest.mark.compiled
def test_a_state_that_does_not_fit_is_refused_in_a_sentence(tmp_path):
    path = tmp_path / 'state.json'
    save_state(saved()[0], path)
    good = json.loads(path.read_text())
    now = 11 * SECOND
    cases = [
        (OWNER._replace(rig=rig('cube')), now, "`rig` must be 'cube' as now, got 'ring'"),
        (OWNER._replace(rig=rig(time_offset=0.1)), now, '`rig_digest` must be'),
        (OWNER._replace(profile='hand'), now, "`profile` must be 'hand' as now, got 'foot'"),
        (OWNER._replace(virtual_imu=(0.0, 0.0, 0.0)), now, '`virtual_imu` must be'),
        (OWNER, 3700 * SECOND, 'must be at most 3600 s old, got 3690 s'),
        (OWNER, 9 * SECOND, 'must be at most 3600 s old, got -1 s'),
    ]
    for owner, instant, message in cases:
        with pytest.raises(ConfigError, match=message):
            load_state(path, owner, instant)
    turned = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.1, 1.0]]
    negative = (-np.eye(15)).tolist()
    for change, message in [
        ({'R_nb': turned}, '`R_nb`: must be a rotation matrix'),
        ({'covariance': negative}, '`covariance`: must be a covariance'),
        ({'covariance': good['covariance'][:3]}, '`covariance`: '),
        ({'covariance': [[1.0]] * 15}, '`covariance`: must be square'),
        ({'stamp_ns': 'soon'}, '`stamp_ns`: '),
        ({'version': 2}, '`version`: '),
    ]:
        path.write_text(json.dumps(good | change))
        with pytest.raises(ConfigError, match=message):
            load_state(path, OWNER, now)
    path.write_text(json.dumps(good)[:-40])
    with pytest.raises(ConfigError, match=r'is damaged: .*; delete it'):
        load_state(path, OWNER, now)
    with pytest.raises(ConfigError, match=r'Cannot read .*: No such file'):
        load_state(tmp_path / 'none.json', OWNER, now)
    with pytest.raises(ConfigError, match='choose a writable place'):
        save_state(saved()[0], tmp_path / 'none' / 'state.json')


@pytest.mark.compiled
def test_the_longer_the_restart_the_less_is_known():
    state, odometry = saved()
    config = odometry._config
    soon, later, ages = (
        Origin(state, config, state.stamp_ns + age * SECOND) for age in (0, 4, 900)
    )
    assert_allclose(soon.spread[:3, :3], odometry.P[:3, :3], rtol=1e-9)
    # 1.5 m/s for 4 s; a heading that walks by 0.35 rad in a second, until it may be any.
    added = np.diag(later.spread - soon.spread)
    assert_allclose(added, [36.0, 36.0, 36.0, TURNING**2 * 4], rtol=1e-9)
    assert_allclose(ages.spread[3, 3] - soon.spread[3, 3], ANY_HEADING**2, rtol=1e-9)
    _, attitude, fresh = filters('foot')
    later.restore_biases(fresh, attitude)
    assert_allclose(fresh.gyro_bias, odometry.gyro_bias, rtol=1e-12)
    grown = np.diag(fresh.P - odometry.P)
    walks = np.square(np.concatenate((config.rate_bias_walk, config.force_bias_walk)))
    assert_allclose(grown[9:15], 4 * walks, rtol=1e-6)


def test_placing_a_pose_elsewhere_matches_finite_differences(rng):
    root = 1e-2 * rng.standard_normal((15, 15))
    P, R, x = root @ root.T, Rotation.random(rng=rng).as_matrix(), rng.standard_normal(15)
    position, yaw, step = rng.standard_normal(3), 0.7, 1e-6
    base, turned, _ = place(x, R, P, position, yaw, np.zeros((4, 4)))
    J = np.empty((15, 19))
    for j, error in enumerate(step * np.eye(19)):
        moved = R @ exp_so3(error[6:9])
        other = place(
            x + error[:15], moved, P, position + error[15:18], yaw + error[18], P[:4, :4]
        )
        J[:, j] = (other[0] - base) / step
        J[6:9, j] = log_so3(np.ascontiguousarray(turned.T @ other[1])) / step
    spread = P[:4, :4]
    whole = np.zeros((19, 19))
    whole[:15, :15], whole[15:, 15:] = P, spread
    # Forward differences: relative error of the order of the step.
    assert_allclose(place(x, R, P, position, yaw, spread)[2], J @ whole @ J.T, atol=1e-7)
    assert_allclose(np.linalg.norm(base[:3] - position), np.linalg.norm(x[:3]), rtol=1e-12)


@pytest.mark.slow  # where nothing is compiled
def test_a_restart_in_mid_walk_knows_where_it_is_as_well_as_it_says():
    for seed, pause in ((1, 0.3), (2, 1.0), (3, 3.0)):
        walk = Walk(seed)
        detector, attitude, odometry = filters('foot')
        walk.run(0.0, 12.0, detector, attitude, odometry)
        state = snapshot(
            OWNER, 12 * SECOND, (odometry.state, odometry.R_nb, odometry.P),
            (attitude.R_nb, attitude.P), attitude.gyro_bias,
        )  # fmt: skip
        origin = Origin(state, odometry._config, round((12 + pause) * SECOND))
        detector, attitude, odometry = filters('foot')
        origin.restore_biases(odometry, attitude)
        walk.run(12.0 + pause, 25.0, detector, attitude, odometry)
        x, R, P = origin.seen(odometry)
        k = round(25.0 * walk.rate_hz) - 1
        assert (np.abs(x[:3] - walk.position[k]) < 3 * np.sqrt(np.diag(P)[:3])).all()
        for turned, spread in ((R, P[6:9, 6:9]), origin.seen_attitude(attitude)):
            theta = log_so3(np.ascontiguousarray(turned.T @ walk.R[k]))
            up = turned[2]
            assert abs(up @ theta) < 3 * np.sqrt(up @ spread[:3, :3] @ up)


@pytest.mark.slow  # where nothing is compiled
def test_a_start_in_mid_walk_levels_itself():
    walk, scores, worst = Walk(1, 20.0), [], []
    for start in np.arange(8.0, 9.2, 0.1):  # all phases of a stride
        detector, attitude, odometry = filters('foot')
        walk.run(start, start + 5.0, detector, attitude, odometry)
        k = round((start + 5.0) * walk.rate_hz) - 1
        R, P = odometry.R_nb, odometry.P
        error = np.cross(R[2], walk.R[k][2])  # of the vertical, body axes
        # The inclination of a good attitude is 0.1 deg; four stances give a degree.
        assert np.linalg.norm(error) < np.deg2rad(1.0)
        flat = np.eye(3) - np.outer(R[2], R[2])
        scores.append(error @ np.linalg.pinv(flat @ P[6:9, 6:9] @ flat) @ error / 2)
        velocity = R.T @ odometry.velocity_n - walk.R[k].T @ walk.velocity[k]
        worst.append(np.linalg.norm(velocity))
        assert np.isfinite(P).all()
    # A swing of 0.4 s with 1 deg of gravity: 0.07 m/s.
    assert np.max(worst) < 0.07
    # Twelve starts into one walk share its noise: no better than one draw of chi-squared over 2.
    assert np.mean(scores) < 3.0
