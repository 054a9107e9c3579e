"""K IMUs on one rig: what each reads, and odometries fed with it."""

from dataclasses import dataclass

import numpy as np
from odometry_runs import (
    FORCE_BIAS,
    FORCE_DENSITY,
    FORCE_WALK,
    G,
    RATE_BIAS,
    RATE_DENSITY,
    RATE_WALK,
    to_start_frame,
)

from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.federated_odometry import FederatedOdometry
from multiimu_ros.odometry.profiles import odometry_configs, PROFILES
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.zero_velocity import StillnessDetector
from multiimu_ros.simulation.trajectories import make_motion

ONE = np.concatenate((RATE_DENSITY, FORCE_DENSITY))
BIAS = np.concatenate((RATE_BIAS, FORCE_BIAS))
WALK = np.concatenate((RATE_WALK, FORCE_WALK))
# Three breakout boards on an instep, off the base by centimetres, so that arms matter.
ARMS = np.array([[0.03, 0.02, 0.0], [0.03, 0.0, 0.01], [0.03, -0.02, 0.0]])


@dataclass
class Board:
    """Readings (N, K, 6) of K IMUs, their biases at the end (K, 6), and the truth."""

    motion: object
    values: np.ndarray
    bias: np.ndarray
    density: np.ndarray  # (K, 6)
    rate_hz: float


def board(name, duration, rate_hz, seed, arms=ARMS, gain=None):
    """Simulate a board; `gain` (K,) multiplies the white noise of each IMU."""
    rng = np.random.default_rng(seed)
    motion = make_motion(name, duration, rate_hz, seed)
    n, count = len(motion.time), len(arms)
    gain = np.ones(count) if gain is None else np.asarray(gain)
    truth = [np.hstack((motion.angular_rate_b, motion.specific_force_at(arm))) for arm in arms]
    walk = WALK * rng.standard_normal((n, count, 6)).cumsum(axis=0) / np.sqrt(rate_hz)
    bias = BIAS * rng.standard_normal((count, 6)) + walk
    density = gain[:, np.newaxis] * ONE
    white = density * np.sqrt(rate_hz) * rng.standard_normal((n, count, 6))
    return Board(motion, np.stack(truth, axis=1) + bias + white, bias[-1], density, rate_hz)


def virtual(some):
    """Return the readings (N, 6) of the IMU at the base that the board makes, and its density.

    The angular acceleration is that of the truth: the lever arms are not what is compared.
    """
    weight = some.density**-2.0 / np.sum(some.density**-2.0, axis=0)
    motion = some.motion
    at_base = some.values.copy()
    for k, arm in enumerate(ARMS[: at_base.shape[1]]):
        at_base[:, k, 3:] -= motion.specific_force_at(arm) - motion.specific_force_b
    return np.sum(weight * at_base, axis=1), np.sum(some.density**-2.0, axis=0) ** -0.5


def configs(profile, count):
    """Return the settings for the virtual IMU of `count` equal ones."""
    bias, walk = BIAS / np.sqrt(count), WALK / np.sqrt(count)
    return odometry_configs(PROFILES[profile], G, bias[:3], bias[3:], walk[:3], walk[3:])


def flags(some, profile):
    """Return still and resting (N, 2), as the detector says of the virtual IMU."""
    values, density = virtual(some)
    detector = StillnessDetector(configs(profile, some.values.shape[1])[0])
    dt = 1 / some.rate_hz
    return np.array([detector.push(dt, v[:3], v[3:], density[:3], density[3:]) for v in values])


def federated(some, profile, arms=ARMS):
    """Return the odometry of a board."""
    count = some.values.shape[1]
    return FederatedOdometry(
        configs(profile, count)[2], arms, np.tile(BIAS, (count, 1)), np.tile(WALK, (count, 1)),
        some.density,
    )  # fmt: skip


def run_federated(some, profile, seen, values=None):
    """Return the odometry at the end, positions (N, 3) and covariances (N, 15, 15)."""
    odometry, states = federated(some, profile), []
    for row, (still, resting) in zip(some.values if values is None else values, seen, strict=True):
        odometry.push_scan(1 / some.rate_hz, row, some.density, still=still, resting=resting)
        states.append((odometry.position_n, odometry.velocity_n, odometry.R_nb, odometry.P))
    return odometry, states


def run_virtual(some, profile, seen):
    """Return the same of the error-state filter on the virtual IMU."""
    odometry, states = ErrorStateFilter(configs(profile, some.values.shape[1])[2]), []
    values, density = virtual(some)
    for row, (still, resting) in zip(values, seen, strict=True):
        sample = Sample(
            1 / some.rate_hz, row[:3], row[3:], density[:3], density[3:], still, resting
        )
        odometry.push(sample)
        states.append((odometry.position_n, odometry.velocity_n, odometry.R_nb, odometry.P))
    return odometry, states


def errors(some, states):
    """Return position errors (N, 3) of a run."""
    return to_start_frame(some.motion)[1] - np.array([state[0] for state in states])
