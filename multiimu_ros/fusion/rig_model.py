"""What the rig file says about K IMUs, as arrays in the base frame, for the fusion stage."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fusion.age import bias_ages
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import (
    Extrinsics,
    Imu,
    Intrinsics,
    Noise,
    NOMINAL_BIAS_SIGMA,
    NOMINAL_NOISE,
    NOMINAL_SCALE_SIGMA,
    PerTriad,
    Range,
    Rig,
    Triad,
    ZERO,
)

LEAST_SIGMA = (
    1e-9  # of noise density and bias: zeros, as of a perfect simulation, weigh infinitely
)
NOMINAL_ANGLE_SIGMA = 0.01  # [rad] an IMU soldered and mounted by hand, not registered
# [rad/s per m/s^2] of cheap gyroscopes, 0.05 deg/s per g; their data sheets do not say
NOMINAL_G_SENSITIVITY_SIGMA = 9e-5
# [s] of stamps that nobody checked; and what interpolation leaves at the best
NOMINAL_DELAY_SIGMA, LEAST_DELAY_SIGMA = 5e-4, 2e-5
NOMINAL_ARM_SIGMA, DRAWN_ARM_SIGMA = 0.1, 0.005  # [m] of an unknown mounting; of a drawing


class RigModel(NamedTuple):
    """Columns are base-frame axes, rate then force; a NamedTuple, for the compiled kernels.

    Parameters
    ----------
    density : (K, 6) array
        White noise density [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    bias_variance : (K, 6) array
        Variance of the bias that calibration left [(rad/s)^2], [(m/s^2)^2].
    scale_variance : (K, 6, 6) array
        Variance of each reading per squared true reading: scale, misalignment, mounting [-].
    lever_arms_b : (K, 3) array
        Sensor origins [m].
    response_variance : (K, 6, 6) array
        As `scale_variance`, with what the stated variances leave out; see `response_variance`.
    floor : (K, 6) array
        Variance of a reading beside the others that neither averages out nor depends on the
        motion: the bias instability.
    delay_variance : (K,) array
        Of the instant that a stamp says [s^2].
    to_sensor : (K, 6, 7) array
        [A | c] of the map from a registered reading back to the raw one.
    limits : (K, 6) array
        Full scale of the raw reading [rad/s], [m/s^2]; infinite where the file is silent.
    R_bs : (K, 3, 3) array
        Mounting.
    """

    density: Vectors
    bias_variance: Vectors
    scale_variance: Matrix
    lever_arms_b: Vectors
    response_variance: Matrix
    floor: Vectors
    delay_variance: Scalars
    to_sensor: Matrix
    limits: Vectors
    R_bs: Matrix


def rig_model(rig: Rig, now_ns: int | None = None, point_b: Sequence[float] = ZERO) -> RigModel:
    """Collect what the fusion stage must know; blocks that are absent count as nominal.

    Parameters
    ----------
    rig : Rig
        The rig file.
    now_ns : int, optional
        Instant to which dated biases age [ns since 1970]; by default they do not.
    point_b : 3 numbers, optional
        Where the virtual IMU sits, from which lever arms count [m].
    """
    density = np.sqrt(np.stack([_rotated(imu, _density(imu) ** 2) for imu in rig.imus]))
    bias_variance = np.stack([_rotated(imu, _bias_variance(imu, now_ns)) for imu in rig.imus])
    return RigModel(
        np.maximum(density, LEAST_SIGMA),
        np.maximum(bias_variance, LEAST_SIGMA**2),
        np.stack([_scale_variance(imu) for imu in rig.imus]),
        np.stack([_extrinsics(imu).lever_arm_b for imu in rig.imus]) - np.array(point_b),
        response_variance(rig),
        np.stack([_rotated(imu, _instability(imu) ** 2) for imu in rig.imus]),
        np.array([_delay_sigma(imu) ** 2 for imu in rig.imus]),
        np.stack([_to_sensor(imu) for imu in rig.imus]),
        np.stack([_limits(imu) for imu in rig.imus]),
        np.stack([_extrinsics(imu).R_bs for imu in rig.imus]),
    )


def bare_model(density: Vectors, **known: Matrix) -> RigModel:
    """Return IMUs in one point, aligned and perfect but for white noise, and what is `known`.

    Parameters
    ----------
    density : (K, 6) array
        White noise [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    known : arrays
        Other fields of the model.
    """
    count = len(density)
    perfect = RigModel(
        density,
        bias_variance=np.zeros((count, 6)),
        scale_variance=np.zeros((count, 6, 6)),
        lever_arms_b=np.zeros((count, 3)),
        response_variance=np.zeros((count, 6, 6)),
        floor=np.zeros((count, 6)),
        delay_variance=np.zeros(count),
        to_sensor=np.tile(np.eye(6, 7), (count, 1, 1)),
        limits=np.full((count, 6), np.inf),
        R_bs=np.tile(np.eye(3), (count, 1, 1)),
    )
    return perfect._replace(**known)


def bias_walks(rig: Rig) -> Vectors:
    """Return how fast the variance (K, 6) of each bias grows [(rad/s)^2/s], [(m/s^2)^2/s]."""
    return np.stack([_rotated(imu, _walk(imu) ** 2) for imu in rig.imus])


def bias_walk_density(rig: Rig) -> Vector:
    """Return the driving noise (6,) of the fused bias: that of the mean of K independent walks."""
    walks = bias_walks(rig)
    return np.asarray(np.sqrt(walks.sum(axis=0)) / len(walks))


def response_variance(rig: Rig) -> Matrix:
    """Return the variance (K, 6, 6) of each reading per squared true reading.

    As `RigModel.scale_variance`, with what it leaves out: the g-sensitivity of the gyroscopes,
    and misalignments that the file does not vouch for.
    """
    return np.stack([_response_variance(imu) for imu in rig.imus])


def level_bias_variance(model: RigModel, gravity: float) -> Vectors:
    """Return the variance (K, 6) of the biases of a rig that keeps its inclination.

    What gravity makes of the gyroscopes' g-sensitivity is part of it; without that a filter would
    not believe the bias that it sees at rest.
    """
    variance = model.bias_variance.copy()
    # Whichever axis is up: the mean over the three.
    variance[:, :3] += gravity**2 * model.response_variance[:, :3, 3:].mean(axis=2)
    return variance


def lever_arm_variance(rig: Rig) -> Vectors:
    """Return the variance (K, 3) of the lever arms [m^2]; what the file is silent on is wide."""
    sigmas = []
    for imu in rig.imus:
        known = None if imu.extrinsics is None else imu.extrinsics.lever_arm_sigma
        unknown = NOMINAL_ARM_SIGMA if imu.extrinsics is None else DRAWN_ARM_SIGMA
        sigmas.append((unknown,) * 3 if known is None else known)
    return np.square(sigmas)


def _six(figure: PerTriad) -> Vector:
    return np.array([*figure.gyroscope, *figure.accelerometer])


def _extrinsics(imu: Imu) -> Extrinsics:
    return Extrinsics() if imu.extrinsics is None else imu.extrinsics


def _noise(imu: Imu) -> Noise:
    return NOMINAL_NOISE if imu.noise is None else imu.noise


def _density(imu: Imu) -> Vector:
    return _six(_noise(imu).noise_density)


def _walk(imu: Imu) -> Vector:
    walk = _noise(imu).bias_random_walk or NOMINAL_NOISE.bias_random_walk
    assert walk is not None  # the nominal model is complete
    return _six(walk)


def _instability(imu: Imu) -> Vector:
    """Return the bias instability (6,); where the file is silent, that of a data sheet."""
    instability = _noise(imu).bias_instability or NOMINAL_NOISE.bias_instability
    assert instability is not None  # the nominal model is complete
    return _six(instability)


def _delay_sigma(imu: Imu) -> float:
    return max(imu.time_offset_sigma or NOMINAL_DELAY_SIGMA, LEAST_DELAY_SIGMA)


def _to_sensor(imu: Imu) -> Matrix:
    """Return [A | c] (6, 7) that undoes calibration and mounting."""
    A, c = affine(imu.intrinsics)
    mounted, _ = mounting(imu)
    inverse = np.linalg.inv(A)
    return np.column_stack([inverse @ mounted.T, -inverse @ c])


def _limits(imu: Imu) -> Vector:
    full_scale = Range() if imu.range is None else imu.range
    gyroscope, accelerometer = full_scale.gyroscope, full_scale.accelerometer
    return np.repeat([gyroscope or np.inf, accelerometer or np.inf], 3)


def _rotated(imu: Imu, variance: Vector) -> Vector:
    """Return the base-frame variances (6,) of independent sensor-frame ones (6,)."""
    square = _extrinsics(imu).R_bs ** 2
    return np.concatenate([square @ variance[:3], square @ variance[3:]])


def _bias_variance(imu: Imu, now_ns: int | None) -> Vector:
    """Return the variance of what calibration left of the bias, drift since then included.

    It walks away with age, but not beyond what a sensor that nobody calibrated may have.
    """
    instability = _noise(imu).bias_instability
    drift = np.zeros(6) if instability is None else _six(instability)
    intrinsics = Intrinsics() if imu.intrinsics is None else imu.intrinsics
    triads = (intrinsics.gyroscope, intrinsics.accelerometer)
    nominal = (NOMINAL_BIAS_SIGMA.gyroscope, NOMINAL_BIAS_SIGMA.accelerometer)
    sigma = np.concatenate(
        [known if triad.bias_sigma is None else triad.bias_sigma
         for triad, known in zip(triads, nominal, strict=True)]
    )  # fmt: skip
    limit = np.maximum(sigma, _six(NOMINAL_BIAS_SIGMA)) ** 2
    aged = sigma**2 + _walk(imu) ** 2 * np.repeat(bias_ages(imu, now_ns), 3)
    return np.asarray(np.minimum(aged, limit) + drift**2)


def _scale_variance(imu: Imu) -> Matrix:
    intrinsics = Intrinsics() if imu.intrinsics is None else imu.intrinsics
    square = _extrinsics(imu).R_bs ** 2
    variance = np.zeros((6, 6))
    for block, triad, nominal in (
        (slice(0, 3), intrinsics.gyroscope, NOMINAL_SCALE_SIGMA.gyroscope),
        (slice(3, 6), intrinsics.accelerometer, NOMINAL_SCALE_SIGMA.accelerometer),
    ):
        variance[block, block] = square @ _triad_variance(triad, nominal) @ square.T
        variance[block, block] += _mounting_variance(_extrinsics(imu))
    return variance


def _response_variance(imu: Imu) -> Matrix:
    intrinsics = Intrinsics() if imu.intrinsics is None else imu.intrinsics
    square = _extrinsics(imu).R_bs ** 2
    variance = _scale_variance(imu)
    for block, triad in (
        (slice(0, 3), intrinsics.gyroscope),
        (slice(3, 6), intrinsics.accelerometer),
    ):
        if triad.misalignment_sigma is None:
            skewed = NOMINAL_ANGLE_SIGMA**2 * (1.0 - np.eye(3))
            variance[block, block] += square @ skewed @ square.T
    known = intrinsics.gyroscope.g_sensitivity_sigma
    leak = np.full((3, 3), NOMINAL_G_SENSITIVITY_SIGMA) if known is None else np.array(known)
    variance[:3, 3:] = square @ leak**2 @ square.T
    return variance


def _triad_variance(triad: Triad, nominal_scale_sigma: tuple[float, ...]) -> Matrix:
    scale_sigma = nominal_scale_sigma if triad.scale_sigma is None else triad.scale_sigma
    variance = np.diag(np.square(scale_sigma))
    if triad.misalignment_sigma is not None:
        variance += np.square(triad.misalignment_sigma)
    return variance


def _mounting_variance(extrinsics: Extrinsics) -> Matrix:
    """Return the variance of axis a per squared reading of axis c when the mounting is tilted."""
    sigma = extrinsics.rotation_sigma
    x, y, z = np.square((NOMINAL_ANGLE_SIGMA,) * 3 if sigma is None else sigma)
    return np.array([[0.0, z, y], [z, 0.0, x], [y, x, 0.0]])
