"""What the rig file says, as arrays in the base frame."""

import numpy as np
from numpy.testing import assert_allclose

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fusion.rig_model import (
    bare_model,
    bias_walk_density,
    LEAST_DELAY_SIGMA,
    level_bias_variance,
    lever_arm_variance,
    NOMINAL_ANGLE_SIGMA,
    NOMINAL_DELAY_SIGMA,
    rig_model,
)
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import (
    Extrinsics,
    GyroscopeTriad,
    Imu,
    Intrinsics,
    Noise,
    NOMINAL_BIAS_SIGMA,
    NOMINAL_NOISE,
    PerTriad,
    Range,
    Rig,
    RigFrame,
    Triad,
    ZERO,
)

QUARTER_TURN = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))  # about z: sensor x is base y


def rig_of(*imus):
    return Rig(version=1, rig=RigFrame(name='test'), imus=imus)


def test_an_unknown_imu_is_as_good_as_the_data_sheet_says():
    model = rig_model(rig_of(Imu(name='imu0', frame_id='a')))
    assert_allclose(model.density[0, 3:], NOMINAL_NOISE.noise_density.accelerometer, rtol=1e-12)
    drift = NOMINAL_NOISE.bias_instability.gyroscope[0]
    assert_allclose(model.bias_variance[0, 0], NOMINAL_BIAS_SIGMA.gyroscope[0] ** 2 + drift**2)
    assert_allclose(model.scale_variance[0, 0, 1], NOMINAL_ANGLE_SIGMA**2, rtol=1e-12)
    assert (model.lever_arms_b == 0.0).all()


def test_variances_turn_with_the_mounting():
    noise = Noise(
        noise_density=PerTriad(accelerometer=(1.0, 2.0, 3.0), gyroscope=(4.0, 5.0, 6.0)),
    )
    intrinsics = Intrinsics(
        accelerometer=Triad(bias_sigma=(0.1, 0.2, 0.3), scale_sigma=(1e-3, 2e-3, 3e-3)),
        gyroscope=GyroscopeTriad(
            bias_sigma=(1.0, 2.0, 3.0),
            misalignment_sigma=((0.0, 0.5, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ),
    )
    extrinsics = Extrinsics(rotation=QUARTER_TURN, rotation_sigma=(0.0, 0.0, 0.0))
    imu = Imu(name='i', frame_id='a', noise=noise, intrinsics=intrinsics, extrinsics=extrinsics)
    model = rig_model(rig_of(imu))
    assert_allclose(model.density[0], [5.0, 4.0, 6.0, 2.0, 1.0, 3.0], rtol=1e-12)
    assert_allclose(model.bias_variance[0], [4.0, 1.0, 9.0, 0.04, 0.01, 0.09], rtol=1e-12)
    assert_allclose(np.diag(model.scale_variance[0])[3:], [4e-6, 1e-6, 9e-6], rtol=1e-12)
    assert_allclose(model.scale_variance[0, 1, 0], 0.25, rtol=1e-9)  # x on y, turned: y on x


def test_what_gravity_makes_of_the_g_sensitivity_counts_as_bias_of_a_level_rig():
    leak = ((0.0, 0.0, 3e-4), (0.0, 0.0, 0.0), (0.0, 0.0, 3e-4))
    gyroscope = GyroscopeTriad(bias_sigma=(1e-3,) * 3, g_sensitivity_sigma=leak)
    noise = Noise(
        noise_density=NOMINAL_NOISE.noise_density,
        bias_instability=PerTriad(accelerometer=ZERO, gyroscope=ZERO),
    )
    intrinsics = Intrinsics(gyroscope=gyroscope)
    model = rig_model(rig_of(Imu(name='i', frame_id='a', noise=noise, intrinsics=intrinsics)))
    variance = level_bias_variance(model, 10.0)
    # Which of the three axes is up is not known: a third of (3e-4 * 10)^2.
    assert_allclose(variance[0, :3], [4e-6, 1e-6, 4e-6], rtol=1e-9)
    assert_allclose(variance[0, 3:], model.bias_variance[0, 3:], rtol=0)


def test_the_mean_of_n_independent_walks_is_root_n_slower():
    one = bias_walk_density(rig_of(Imu(name='a', frame_id='a')))
    four = bias_walk_density(rig_of(*(Imu(name=f'i{k}', frame_id='a') for k in range(4))))
    assert_allclose(four, one / 2.0, rtol=1e-12)


def test_a_reading_of_the_base_frame_leads_back_to_the_raw_one():
    intrinsics = Intrinsics(
        accelerometer=Triad(scale=(1.01, 0.99, 1.02), bias=(0.1, -0.2, 0.3)),
        gyroscope=GyroscopeTriad(
            misalignment=((1.0, 0.01, 0.0), (0.0, 1.0, 0.02), (0.0, 0.0, 1.0)),
            bias=(0.01, 0.02, -0.03),
            g_sensitivity=((1e-3, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ),
    )
    imu = Imu(
        name='i', frame_id='a', intrinsics=intrinsics, extrinsics=Extrinsics(rotation=QUARTER_TURN)
    )
    raw = np.array([0.3, -0.4, 0.5, 1.0, 2.0, 9.0])
    A, c = affine(intrinsics)
    R, _ = mounting(imu)
    registered = R @ np.column_stack([A, c]) @ np.append(raw, 1.0)
    to_sensor = rig_model(rig_of(imu)).to_sensor[0]
    assert_allclose(to_sensor @ np.append(registered, 1.0), raw, rtol=1e-12)


def test_a_range_limits_the_triads_that_it_names():
    imus = [Imu(name='i0', frame_id='a', range=Range(gyroscope=8.7)), Imu(name='i1', frame_id='a')]
    limits = rig_model(rig_of(*imus)).limits
    assert_allclose(limits[0], [8.7] * 3 + [np.inf] * 3)
    assert np.isinf(limits[1]).all()


def test_what_the_file_knows_of_the_stamps_is_believed_but_not_beyond_interpolation():
    sigmas = (None, 1e-4, 1e-7)
    imus = [Imu(name=f'i{k}', frame_id='a', time_offset_sigma=s) for k, s in enumerate(sigmas)]
    variance = rig_model(rig_of(*imus)).delay_variance
    assert_allclose(np.sqrt(variance), [NOMINAL_DELAY_SIGMA, 1e-4, LEAST_DELAY_SIGMA], rtol=1e-12)


def test_what_averages_out_never_is_the_bias_instability_in_base_axes():
    figure = PerTriad(accelerometer=(1.0, 2.0, 3.0), gyroscope=(4.0, 5.0, 6.0))
    noise = NOMINAL_NOISE.model_copy(update={'bias_instability': figure})
    imu = Imu(name='i', frame_id='a', noise=noise, extrinsics=Extrinsics(rotation=QUARTER_TURN))
    assert_allclose(rig_model(rig_of(imu)).floor[0], [25, 16, 36, 4, 1, 9], rtol=1e-12)


def test_lever_arms_count_from_the_virtual_imu():
    imu = Imu(name='i', frame_id='a', extrinsics=Extrinsics(lever_arm=(0.1, 0.2, 0.3)))
    arms = rig_model(rig_of(imu), point_b=(0.1, 0.0, 0.05)).lever_arms_b
    assert_allclose(arms, [[0.0, 0.2, 0.25]], rtol=1e-12, atol=1e-15)


def test_a_bare_model_is_perfect_but_for_what_is_known():
    model = bare_model(np.ones((2, 6)), lever_arms_b=np.ones((2, 3)))
    assert_allclose(model.to_sensor[1], np.eye(6, 7))
    assert np.isinf(model.limits).all()
    assert (model.lever_arms_b == 1.0).all()
    for name in ('bias_variance', 'floor', 'response_variance', 'delay_variance'):
        assert not getattr(model, name).any()


def test_an_unknown_lever_arm_is_wide_and_a_drawn_one_less_so():
    drawn = Extrinsics(lever_arm=(0.1, 0.0, 0.0))
    known = Extrinsics(lever_arm=(0.1, 0.0, 0.0), lever_arm_sigma=(1e-3, 2e-3, 3e-3))
    poses = (None, drawn, known)
    imus = [Imu(name=f'i{k}', frame_id='a', extrinsics=pose) for k, pose in enumerate(poses)]
    sigma = np.sqrt(lever_arm_variance(rig_of(*imus)))
    assert_allclose(sigma, [[0.1] * 3, [0.005] * 3, [1e-3, 2e-3, 3e-3]], rtol=1e-12)
