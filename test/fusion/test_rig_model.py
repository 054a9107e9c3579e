"""What the rig file says, as arrays in the base frame."""

import numpy as np
from numpy.testing import assert_allclose

from multiimu_ros.fusion.rig_model import bias_walk_density, NOMINAL_ANGLE_SIGMA, rig_model
from multiimu_ros.rig import (
    Extrinsics,
    GyroscopeTriad,
    Imu,
    Intrinsics,
    Noise,
    NOMINAL_BIAS_SIGMA,
    NOMINAL_NOISE,
    PerTriad,
    Rig,
    RigFrame,
    Triad,
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


def test_the_mean_of_n_independent_walks_is_root_n_slower():
    one = bias_walk_density(rig_of(Imu(name='a', frame_id='a')))
    four = bias_walk_density(rig_of(*(Imu(name=f'i{k}', frame_id='a') for k in range(4))))
    assert_allclose(four, one / 2.0, rtol=1e-12)
