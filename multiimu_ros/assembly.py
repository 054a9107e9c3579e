"""Which filters the chain is made of."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fusion.rig_model import (
    bias_walk_density,
    bias_walks,
    level_bias_variance,
    RigModel,
)
from multiimu_ros.navigation import Navigator
from multiimu_ros.odometry.attitude import AttitudeConfig, AttitudeEstimator, AttitudeFilter
from multiimu_ros.odometry.error_state import ErrorStateConfig, ErrorStateFilter
from multiimu_ros.odometry.federated_odometry import FederatedOdometry
from multiimu_ros.odometry.madgwick import MadgwickAttitude
from multiimu_ros.odometry.profiles import odometry_configs, PROFILES
from multiimu_ros.odometry.rk4_attitude import Rk4Attitude
from multiimu_ros.odometry.seed_scheme import SeedScheme
from multiimu_ros.odometry.zero_velocity import StillnessDetector
from multiimu_ros.pipeline_config import PipelineConfig
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import Rig
from multiimu_ros.synchronization.synchronizer import Synchronizer

ATTITUDES: dict[str, Callable[[AttitudeConfig], AttitudeEstimator]] = {
    'error_state': AttitudeFilter,
    'rk4': Rk4Attitude,
    'madgwick': MadgwickAttitude,
}


def entrance(rig: Rig, config: PipelineConfig) -> Synchronizer:
    """Return the synchroniser, with calibration and registration at its door where still due."""
    maps, offsets_ns = np.zeros((len(rig.imus), 6, 7)), np.zeros(len(rig.imus), dtype=np.int64)
    maps[:, :, :6] = np.eye(6)
    for k, imu in enumerate(rig.imus):
        if config.input == 'raw':
            A, c = affine(imu.intrinsics)
            maps[k] = np.column_stack([A, c])
        if config.input != 'registered':
            R, offsets_ns[k] = mounting(imu)
            maps[k] = R @ maps[k]
    return Synchronizer(len(rig.imus), config.sync, maps, offsets_ns)


def navigator(
    rig: Rig, model: RigModel, config: PipelineConfig
) -> tuple[Navigator, ErrorStateConfig]:
    """Return the navigation of a rig, and what its odometry was told.

    Parameters
    ----------
    rig, model : Rig, RigModel
        The rig, and its noise and biases in the base frame.
    config : PipelineConfig
        What is chosen.
    """
    walk = bias_walk_density(rig)
    bias_variance = level_bias_variance(model, rig.rig.gravity_magnitude)
    bias_sigma = np.sqrt(bias_variance.sum(axis=0)) / len(bias_variance)
    scale = model.scale_variance[:, :3, :3].mean()  # of one IMU, one axis
    detector, attitude, odometry = odometry_configs(
        PROFILES[config.profile],
        gravity=rig.rig.gravity_magnitude,
        rate_bias_sigma=bias_sigma[:3],
        force_bias_sigma=bias_sigma[3:],
        rate_bias_walk=walk[:3],
        force_bias_walk=walk[3:],
        rate_scale_sigma=float(np.sqrt(scale / len(model.scale_variance))),
    )
    filters: dict[str, Callable[[], ErrorStateFilter]] = {
        'error_state': lambda: ErrorStateFilter(odometry),
        'seeds': lambda: SeedScheme(odometry),
        'federated': lambda: FederatedOdometry(
            odometry, model.lever_arms_b, np.sqrt(bias_variance), np.sqrt(bias_walks(rig)),
            model.density,
        ),
    }  # fmt: skip
    detector = replace(detector, detector=config.zero_velocity)
    parts = StillnessDetector(detector), ATTITUDES[config.attitude](attitude)
    return Navigator(*parts, filters[config.odometry](), attitude.resting_lag), odometry
