"""A recording is the truth plus what its rig and timing say, and a calibration of it is honest."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from multiimu_ros.rig import parse_rig
from multiimu_ros.simulation import placements
from multiimu_ros.simulation.calibrated import calibrated_rig, Residuals
from multiimu_ros.simulation.errors import BMI160, PERFECT
from multiimu_ros.simulation.recording import simulate, Timing
from multiimu_ros.simulation.trajectories import trajectory

HAND = trajectory('hand', 8.5, seed=1)  # 4 s of rest, then 4 s of motion
CUBE = placements.cube(3)


def test_perfect_imus_at_rest_read_plus_g_along_their_own_up():
    recording = simulate(CUBE, trajectory('hand', 1.0), 100.0, PERFECT)
    forces = [samples.specific_force[0] for samples in recording.raw]
    # Front and left face: their z points forward and left, so up is their -x and -y.
    assert_allclose(forces, 9.80665 * np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), atol=1e-12)


def test_each_imu_reads_the_truth_at_its_own_instants_and_place():
    timing = Timing(stagger=0.0004, sampling_jitter=1e-4, start_ns=0)
    recording = simulate(CUBE, HAND, 100.0, PERFECT, timing=timing)
    for imu, samples in zip(recording.rig.imus, recording.raw, strict=True):
        truth = HAND.at(samples.stamp_ns / 1e9)
        pose = imu.extrinsics
        # Stamps are rounded to 1 ns, and a jerk of 1e3 makes 1e-6 of that.
        force = truth.specific_force_at(pose.lever_arm_b) @ pose.R_bs
        assert_allclose(samples.specific_force, force, atol=1e-5)
        assert_allclose(samples.angular_rate, truth.angular_rate_b @ pose.R_bs, atol=1e-5)


def test_truth_is_stamped_at_the_beginning_of_each_scan():
    recording = simulate(CUBE, HAND, 100.0, timing=Timing(sampling_jitter=1e-4))
    assert np.array_equal(recording.truth_ns, recording.raw[0].stamp_ns)
    assert len(recording.truth.time) == 850


def test_stamps_follow_a_fast_clock_and_the_offset_leads_back():
    late = CUBE.imus[0].model_copy(update={'time_offset': -0.003})
    rig = CUBE.model_copy(update={'imus': (late,)})
    timing = Timing(skew_ppm=1000, start_ns=0)
    stamps = simulate(rig, HAND, 100.0, timing=timing).raw[0].stamp_ns
    assert_allclose(stamps[[0, 100]], [3e6, 1.004e9], atol=1)


def test_a_share_of_the_samples_is_lost():
    samples = simulate(CUBE, HAND, 500.0, timing=Timing(dropout=0.1)).raw
    # 4250 draws: standard error 20, times 4.
    assert all(abs(4250 - len(s) - 425) < 80 for s in samples)
    assert len({len(s) for s in samples}) > 1


def test_what_the_rig_file_says_is_the_truth_and_the_rest_is_drawn():
    drawn = simulate(CUBE, HAND, 100.0, seed=3).rig
    again = simulate(drawn, HAND, 100.0, seed=4).rig
    assert again == drawn
    assert CUBE.imus[0].intrinsics is None
    assert drawn.imus[0].intrinsics != drawn.imus[1].intrinsics


def test_the_same_seed_gives_the_same_recording():
    one, same, other = (simulate(CUBE, HAND, 100.0, seed=s).raw[2] for s in (1, 1, 2))
    assert np.array_equal(one.angular_rate, same.angular_rate)
    assert not np.array_equal(one.angular_rate, other.angular_rate)


def flat(rig, sigma=''):
    """Return every intrinsic parameter of a rig (or its sigma) that a calibration estimates."""
    keys = [
        (t, k) for t in ('accelerometer', 'gyroscope') for k in ('scale', 'bias', 'misalignment')
    ]
    keys.append(('gyroscope', 'g_sensitivity'))
    values = [
        np.ravel(getattr(getattr(imu.intrinsics, triad), key + sigma))
        for imu in rig.imus
        for triad, key in keys
    ]
    return np.concatenate(values)


def test_residuals_of_the_calibrated_rig_match_its_sigmas():
    true = simulate(placements.ring(16), HAND, 100.0).rig
    found = calibrated_rig(true, seed=1)
    sigma = flat(found, '_sigma')
    z = (flat(found) - flat(true))[sigma > 0] / sigma[sigma > 0]
    # 16 IMUs x (6 + 6 + 3 + 6 + 9) parameters: 480 draws, standard error of a deviation 3.2 %.
    assert len(z) == 480
    assert abs(np.std(z) - 1) < 0.12
    assert np.array_equal(flat(found)[sigma == 0], flat(true)[sigma == 0])


def test_poses_of_the_calibrated_rig_match_their_sigmas():
    true = simulate(placements.cube(16), HAND, 100.0).rig
    found = calibrated_rig(true, seed=2)
    pairs = [(a.extrinsics, b.extrinsics) for a, b in zip(true.imus, found.imus, strict=True)]
    turns = [Rotation.from_matrix(a.R_bs.T @ b.R_bs).as_rotvec() for a, b in pairs]
    arms = [b.lever_arm_b - a.lever_arm_b for a, b in pairs]
    # 48 draws each: standard error of a deviation 10 %, times 3.5.
    assert_allclose([np.std(turns), np.std(arms)], Residuals().rotation, rtol=0.35)


@given(seed=st.integers(0, 1000))
def test_a_calibrated_rig_is_a_valid_rig_file(seed):
    found = calibrated_rig(
        simulate(CUBE, trajectory('static', 0.1), 100.0, BMI160, seed).rig, seed
    )
    assert parse_rig(found.model_dump(mode='json', exclude_none=True), 'found') == found
