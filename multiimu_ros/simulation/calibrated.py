"""The rig file that a careful user would have: the truth, but for what a calibration leaves.

The residuals are those that 60 poses of 4 s at 200 Hz leave on BMI160s, near the Cramer-Rao bound;
each `*_sigma` in the file is the sigma that its value was drawn with, so the file is honest.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix
from multiimu_ros.rig import Extrinsics, Imu, Intrinsics, Rig, Triad

MILLI_G = 9.80665e-3  # [m/s^2]


@dataclass(frozen=True, kw_only=True)
class Residuals:
    """Standard deviations of what a calibration leaves.

    Parameters
    ----------
    accelerometer_scale, gyroscope_scale : float
        [-].
    accelerometer_shear, gyroscope_shear : float
        Off-diagonal of the misalignment [rad].
    accelerometer_bias, gyroscope_bias : float
        [m/s^2], [rad/s]; the latter is the rest's noise and a few minutes of bias instability.
    g_sensitivity : float
        [rad/s per m/s^2].
    rotation, lever_arm : float
        Of the registration, per axis [rad], [m].
    """

    accelerometer_scale: float = 35e-6
    accelerometer_shear: float = 0.05e-3
    accelerometer_bias: float = 0.035 * MILLI_G
    gyroscope_scale: float = 50e-6
    gyroscope_shear: float = 0.055e-3
    gyroscope_bias: float = 5e-5
    g_sensitivity: float = np.deg2rad(0.001) / 9.80665
    rotation: float = 5e-5
    lever_arm: float = 5e-5


def calibrated_rig(
    true_rig: Rig,
    seed: int = 0,
    residuals: Residuals = Residuals(),
) -> Rig:
    """Return the rig file of a board whose true rig is known, as a calibration would find it."""
    rng = np.random.default_rng(seed)
    imus = tuple(_calibrate(imu, residuals, rng) for imu in true_rig.imus)
    return true_rig.model_copy(update={'imus': imus})


def _calibrate(imu: Imu, residuals: Residuals, rng: np.random.Generator) -> Imu:
    true = imu.intrinsics or Intrinsics()
    accelerometer = _perturb_triad(
        true.accelerometer,
        residuals.accelerometer_scale,
        residuals.accelerometer_shear * np.triu(np.ones((3, 3)), 1),
        residuals.accelerometer_bias,
        rng,
    )
    gyroscope = _perturb_triad(
        true.gyroscope,
        residuals.gyroscope_scale,
        residuals.gyroscope_shear * (np.ones((3, 3)) - np.eye(3)),
        residuals.gyroscope_bias,
        rng,
    )
    leak_sigma = np.full((3, 3), residuals.g_sensitivity)
    leak = _perturbed('g_sensitivity', true.gyroscope.g_sensitivity, leak_sigma, rng)
    intrinsics = {'accelerometer': accelerometer, 'gyroscope': gyroscope | leak}
    return imu.model_copy(
        update={
            'intrinsics': Intrinsics.model_validate(intrinsics),
            'extrinsics': _perturb_pose(imu.extrinsics or Extrinsics(), residuals, rng),
            'provenance': {'tool': 'multiimu emulator', 'verdict': 'simulated calibration'},
        }
    )


def _perturb_triad(
    true: Triad, scale: float, shear: Matrix, bias: float, rng: np.random.Generator
) -> dict[str, object]:
    return (
        _perturbed('misalignment', true.misalignment, shear, rng)
        | _perturbed('scale', true.scale, np.full(3, scale), rng)
        | _perturbed('bias', true.bias, np.full(3, bias), rng)
    )


def _perturbed(
    key: str, true: object, sigma: Matrix, rng: np.random.Generator
) -> dict[str, object]:
    """Return an estimate of `true` and its sigma, under the keys of the rig file."""
    estimate = np.array(true) + sigma * rng.standard_normal(sigma.shape)
    return {key: estimate.tolist(), f'{key}_sigma': sigma.tolist()}


def _perturb_pose(true: Extrinsics, residuals: Residuals, rng: np.random.Generator) -> Extrinsics:
    tilt = Rotation.from_rotvec(residuals.rotation * rng.standard_normal(3))
    lever_arm = np.full(3, residuals.lever_arm)
    pose = _perturbed('lever_arm', true.lever_arm, lever_arm, rng)
    turn = Rotation.from_quat(true.rotation) * tilt
    pose |= {'rotation': turn.as_quat().tolist(), 'rotation_sigma': (residuals.rotation,) * 3}
    return Extrinsics.model_validate(pose)
