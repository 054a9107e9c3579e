"""Where IMUs sit, and the base frame that it is told in."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest
from rig_runs import calibrated, IMUS, true_mountings
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig import Extrinsics
from multiimu_ros.rig_calibration.lever_arm_stage import (
    as_extrinsics,
    base_rotation,
    fit_positions,
)
from multiimu_ros.rig_calibration.motion import common_motion, CommonMotion
from multiimu_ros.simulation.placements import ring

SEEDS = (0, 1)


@pytest.mark.slow
@pytest.mark.long
def test_arms_are_within_their_sigma_and_hundredths_of_a_millimetre():
    errors, z = [], []
    for seed in SEEDS:
        found = calibrated(seed).lever_arms.arms
        _, true = true_mountings(seed)
        errors.append((found.position - true)[1:])
        z.append(errors[-1] / found.sigma[1:])
    assert np.sqrt(np.mean(np.square(errors))) < 0.03e-3
    # Twelve values that share the noise of the first IMUs: a mean square of 3 is 1 in 1000.
    assert np.mean(np.square(z)) < 3.0


def test_the_fit_explains_the_differences_between_the_imus():
    arms = calibrated(0).lever_arms.arms
    # 0.08 m times 3 to 10 /s^2 before; noise of 12 mm/s^2 in three axes, smoothed, after.
    assert (arms.residual_rms < 0.1 * arms.residual_rms_before).all()
    assert (arms.residual_rms < 0.03).all()


def test_the_base_frame_stays_where_the_drawing_puts_it():
    found, drawn = calibrated(0, drawn=True).after.imus, ring(IMUS).imus
    arms = np.array([imu.extrinsics.lever_arm_b for imu in found])
    expected = np.array([imu.extrinsics.lever_arm_b for imu in drawn])
    assert_allclose(arms.mean(axis=0), expected.mean(axis=0), rtol=0, atol=1e-12)
    # Errors of single mountings average out: nothing is left of the best common turn.
    pairs = zip(found, drawn, strict=True)
    rest = np.sum([d.extrinsics.R_bs @ f.extrinsics.R_bs.T for f, d in pairs], axis=0)
    assert_allclose(rest, rest.T, rtol=0, atol=1e-9)
    bare = calibrated(0)
    true, _ = true_mountings(0)
    for one, other, R in zip(found, bare.after.imus, true, strict=True):
        first = found[0].extrinsics.R_bs
        # The mountings themselves do not depend on the gauge.
        assert_allclose(first.T @ one.extrinsics.R_bs, other.extrinsics.R_bs, atol=1e-9)
        assert_allclose(other.extrinsics.R_bs, R, atol=3e-4)


def test_without_drawn_poses_the_base_frame_is_the_first_imus():
    first = calibrated(0).after.imus[0].extrinsics
    assert_allclose(first.R_bs, np.eye(3), rtol=0, atol=1e-12)
    assert first.lever_arm == (0.0, 0.0, 0.0)
    assert first.rotation_sigma == first.lever_arm_sigma == (0.0, 0.0, 0.0)


def test_the_base_rotation_is_the_best_common_one(rng):
    R = Rotation.random(5, random_state=3)
    base = Rotation.random(random_state=4)
    poses = [Extrinsics(rotation=tuple(one.as_quat())) for one in base * R]
    assert_allclose(base_rotation(poses, R.as_matrix()), base.as_matrix(), atol=1e-12)


def test_without_a_fit_the_arms_of_the_rig_file_stay():
    run = calibrated(0, drawn=True)
    poses = as_extrinsics(run.before, run.mountings, None)
    assert [p.lever_arm for p in poses] == [i.extrinsics.lever_arm for i in run.before.imus]


def test_too_little_common_motion_is_refused_with_a_remedy():
    run = calibrated(0)
    motion = common_motion(run.board)
    readings = motion.readings.copy()
    readings[round(12.0 / motion.grid.step) :, 2] = np.nan  # rest and a second of moving
    part = CommonMotion(motion.grid, readings)
    with pytest.raises(CalibrationError, match='at least 3 s of motion that all IMUs saw, got'):
        fit_positions(run.board, run.mountings, part)


def test_mountings_that_are_off_are_taken_up_by_the_mixing():
    run = calibrated(0)
    off = list(run.mountings)
    turn = Rotation.from_rotvec([2e-4, -1e-4, 1e-4]).as_matrix()
    off[1] = replace(off[1], R=off[1].R @ turn)
    found = fit_positions(run.board, off, common_motion(run.board)).arms.position
    before = run.lever_arms.arms.position
    # 0.2 mrad of 9.81 m/s^2 would be 2 mm/s^2, over L of some 10 /s^2: 0.2 mm.
    assert np.abs(found - before).max() < 0.03e-3
