"""Simulated motions through detector and filters, with noise that matches the model."""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.odometry.attitude import AttitudeFilter
from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.profiles import odometry_configs, PROFILES
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.zero_velocity import StillnessDetector
from multiimu_ros.simulation.trajectories import make_motion

G = 9.80665
# A calibrated BMI160: 0.007 deg/s/sqrt(Hz), 180 ug/sqrt(Hz); bias to 0.1 deg/s and 3 mg.
RATE_DENSITY, FORCE_DENSITY = np.full(3, 1.2e-4), np.full(3, 1.8e-3)
RATE_BIAS, FORCE_BIAS = np.full(3, 2e-3), np.full(3, 0.03)
RATE_WALK, FORCE_WALK = np.full(3, 4e-6), np.full(3, 1e-4)


@dataclass
class Run:
    """What the filters said at each sample, beside the truth."""

    motion: object
    flags: np.ndarray  # (N, 2) still, resting
    attitude: list  # of (R_nb, gyro_bias, P)
    odometry: list  # of (position, velocity, R_nb, gyro_bias, accel_bias, P)
    gyro_bias: np.ndarray  # (N, 3) truth
    accel_bias: np.ndarray


def read(motion, rng, rate_hz, noise_gain=1.0):
    """Return rates and forces of a noisy IMU on `motion`, and its biases, all (N, 3)."""
    n = len(motion.time)
    walk = rng.standard_normal((2, n, 3)).cumsum(axis=1) / np.sqrt(rate_hz)
    gyro_bias = RATE_BIAS * rng.standard_normal(3) + RATE_WALK * walk[0]
    accel_bias = FORCE_BIAS * rng.standard_normal(3) + FORCE_WALK * walk[1]
    white = noise_gain * np.sqrt(rate_hz) * rng.standard_normal((2, n, 3))
    rate = motion.angular_rate_b + gyro_bias + RATE_DENSITY * white[0]
    force = motion.specific_force_b + accel_bias + FORCE_DENSITY * white[1]
    return rate, force, gyro_bias, accel_bias


def filters(profile):
    """Return detector, attitude and odometry filter for the IMU of `read`."""
    configs = odometry_configs(PROFILES[profile], G, RATE_BIAS, FORCE_BIAS, RATE_WALK, FORCE_WALK)
    return StillnessDetector(configs[0]), AttitudeFilter(configs[1]), ErrorStateFilter(configs[2])


def run(profile, name, duration, rate_hz, seed, noise_gain=1.0):
    """Simulate one recording and filter it."""
    rng = np.random.default_rng(seed)
    motion = make_motion(name, duration, rate_hz, seed)
    rate, force, gyro_bias, accel_bias = read(motion, rng, rate_hz, noise_gain)
    detector, attitude, odometry = filters(profile)
    out = Run(motion, np.empty((len(rate), 2), bool), [], [], gyro_bias, accel_bias)
    densities = noise_gain * RATE_DENSITY, noise_gain * FORCE_DENSITY
    for k, (w, f) in enumerate(zip(rate, force, strict=True)):
        out.flags[k] = detector.push(1 / rate_hz, w, f, *densities)
        attitude.push(Sample(1 / rate_hz, w, f, *densities, *out.flags[k]))
        odometry.push(Sample(1 / rate_hz, w, f, *densities, *out.flags[k]))
        out.attitude.append((attitude.R_nb, attitude.gyro_bias, attitude.P))
        out.odometry.append(
            (
                odometry.position_n,
                odometry.velocity_n,
                odometry.R_nb,
                odometry.gyro_bias,
                odometry.accel_bias,
                odometry.P,
            )
        )
    return out


def to_start_frame(motion):
    """Return attitudes, positions, velocities of the truth with the start's origin and yaw."""
    first = motion.R_nb[0]
    yaw = np.arctan2(first[1, 0], first[0, 0])
    cosine, sine = np.cos(yaw), np.sin(yaw)
    back = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    position = (motion.position_n - motion.position_n[0]) @ back.T
    return back @ motion.R_nb, position, motion.velocity_n @ back.T


def nees(error, covariance):
    """Return the normalised estimation error squared, per axis: 1 on average if honest."""
    return error @ np.linalg.solve(covariance, error) / len(error)
