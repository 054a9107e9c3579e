"""One recording to one rig: stages that keep what they did not ask for, and damaged recordings."""

from functools import cache

import kth
import numpy as np
from numpy.testing import assert_allclose
import pytest
from rig_runs import bare_rig, calibrated, recorded, scaled, true_mountings, turn_between

from multiimu_ros.errors import CalibrationError, ConfigError
from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.rig_calibration.calibrate import calibrate_rig, spread, STAGES
from multiimu_ros.samples import ImuSamples

BLOCKS = {
    'time': {'time_offset', 'time_offset_sigma'},
    'intrinsics': {'intrinsics'},
    'rotation': {'extrinsics'},
    'lever_arm': {'extrinsics'},
    'noise': {'noise'},
}


def test_a_bare_rig_becomes_a_complete_one():
    run = calibrated(0)
    assert run.before == bare_rig()
    assert run.after.nominal_blocks() == ()
    assert run.notes == ()
    assert run.spread_before > 0.1  # [m/s^2] offsets of 0.02 g
    # Means of 800 samples of 25 mm/s^2, in three axes, and 40 ug of flicker: 1.5 mm/s^2.
    assert run.spread_after < 2e-3


def test_the_noise_density_is_that_of_the_rests():
    for imu in calibrated(0).after.imus:
        # A BMI160's: 0.007 deg/s/sqrt(Hz), 180 ug/sqrt(Hz) and a step of 1/4096 g.
        assert_allclose(imu.noise.noise_density.gyroscope, np.deg2rad(0.007), rtol=0.1)
        assert_allclose(imu.noise.noise_density.accelerometer, 180e-6 * 9.80665, rtol=0.1)


@pytest.mark.parametrize('stage', STAGES)
def test_one_stage_alone_keeps_everything_else(stage):
    known = calibrated(0, drawn=True).after
    again = calibrate_rig(known, recorded(0).raw, stages=[stage]).after
    assert again.rig == known.rig
    for before, after in zip(known.imus, again.imus, strict=True):
        for key in set(type(before).model_fields) - BLOCKS[stage]:
            assert getattr(after, key) == getattr(before, key), key
        if stage == 'rotation':
            assert after.extrinsics.lever_arm == before.extrinsics.lever_arm
    changed = again.imus[1].extrinsics
    if stage in ('rotation', 'lever_arm'):
        assert_allclose(changed.lever_arm_b, known.imus[1].extrinsics.lever_arm_b, atol=2e-5)
        assert_allclose(changed.R_bs, known.imus[1].extrinsics.R_bs, atol=1e-5)


def test_an_unknown_stage_is_named():
    with pytest.raises(ConfigError, match=r'`only` must be one of time, .* got `magnetometer`'):
        calibrate_rig(bare_rig(), recorded(0).raw, stages=['magnetometer'])


def test_lever_arms_alone_need_to_know_how_imus_are_mounted():
    with pytest.raises(CalibrationError, match='must say how `imu0` is mounted; fit `rotation`'):
        calibrate_rig(bare_rig(), recorded(0).raw, stages=['lever_arm'])


def test_another_unit_is_refused_before_anything_is_fitted():
    raw = list(recorded(0).raw)
    raw[1] = scaled(raw[1], force=1 / 9.80665)
    with pytest.raises(CalibrationError, match=r'`imu1` reads a force of .* that is g'):
        calibrate_rig(bare_rig(), raw)


@cache
def half_missing():
    """Calibrate with the middle of the recording of one IMU missing: 245 of 490 s."""
    raw = list(recorded(0).raw)
    time = (raw[2].stamp_ns - raw[2].stamp_ns[0]) / 1e9
    raw[2] = raw[2].select((time < 200.0) | (time > 445.0))
    return calibrate_rig(bare_rig(), raw)


def test_half_of_one_imus_recording_is_enough():
    run = half_missing()
    true, arms = true_mountings(0)
    for k in (1, 2):
        assert np.rad2deg(np.linalg.norm(turn_between(run.mountings[k].R, true[k]))) < 0.02
        assert np.abs(run.lever_arms.arms.position[k] - arms[k]).max() < 0.15e-3
    whole = calibrated(0).after.imus
    for axis in range(3):
        less = run.after.imus[2].intrinsics.accelerometer.scale_sigma[axis]
        assert less > whole[2].intrinsics.accelerometer.scale_sigma[axis]


def test_saturated_samples_are_left_out():
    limit = 1.5  # [rad/s]: the fastest waving exceeds it
    raw = list(recorded(0).raw)
    rate = raw[1].angular_rate.clip(-limit, limit)
    raw[1] = type(raw[1])(raw[1].stamp_ns, rate, raw[1].specific_force)
    assert (np.abs(rate) == limit).any(axis=1).mean() > 1e-3
    run = calibrate_rig(bare_rig(), raw)
    assert run.board.tracks[1].saturated > 50
    true, arms = true_mountings(0)
    assert np.rad2deg(np.linalg.norm(turn_between(run.mountings[1].R, true[1]))) < 0.02
    assert np.abs(run.lever_arms.arms.position[1] - arms[1]).max() < 0.15e-3
    assert abs(run.after.imus[1].time_offset - 0.002) < 10e-6


@cache
def kth_calibrated(name):
    return calibrate_rig(kth.rig(), kth.load(name))


@pytest.mark.realdata
@pytest.mark.slow
def test_two_recordings_of_a_real_board_agree_with_each_other_and_with_its_drawing():
    first, second = kth_calibrated('exp_3'), kth_calibrated('exp_4')
    drawn = np.array([imu.extrinsics.lever_arm for imu in kth.rig().imus])
    for run in (first, second):
        assert run.spread_before > 0.3
        assert run.spread_after < 5e-3
        arms = np.array([imu.extrinsics.lever_arm for imu in run.after.imus])
        apart = (arms - drawn) - (arms - drawn).mean(axis=0)
        assert np.sqrt(np.mean(apart**2)) < 0.5e-3
        # All eight are sampled at once.
        assert max(abs(imu.time_offset) for imu in run.after.imus) < 30e-6
    for one, other in zip(first.mountings, second.mountings, strict=True):
        assert np.rad2deg(np.linalg.norm(turn_between(one.R, other.R))) < 0.05
    crossed = Board(first.after, second.board.tracks)
    assert spread(crossed, second.intervals) < 10e-3


def test_noise_of_a_longer_record_stays_unless_noise_alone_is_asked_for():
    recording = recorded(0)
    rig = calibrated(0).after
    quiet = rig.imus[0].noise.noise_density.model_copy(update={'gyroscope': (1e-5,) * 3})
    noise = rig.imus[0].noise.model_copy(update={'noise_density': quiet})
    allan = {'noise': noise, 'provenance': {'noise': {'bag': 'a long rest'}}}
    known = rig.model_copy(update={'imus': (rig.imus[0].model_copy(update=allan), *rig.imus[1:])})
    found = calibrate_rig(known, recording.raw, stages=['noise', 'time']).after
    assert found.imus[0].noise == noise
    assert found.imus[1].noise == rig.imus[1].noise  # from the same rests
    alone = calibrate_rig(known, recording.raw, stages=['noise']).after
    assert alone.imus[0].noise.noise_density.gyroscope[0] > 5e-5


def test_a_gyroscope_with_an_axis_turned_round_is_refused():
    first = recorded(0).raw[0]
    mirrored = ImuSamples(
        first.stamp_ns, first.angular_rate * [1.0, 1.0, -1.0], first.specific_force
    )
    with pytest.raises(CalibrationError, match='have the same order and signs'):
        calibrate_rig(bare_rig(1), [mirrored], stages=['intrinsics'])


def test_the_rests_that_an_imu_missed_are_no_unknowns_of_its_own_fit():
    raw = recorded(0).raw[0]
    half = raw.select(raw.stamp_ns < int(np.median(raw.stamp_ns)))
    other = calibrate_rig(bare_rig(2), [raw, half], stages=['intrinsics'])
    fit = other.intrinsics[1]
    assert 0 < fit.poses.known.sum() < len(fit.poses)
    assert np.isfinite(fit.covariance).all()


def test_an_accelerometer_with_an_axis_turned_round_is_refused():
    first = recorded(0).raw[0]
    mirrored = ImuSamples(
        first.stamp_ns, first.angular_rate, first.specific_force * [-1.0, 1.0, 1.0]
    )
    with pytest.raises(CalibrationError, match='have the same order and signs'):
        calibrate_rig(bare_rig(1), [mirrored], stages=['intrinsics'])
