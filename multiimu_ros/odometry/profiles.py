"""How a rig moves, in numbers: a foot, a hand, a vehicle.

These constants describe the motion, not the sensors; noise and calibration come from the rig
file, and `odometry_configs` joins the two.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Vector
from multiimu_ros.odometry.attitude import AttitudeConfig
from multiimu_ros.odometry.error_state import ErrorStateConfig
from multiimu_ros.odometry.zero_velocity import GlrtConfig


@dataclass(frozen=True, kw_only=True)
class Profile:
    """One kind of motion; the fields are those of the three configs, see there.

    `zero_velocity_sigma` and `zero_velocity_time` describe the velocity while `still`,
    `still_rate_sigma` and `still_force_sigma` the tremor.
    """

    still_rate_sigma: float
    still_force_sigma: float
    resting_rate_sigma: float
    resting_force_sigma: float
    window_s: float
    resting_s: float
    zero_velocity_sigma: float
    zero_velocity_time: float
    rolling_arm: float
    rolling_height: float
    settling_time: float
    stances_teach: bool
    motion_sigma: float
    motion_reach: float
    motion_velocity_sigma: float
    rate_scale_sigma: float
    force_scale_sigma: float
    learning_strides: float
    swing_share: float


FOOT = Profile(
    # Only their ratio counts, 0.2 rad/s per m/s^2, that of SHOE: `swing_share` sets the level.
    still_rate_sigma=0.36,
    still_force_sigma=1.8,
    # A standing person sways by less; a heel that rises slowly moves by more.
    resting_rate_sigma=0.007,
    resting_force_sigma=0.04,
    window_s=0.025,  # 5 samples at 200 Hz, the published window; a stance lasts 0.3 s
    resting_s=1.0,  # longer than any stance of a walk
    # The ankle of a standing leg goes on by millimetres in a second; what is faster turns the
    # foot about heel or ball, at `rolling_arm` from the instep, and soon turns back.  Feet of the
    # PyShoe trials roll as if the IMU were 0.12 m above the ground, others lower.
    zero_velocity_sigma=0.003,
    zero_velocity_time=0.02,
    rolling_arm=0.15,
    rolling_height=0.04,
    settling_time=0.03,
    stances_teach=False,  # what every swing leaves again would pass for a bias
    motion_sigma=5.0,  # rms of a swing phase
    motion_reach=0.4,  # within a stride of 1.4 m
    motion_velocity_sigma=1.5,  # mean over a stride of a walk at 1.4 m/s
    # What a runner's strikes leave of a cheap IMU's scale, range, bandwidth and g-sensitivity;
    # the first stances tell how much less it is for this IMU and this gait.
    rate_scale_sigma=0.04,
    force_scale_sigma=0.2,
    learning_strides=10.0,
    swing_share=0.16,  # a foot is still while it moves a sixth as much as in its swings
)
HAND = Profile(
    # Held, a hand is never still: only a rig that lies or stands on something is.
    still_rate_sigma=0.004,
    still_force_sigma=0.03,
    resting_rate_sigma=0.004,
    resting_force_sigma=0.03,
    window_s=0.1,  # a hand that moves changes its rate within a tenth of a second
    resting_s=0.5,  # a turning point of a slow sway is over by then
    zero_velocity_sigma=0.005,  # a table that is touched moves by less
    zero_velocity_time=0.05,
    rolling_arm=0.0,  # it does not roll
    rolling_height=0.0,
    settling_time=0.0,
    stances_teach=True,
    motion_sigma=0.5,  # slow handling; fast handling is seen in | |f| - g |
    motion_reach=0.1,  # an arm sways by a decimetre or two
    motion_velocity_sigma=0.5,
    rate_scale_sigma=0.0,
    force_scale_sigma=0.0,
    learning_strides=0.0,
    swing_share=0.0,
)
VEHICLE = Profile(
    # An idling engine shakes the body by a few mrad/s and 0.1 m/s^2.
    still_rate_sigma=0.005,
    still_force_sigma=0.1,
    resting_rate_sigma=0.005,
    resting_force_sigma=0.1,
    window_s=0.25,  # a rolling vehicle feels the road many times in a quarter of a second
    resting_s=1.0,  # the body still pitches for a second after a stop
    zero_velocity_sigma=0.02,  # a body that settles on its springs
    zero_velocity_time=0.2,
    rolling_arm=0.0,
    rolling_height=0.0,
    settling_time=0.0,
    stances_teach=True,
    motion_sigma=1.0,  # braking and turning, most of it level and unseen in | |f| - g |
    motion_reach=100.0,  # 10 m/s that end after 10 s
    motion_velocity_sigma=10.0,
    rate_scale_sigma=0.0,
    force_scale_sigma=0.0,
    learning_strides=0.0,
    swing_share=0.0,
)
PROFILES = {'foot': FOOT, 'hand': HAND, 'vehicle': VEHICLE}


def odometry_configs(
    profile: Profile,
    gravity: float,
    rate_bias_sigma: Vector,
    force_bias_sigma: Vector,
    rate_bias_walk: Vector,
    force_bias_walk: Vector,
    rate_scale_sigma: float = 0.0,
) -> tuple[GlrtConfig, AttitudeConfig, ErrorStateConfig]:
    """Join what is known about motion and rig.

    Parameters
    ----------
    profile : Profile
        The motion.
    gravity : float
        Local gravity [m/s^2].
    rate_bias_sigma, force_bias_sigma : (3,) arrays
        Biases that the calibration leaves in the fused IMU [rad/s], [m/s^2].
    rate_bias_walk, force_bias_walk : (3,) arrays
        Their random walks [rad/s^2/sqrt(Hz)], [m/s^3/sqrt(Hz)].
    rate_scale_sigma : float
        Error of the fused rate per rate that the calibration leaves, for the attitude filter [-].

    Returns
    -------
    GlrtConfig, AttitudeConfig, ErrorStateConfig
        For `StillnessDetector`, `AttitudeFilter`, `ErrorStateFilter`.
    """
    detector = GlrtConfig(
        angular_rate_sigma=profile.still_rate_sigma,
        specific_force_sigma=profile.still_force_sigma,
        resting_rate_sigma=profile.resting_rate_sigma,
        resting_force_sigma=profile.resting_force_sigma,
        rate_bias_sigma=float(np.sqrt(np.mean(np.square(rate_bias_sigma)))),
        force_magnitude_sigma=float(np.sqrt(np.mean(np.square(force_bias_sigma)))),
        window_s=profile.window_s,
        resting_s=profile.resting_s,
        swing_share=profile.swing_share,
        gravity=gravity,
    )
    attitude = AttitudeConfig(
        rate_bias_sigma=rate_bias_sigma,
        force_bias_sigma=force_bias_sigma,
        rate_bias_walk=rate_bias_walk,
        motion_sigma=profile.motion_sigma,
        still_sigma=profile.still_force_sigma,
        motion_reach=profile.motion_reach,
        still_velocity_sigma=profile.zero_velocity_sigma,
        still_velocity_time=profile.zero_velocity_time,
        rolling_arm=profile.rolling_arm,
        rate_scale_sigma=float(np.hypot(profile.rate_scale_sigma, rate_scale_sigma)),
        gravity=gravity,
    )
    odometry = ErrorStateConfig(
        rate_bias_sigma=rate_bias_sigma,
        force_bias_sigma=force_bias_sigma,
        rate_bias_walk=rate_bias_walk,
        force_bias_walk=force_bias_walk,
        zero_velocity_sigma=profile.zero_velocity_sigma,
        zero_velocity_time=profile.zero_velocity_time,
        rolling_arm=profile.rolling_arm,
        rolling_height=profile.rolling_height,
        settling_time=profile.settling_time,
        stances_teach=profile.stances_teach,
        motion_sigma=profile.motion_sigma,
        motion_velocity_sigma=profile.motion_velocity_sigma,
        rate_scale_sigma=profile.rate_scale_sigma,
        force_scale_sigma=profile.force_scale_sigma,
        learning_strides=profile.learning_strides,
        gravity=gravity,
    )
    return detector, attitude, odometry
