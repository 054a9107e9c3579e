"""Sensor frame to base frame."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from multiimu_ros.registration.transform import mounting, register
from multiimu_ros.rig import Extrinsics, Imu
from multiimu_ros.samples import ImuSamples


def test_at_rest_an_upside_down_imu_reads_plus_g_after_registration():
    upside_down = Imu(name='i', frame_id='a', extrinsics=Extrinsics(rotation=(1, 0, 0, 0)))
    at_rest = ImuSamples(np.array([5]), np.zeros((1, 3)), np.array([[0.0, 0.0, -9.81]]))
    # At rest specific_force_n = [0, 0, +9.81], for gravity_n = [0, 0, -9.81].
    assert_allclose(register(at_rest, upside_down).specific_force, [[0.0, 0.0, 9.81]], atol=1e-12)


def test_rates_and_forces_turn_alike_and_stamps_move_by_the_offset(rng):
    turn = Rotation.from_rotvec([0.3, -0.5, 0.8])
    imu = Imu(
        name='i', frame_id='a', extrinsics=Extrinsics(rotation=turn.as_quat()), time_offset=-0.0025
    )
    rate, force = rng.standard_normal((2, 10, 3))
    registered = register(ImuSamples(np.arange(10) * 10**7, rate, force), imu)
    assert_allclose(registered.angular_rate, turn.apply(rate), rtol=1e-12)
    assert_allclose(registered.specific_force, turn.apply(force), rtol=1e-12)
    assert np.array_equal(registered.stamp_ns, np.arange(10) * 10**7 - 2_500_000)


def test_without_extrinsics_an_imu_sits_in_the_base_frame():
    A, offset_ns = mounting(Imu(name='i', frame_id='a'))
    assert np.array_equal(A, np.eye(6))
    assert offset_ns == 0
