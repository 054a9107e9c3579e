"""Walks whose strides, heights and sigmas are known, for the tests of their report."""

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.report.walk import Walk

RATE = 100  # frames a second
STANCE, SWING = 0.5, 0.7  # s


def made(position, still, **changes):
    """Return a walk along positions (N, 3), with sigmas that grow linearly, looking along x."""
    count = len(position)
    growing = np.linspace(0.0, 1.0, count)[:, np.newaxis, np.newaxis]
    columns = {
        'stamp_ns': 10**18 + np.arange(count) * (10**9 // RATE),
        'position_n': position,
        'velocity_n': np.gradient(position, 1 / RATE, axis=0),
        'orientation': np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        'position_covariance': growing**2 * np.diag([0.09, 0.16, 0.01]),
        'rotation_covariance': growing**2 * np.diag([1e-6, 1e-6, 1e-4]),
        'gyro_bias': np.full((count, 3), 1e-3),
        'gyro_bias_sigma': np.full((count, 3), 1e-4),
        'accel_bias': np.full((count, 3), 0.02),
        'accel_bias_sigma': np.full((count, 3), 0.01),
        'still': still,
    }
    return Walk(**{**columns, **changes})


def stepping(strides=8, length=1.25, rest=2.0, rise=0.0):
    """Return a foot that rests, walks `strides` along x, each `rise` higher, and rests."""
    begin = rest + STANCE + np.arange(strides) * (SWING + STANCE)
    time = np.arange(round((begin[-1] + SWING + rest) * RATE)) / RATE
    done = np.maximum(np.searchsorted(begin, time, side='right') - 1, 0)
    share = np.clip((time - begin[done]) / SWING, 0.0, 1.0)
    advance = done + 0.5 - 0.5 * np.cos(np.pi * share)
    lift = 0.1 * np.sin(np.pi * share)
    position = np.column_stack([length * advance, 0 * time, lift + rise * advance])
    return made(position, (share == 0.0) | (share == 1.0))


def waved(seconds=10.0, rests=True):
    """Return a hand that turns and moves about its place; without rests it never lies still."""
    time = np.arange(round(seconds * RATE)) / RATE
    swing = 0.2 * np.sin(2 * np.pi * 0.7 * time[:, np.newaxis] + [0.0, 1.0, 2.0])
    still = np.isin(np.arange(len(time)) // RATE, [0, 5]) & rests
    turns = Rotation.from_rotvec(3 * swing)
    return made(swing, still, orientation=turns.as_quat())
