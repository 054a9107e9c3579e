"""The frames of a pipeline as a walk, and what of it can be drawn."""

from dataclasses import replace
from functools import cache

from made_up_walks import made, stepping
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from report_runs import recording
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import ConfigError
from multiimu_ros.odometry.smoother import Smoothed
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.report import walk as module
from multiimu_ros.report.tracks import in_order
from multiimu_ros.report.walk import as_walk, smoothed_walk, sound, WalkRecorder


@cache
def frames():
    run, rig, _ = recording()
    pipeline = Pipeline(rig, PipelineConfig(profile='hand'))
    return list(pipeline.push_block(*in_order(run.raw)))


def test_a_walk_is_what_the_odometry_said():
    walk = as_walk(frames())
    assert walk.stamp_ns.tolist() == [frame.stamp_ns for frame in frames()]
    k = len(walk) // 2
    frame = frames()[k]
    assert_array_equal(walk.position_n[k], frame.position_n)
    assert_array_equal(walk.position_covariance[k], frame.pose_covariance[:3, :3])
    assert_array_equal(walk.rotation_covariance[k], frame.pose_covariance[3:, 3:])
    turned = Rotation.from_quat(frame.odom_orientation).as_matrix() @ frame.velocity_b
    assert_allclose(walk.velocity_n[k], turned, rtol=1e-12)  # one product by two routes
    assert walk.still[k] == frame.still


def test_a_recorder_lets_all_frames_pass_in_blocks(monkeypatch):
    monkeypatch.setattr(module, 'BLOCK', 64)
    recorder = WalkRecorder()
    assert list(recorder.watch(iter(frames()))) == frames()
    for name, column in vars(recorder.walk()).items():
        assert_array_equal(column, vars(as_walk(frames()))[name])


def test_no_frame_is_refused_in_words():
    with pytest.raises(ConfigError, match='got no frame'):
        as_walk([])


def test_what_is_not_finite_is_left_out_and_told():
    walk = stepping()
    position = walk.position_n.copy()
    position[[3, 7]] = np.nan
    kept, said = sound(replace(walk, position_n=position))
    assert len(kept) == len(walk) - 2
    assert said == (f'2 frames of {len(walk)} were not finite and are left out.',)


def test_a_whole_walk_is_kept_without_a_word():
    walk = stepping()
    kept, said = sound(walk)
    assert len(kept) == len(walk)
    assert said == ()


def test_after_a_jump_back_in_time_the_last_part_is_shown():
    walk = stepping()
    stamps = walk.stamp_ns.copy()
    stamps[100:] -= 500 * 10**9
    kept, said = sound(replace(walk, stamp_ns=stamps))
    assert kept.stamp_ns.tolist() == stamps[100:].tolist()
    assert 'went back 1 times' in said[0]


def test_nothing_finite_is_refused_in_words():
    nothing = np.full((5, 3), np.nan)
    with pytest.raises(ConfigError, match='at least 2 finite frames, got 0'):
        sound(made(nothing, np.zeros(5, bool)))


def test_only_what_cannot_be_bridged_is_a_gap():
    walk = stepping()
    stamps = walk.stamp_ns.copy()
    stamps[50:] += 150_000_000  # 0.16 s with the step: bridged
    stamps[90:] += 3 * 10**9
    assert_allclose(replace(walk, stamp_ns=stamps).gaps, [3.01])


def test_a_smoothed_walk_has_the_stamps_of_its_samples_and_fixed_axes():
    live = stepping(strides=2)
    rows = np.delete(np.arange(len(live)), [5, 6])
    R = Rotation.from_euler('z', 90, degrees=True).as_matrix()
    state, P = np.zeros((len(rows), 15)), np.diag(np.arange(1.0, 16.0) ** 2)
    state[:, 9:] = np.arange(6.0)
    every = [np.repeat(each[np.newaxis], len(rows), axis=0) for each in (R, P)]
    walk = smoothed_walk(live, Smoothed(rows, state, *every))
    assert walk.stamp_ns.tolist() == live.stamp_ns[rows].tolist()
    assert_array_equal(walk.still, live.still[rows])
    # What was uncertain about x of the body is uncertain about y of the room, and the reverse.
    assert_allclose(walk.rotation_covariance[0], np.diag([64.0, 49.0, 81.0]), atol=1e-12)
    assert_allclose(walk.gyro_bias_sigma[0], [10.0, 11.0, 12.0])
    assert_allclose(walk.accel_bias[0], [3.0, 4.0, 5.0])
    assert_allclose(Rotation.from_quat(walk.orientation[0]).as_matrix(), R, atol=1e-12)
