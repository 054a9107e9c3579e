"""Scans of like IMUs in one point for the tests of the fusion stage."""

import numpy as np

from multiimu_ros.fusion.array_fusion import ArrayFusionConfig
from multiimu_ros.fusion.rig_model import bare_model
from multiimu_ros.synchronization.synchronizer import Scan

CONFIG = ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0)
RATE_HZ = 200.0
STEP_NS = 5_000_000
DENSITY = np.repeat([1.2e-4, 1.8e-3], 3)
SIGMA = DENSITY * np.sqrt(RATE_HZ)


def model_of(count, bias_sigma=0.0, arms=None, density=None):
    return bare_model(
        np.tile(DENSITY, (count, 1)) if density is None else density,
        bias_variance=np.full((count, 6), bias_sigma**2),
        lever_arms_b=np.zeros((count, 3)) if arms is None else arms,
    )


def scan(n, values, share):
    return Scan(n * STEP_NS, values, share, np.ones(len(share)))


def fuse(fusion, readings, share=None):
    """Return fused values and the frames of readings (N, K, 6)."""
    share = np.ones(readings.shape[:2]) if share is None else share
    frames = [fusion.push(scan(n, z, share[n])) for n, z in enumerate(readings)]
    return np.array([frame.values for frame in frames]), frames
