"""The constants of the profiles reach the filters."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.odometry.profiles import odometry_configs, PROFILES

RIG = (np.full(3, 5e-3), np.full(3, 0.1), np.full(3, 1e-5), np.full(3, 1e-4))


@pytest.mark.parametrize('name', PROFILES)
def test_profiles_pass_the_rig_on(name):
    detector, attitude, odometry = odometry_configs(PROFILES[name], 9.81, *RIG)
    assert detector.gravity == attitude.gravity == odometry.gravity == 9.81
    assert_allclose([detector.rate_bias_sigma, detector.force_magnitude_sigma], [5e-3, 0.1])
    # Rest is never easier to claim than stillness.
    assert detector.resting_rate_sigma <= detector.angular_rate_sigma
    assert detector.resting_force_sigma <= detector.specific_force_sigma
