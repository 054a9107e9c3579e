"""A tracker's poses to rates, forces and the pose of an IMU: against a simulated hand's truth."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.errors import CalibrationError, SyncError
from multiimu_ros.registration.correlation import correlate_rates
from multiimu_ros.registration.pose_stream import differentiate, TrackerPoses
from multiimu_ros.registration.tracker import fit_tracker, TrackerConfig
from multiimu_ros.rotations import exp_so3
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.trajectories import trajectory

R_TS = Rotation.from_rotvec([0.4, -1.9, 0.7])
LEVER_ARM = np.array([0.05, -0.03, 0.02])  # [m]
OFFSET = 0.0371  # [s]
# Larger than any unit's, so that a bias which is forgotten somewhere shows.
GYRO_BIAS, FORCE_BIAS = np.deg2rad([15.0, -9.0, 6.0]), np.array([0.02, -0.03, 0.04])
R_WN = Rotation.from_rotvec([0.02, -0.03, 0.5])  # the tracker stands 2 deg off level
CONFIG = TrackerConfig()
START = 1_700_000_000 * NANOSECONDS


def tracked(rng, motion, times, position_sigma, angle_sigma):
    """Return what a tracker says about the target at `times` [s]."""
    seen = R_WN * Rotation.from_matrix(motion.at(times).R_nb)
    seen = seen * Rotation.from_rotvec(angle_sigma * rng.standard_normal((len(times), 3)))
    position = R_WN.apply(motion.at(times).position_n) + np.array([1.0, 2.0, 0.5])
    position = position + position_sigma * rng.standard_normal(position.shape)
    return TrackerPoses(START + (times * NANOSECONDS).astype(np.int64), position, seen.as_matrix())


def carried(rng, motion, times, noise):
    """Return what an IMU on the target says, its clock OFFSET behind the tracker's."""
    truth, R = motion.at(times), R_TS.as_matrix()
    root = noise * np.sqrt(200.0)  # noise of one sample at 200 Hz
    w, f = rng.standard_normal((2, len(times), 3))
    rate = truth.angular_rate_b @ R + GYRO_BIAS + root * BMI160.gyroscope.noise_density * w
    force = truth.specific_force_at(LEVER_ARM) @ R + FORCE_BIAS
    force = force + root * BMI160.accelerometer.noise_density * f
    return ImuSamples(START + ((times - OFFSET) * NANOSECONDS).astype(np.int64), rate, force)


def recording(seed, duration=30.0, rate_hz=100.0, *, position=2e-4, angle_deg=0.05, noise=1.0):
    rng = np.random.default_rng(seed)
    motion = trajectory('hand', duration, seed)
    t = np.arange(int(duration * rate_hz)) / rate_hz
    t_imu = np.arange(int(duration * 200)) / 200 + 0.0007
    poses = tracked(rng, motion, t, position, np.deg2rad(angle_deg))
    return poses, carried(rng, motion, t_imu, noise), motion


def errors_of(fit):
    """Return errors of rotation [rad], lever arm [m] and offset [s]: (7,)."""
    R_ts = Rotation.from_quat(fit.extrinsics.rotation)
    lever_arm = fit.extrinsics.lever_arm_b - LEVER_ARM
    return np.array([*(R_ts.inv() * R_TS).as_rotvec(), *lever_arm, fit.time_offset - OFFSET])


def sigmas_of(fit):
    pose = fit.extrinsics
    return np.array([*pose.rotation_sigma, *pose.lever_arm_sigma, fit.time_offset_sigma])


def test_at_rest_a_target_feels_plus_g_although_its_tracker_sees_no_acceleration(rng):
    t = np.arange(100) / 100
    poses = tracked(rng, trajectory('static', 1.0), t, 0.0, 0.0)
    motion = differentiate(poses, 0.15, 6)
    assert_allclose(motion.acceleration_w[50], 0.0, atol=1e-8)  # 1e-16 m over (0.15 s / 20)^2
    # At rest specific_force_n = [0, 0, +9.81], for gravity_n = [0, 0, -9.81].
    up_w = R_WN.apply([0.0, 0.0, 9.81])
    force_n = trajectory('static', 1.0).at(t).R_nb[50] @ motion.specific_force_t(up_w)[50]
    assert_allclose(force_n, [0.0, 0.0, 9.81], atol=1e-8)


def test_even_positions_are_differentiated_as_savitzky_and_golay_do(rng):
    t = np.arange(200) / 100
    position = rng.standard_normal((200, 3))
    poses = TrackerPoses(
        (t * NANOSECONDS).astype(np.int64), position, np.tile(np.eye(3), (200, 1, 1))
    )
    motion = differentiate(poses, 0.1001, 4)  # 21 samples
    published = savgol_filter(position, 21, 4, deriv=2, delta=0.01, axis=0)
    assert_allclose(motion.acceleration_w[10:-10], published[10:-10], rtol=1e-8, atol=1e-8)


def test_rates_and_forces_are_those_of_the_truth():
    poses, _, truth = recording(1, position=0.0, angle_deg=0.0)
    motion = differentiate(poses, CONFIG.half_width, CONFIG.order)
    at = truth.at((motion.stamp_ns - START) / NANOSECONDS)
    inside = slice(20, -20)
    # Motion up to 1.3 Hz and twice that in products: 0.5 % of 3 rad/s at 3 Hz, 0.1 % on average.
    rate = motion.angular_rate_t - at.angular_rate_b
    assert np.sqrt(np.mean(rate[inside] ** 2)) < 0.005
    force = motion.specific_force_t(R_WN.apply([0, 0, 9.80665])) - at.specific_force_b
    assert np.sqrt(np.mean(force[inside] ** 2)) < 0.005 * 5.0  # of 5 m/s^2 rms
    turn = motion.angular_acceleration_t - at.angular_acceleration_b
    assert np.sqrt(np.mean(turn[inside] ** 2)) < 0.02 * 18.0  # of 18 rad/s^2 rms


def test_the_rate_belongs_to_the_smoothed_attitude(rng):
    # A steady turn, with one attitude 0.2 rad off: the rate must be in the axes of the smooth one.
    t, w = np.arange(31) / 100, np.array([1.0, -2.0, 1.5])
    R = Rotation.from_rotvec(np.outer(t, w))
    bent = R.as_matrix()
    bent[15] = bent[15] @ exp_so3(np.array([0.2, 0.1, -0.1]))
    poses = TrackerPoses((t * NANOSECONDS).astype(np.int64), np.zeros((31, 3)), bent)
    motion = differentiate(poses, 0.15, 2)
    # (1) to first order in 0.2 rad; without J_r the rate would be up to 0.3 rad/s off.
    assert_allclose(motion.angular_rate_t[15], w, atol=0.04)


def test_the_noise_of_the_poses_is_found():
    poses, _, truth = recording(2)
    motion = differentiate(poses, CONFIG.half_width, CONFIG.order)
    # 9000 coordinates in overlapping windows, and what order 6 does not follow: 3 %.
    assert_allclose(motion.position_sigma, 2e-4, rtol=0.03)
    assert_allclose(motion.rotation_sigma, np.deg2rad(0.05), rtol=0.03)
    at = R_WN * Rotation.from_matrix(truth.at((motion.stamp_ns - START) / NANOSECONDS).R_nb)
    theta = (Rotation.from_matrix(motion.R_wt[20:-20]).inv() * at[20:-20]).as_rotvec()
    # The smoother's gain at 31 poses and order 6 is 0.39; 9000 errors, some 1000 of them free.
    assert_allclose(np.std(theta), 0.39 * np.deg2rad(0.05), rtol=0.1)


@pytest.mark.parametrize(
    ('rate_hz', 'position', 'rotation_deg', 'lever_arm'),
    # 30 s of a hand. Three times the rms of 15 seeds: 0.006, 0.0045, 0.004 deg, 0.07 mm, 10 us.
    [(60.0, 1e-4, 0.018, 0.2e-3), (100.0, 2e-4, 0.0135, 0.2e-3), (120.0, 3e-4, 0.012, 0.2e-3)],
)
def test_an_imu_on_the_target_is_found(rate_hz, position, rotation_deg, lever_arm):
    poses, imu, _ = recording(3, rate_hz=rate_hz, position=position)
    fit = fit_tracker(poses, {'imu0': imu})['imu0']
    error = errors_of(fit)
    assert np.all(np.abs(error[:3]) < np.deg2rad(rotation_deg))
    assert np.all(np.abs(error[3:6]) < lever_arm)
    assert abs(error[6]) < 30e-6
    assert_allclose(fit.angular_rate_bias, GYRO_BIAS, atol=1e-3)
    assert_allclose(fit.specific_force_bias, FORCE_BIAS, atol=0.01)
    assert_allclose(fit.up_w, R_WN.apply([0, 0, 9.80665]), atol=0.01)


def test_noise_of_the_attitude_does_not_shorten_the_lever_arm():
    poses, imu, _ = recording(4, rate_hz=60.0, angle_deg=0.2, position=1e-4)
    error = errors_of(fit_tracker(poses, {'imu0': imu})['imu0'])[3:6]
    # 3.5 mrad times 514 / s^2 is 1.8 of some 8 rad/s^2 per axis: K from it would lose 5 %, 3 mm.
    assert abs(error @ LEVER_ARM) < 0.01 * LEVER_ARM @ LEVER_ARM


@pytest.mark.long
def test_sigmas_are_honest():
    scores = []
    for seed in range(12):
        poses, imu, _ = recording(seed, 20.0, 60.0, position=1e-4)
        fit = fit_tracker(poses, {'imu0': imu})['imu0']
        scores.append((errors_of(fit) / sigmas_of(fit)) ** 2)
    # 84 squares of mean 1: 1 + 4 sqrt(2 / 84). The noise of a derivative cancels over time, which
    # weights that fall with the lag see in part only, so the sigmas may be wide by up to 1.4.
    assert 1 / 1.4**2 < np.mean(scores) < 1.62


def test_drop_outs_and_late_clocks_are_tolerated(rng):
    poses, imu, _ = recording(5)
    lost = rng.random(len(poses.stamp_ns)) < 0.1
    lost[1200:1320] = True  # somebody stood in the way for 1.2 s
    position, R_wt = poses.position_w.copy(), poses.R_wt.copy()
    position[lost] = R_wt[lost] = np.nan
    kept = imu.select(rng.random(len(imu)) > 0.02)
    years = 3 * 10**8 * NANOSECONDS
    late = ImuSamples(kept.stamp_ns - years, kept.angular_rate, kept.specific_force)
    fit = fit_tracker(replace(poses, position_w=position, R_wt=R_wt), {'imu0': late})['imu0']
    fit = replace(fit, time_offset=fit.time_offset - years / NANOSECONDS)
    assert np.all(np.abs(errors_of(fit)[:3]) < np.deg2rad(0.02))
    assert np.all(np.abs(errors_of(fit)[3:6]) < 0.6e-3)
    assert abs(errors_of(fit)[6]) < 50e-6


def test_a_gap_is_nan_and_no_derivative_reaches_across():
    poses, _, _ = recording(5, 10.0)
    position = poses.position_w.copy()
    position[500:560] = np.nan
    motion = differentiate(replace(poses, position_w=position), 0.15, 6)
    lost = ~np.isfinite(motion.acceleration_w).all(axis=1)
    # A window that has lost a third of its 31 poses: up to 10 poses outside the gap survive less.
    assert lost[500:560].all()
    assert 60 <= lost[400:700].sum() <= 80


def test_a_turn_about_one_axis_is_refused_and_the_axis_is_named(rng):
    t = np.arange(1000) / 100
    motion = trajectory('turntable', 10.0)
    poses = tracked(rng, motion, t, 2e-4, np.deg2rad(0.05))
    imu = carried(rng, motion, np.arange(2000) / 200, 1.0)
    axis = R_TS.inv().apply([0.0, 0.0, 1.0])  # of the turn, in the sensor
    axis *= np.sign(axis[np.argmax(np.abs(axis))])
    named = ', '.join(f'{x:.2f}' for x in axis)
    with pytest.raises(CalibrationError, match=r'`imu0` cannot be registered') as caught:
        fit_tracker(poses, {'imu0': imu})
    assert named in str(caught.value)


def test_streams_of_different_motions_are_refused():
    (poses, _, _), (_, imu, _) = recording(1, 20.0), recording(2, 20.0)
    with pytest.raises(SyncError, match='`imu7` fit those of the target at no offset'):
        fit_tracker(poses, {'imu7': imu})


def test_a_recording_that_is_too_short_is_refused():
    poses, imu, _ = recording(1, 10.0, rate_hz=20.0)
    with pytest.raises(CalibrationError, match='200 are needed; record longer'):
        fit_tracker(poses, {'imu0': imu}, TrackerConfig(half_width=0.4, order=4))


def test_correlation_is_over_the_overlap_and_finds_fractions():
    t = np.arange(0.0, 20.0, 0.01)

    def signal(x):  # with a trend, so that means over the whole are no means over a part
        return 3.0 + 0.5 * x + np.sin(x) + 0.5 * np.sin(2.7 * x + 1)

    seen = signal(t)
    seen[400:600] = np.nan  # a gap, over which nothing may be interpolated
    # The second clock starts at 100 s, 2.3456 s late, and its stream is 3 s shorter.
    peak = correlate_rates(t, seen, t[:1700] + 100.0, signal(t[:1700] + 2.3456), 0.5, 'b')
    # A parabola through points 10 ms apart, of a curve with periods of seconds: 1 % of 10 ms.
    assert abs(peak.offset - (2.3456 - 100.0)) < 1e-4
    # Half a step apart at the most, at 1 per second and a spread of 3: 1 - (0.005 / 3)^2.
    assert peak.correlation > 1 - 1e-5


def test_the_correlation_is_that_of_numpy_on_the_overlap(rng):
    a = np.cumsum(rng.standard_normal(400))
    b = a[90:] + 0.5 * rng.standard_normal(310)
    t = np.arange(400.0)  # whole steps, so that nothing is interpolated
    peak = correlate_rates(t, a, t[:310], b, 0.5, 'b')
    assert_allclose(peak.correlation, np.corrcoef(a[90:], b)[0, 1], rtol=1e-9)
    assert abs(peak.offset - 90.0) < 1.0


def test_parts_without_motion_do_not_correlate(rng):
    t = np.arange(1000) / 100
    a, b = np.zeros(1000), np.zeros(1000)
    a[600:800] = b[150:350] = np.convolve(rng.standard_normal(200), np.ones(9), 'same')
    # At lags between, one is still where they overlap: 0/0, or 1 by rounding.
    assert abs(correlate_rates(t, a, t, b, 0.5, 'b').offset - 4.5) < 0.01


def test_bad_input_is_named_in_the_message():
    stamps, eyes = np.arange(3), np.tile(np.eye(3), (3, 1, 1))
    with pytest.raises(ValueError, match=r'must be \(3, 3\) and \(3, 3, 3\) like `stamp_ns`'):
        TrackerPoses(stamps, np.zeros((2, 3)), eyes)
    with pytest.raises(ValueError, match='`stamp_ns` must rise'):
        TrackerPoses(stamps[::-1].copy(), np.zeros((3, 3)), eyes)
    with pytest.raises(ValueError, match=r'`half_width` must be positive.*got 0\.0'):
        TrackerConfig(half_width=0.0)
