"""Readings of an IMU that samples the motion through a low-pass, not at an instant.

A MEMS sensor is read some 1600 times a second inside; what goes beyond its range is lost there,
and a digital filter then makes the output.  Its delay is taken to be known and taken out of the
stamps.  The filter is a Gaussian, which like those of data sheets falls gently and does not ring.
"""

import numpy as np

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.rig import Extrinsics, Imu, Intrinsics
from multiimu_ros.simulation.errors import apply_errors, ImuErrors
from multiimu_ros.simulation.motion import Trajectory

INSIDE_HZ = 1600.0  # at least: how often the sensor itself looks
BANDWIDTH_HZ = 80.0  # -3 dB of a BMI160 at 200 Hz, BST-BMI160-DS000, tables 11 and 13


def read_band_limited(
    imu: Imu,
    trajectory: Trajectory,
    times: Scalars,
    errors: ImuErrors,
    rng: np.random.Generator,
    *,
    bandwidth_hz: float = BANDWIDTH_HZ,
) -> tuple[Vectors, Vectors]:
    """Return the raw angular rate and specific force (N, 3) of one IMU carried along.

    Parameters
    ----------
    imu : Imu
        Its true pose and intrinsics.
    trajectory : Trajectory
        Motion of the base frame.
    times : (N,) array
        Evenly spaced instants of the samples [s].
    errors : ImuErrors
        Noise, steps and range.
    rng : Generator
        Draws the noise.
    bandwidth_hz : float
        At which the power is halved [Hz].
    """
    extrinsics, unit = imu.extrinsics or Extrinsics(), imu.intrinsics or Intrinsics()
    rate_hz = (len(times) - 1) / (times[-1] - times[0])
    ratio = int(np.ceil(INSIDE_HZ / rate_hz))
    kernel = gaussian(bandwidth_hz / (rate_hz * ratio))
    reach = len(kernel) // 2
    inside = times[0] + np.arange(-reach, ratio * (len(times) - 1) + reach + 1) / (rate_hz * ratio)
    motion = trajectory.at(inside)
    rate = motion.angular_rate_b @ extrinsics.R_bs
    force = motion.specific_force_at(extrinsics.lever_arm_b) @ extrinsics.R_bs
    rate = _filtered(rate, errors.gyroscope.limit, kernel, ratio)
    force = _filtered(force, errors.accelerometer.limit, kernel, ratio)
    return apply_errors(rate, force, rate_hz, errors, unit, rng=rng)


def _filtered(felt: Vectors, limit: float, kernel: Scalars, ratio: int) -> Vectors:
    """Return every `ratio`-th value of what the filter makes of what is within range."""
    axes = np.clip(felt, -limit, limit).T
    return np.column_stack([np.convolve(axis, kernel, 'valid')[::ratio] for axis in axes])


def gaussian(bandwidth: float) -> Scalars:
    """Return the kernel (2 M + 1,) whose power is halved at `bandwidth` [cycles/sample]."""
    sigma = np.sqrt(np.log(2.0)) / (2 * np.pi * bandwidth)  # [samples]
    reach = int(np.ceil(4 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    return np.asarray(weights / weights.sum())
