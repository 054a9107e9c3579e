"""What is wrong with an IMU: the errors of a class of sensors, of one unit, and of each sample.

A class (`BMI160`, `MPU9150`) says how noisy its sensors are and how much units differ; `draw_unit`
draws one unit's intrinsics.  They follow the convention of the rig file, so that a calibration
that found them exactly would undo them exactly:

    raw = bias + inv(misalignment) @ (true + g_sensitivity @ force) / scale + noise,

rounded to the sensor's steps and cut off at its range.  The noise is white, plus flicker, plus a
random walk, of the two-sided power densities N^2, B^2 / (2 pi f) and (K / (2 pi f))^2: in Allan
deviations N / sqrt(tau), a flat 0.664 B, and K sqrt(tau / 3).
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Matrix, Vectors
from multiimu_ros.rig import Intrinsics, Noise, PerTriad, Triad

DEGREE = np.pi / 180
STANDARD_GRAVITY = 9.80665  # [m/s^2], the unit g of data sheets
INT16_MAX = 32767


@dataclass(frozen=True, kw_only=True)
class TriadErrors:
    """Errors of three like axes; u stands for rad/s or m/s^2.

    Parameters
    ----------
    noise_density, bias_instability, bias_random_walk : float
        White noise [u/sqrt(Hz)], flicker B [u], driving noise of the bias [u/s/sqrt(Hz)].
    bias_sigma, scale_sigma, misalignment_sigma : float
        Spread from unit to unit [u], [-], [rad].
    step : float
        Quantisation [u/LSB]; 0 for none.
    limit : float
        Full scale [u].
    """

    noise_density: float = 0.0
    bias_instability: float = 0.0
    bias_random_walk: float = 0.0
    bias_sigma: float = 0.0
    scale_sigma: float = 0.0
    misalignment_sigma: float = 0.0
    step: float = 0.0
    limit: float = np.inf


@dataclass(frozen=True, kw_only=True)
class ImuErrors:
    """Errors of a class of IMUs; `g_sensitivity_sigma` is in [rad/s per m/s^2]."""

    model: str
    gyroscope: TriadErrors
    accelerometer: TriadErrors
    g_sensitivity_sigma: float = 0.0


# Bosch BST-BMI160-DS000, table 1 (noise, offsets, scale, cross axis), at 2000 deg/s and 8 g.
BMI160 = ImuErrors(
    model='BMI160',
    gyroscope=TriadErrors(
        noise_density=0.007 * DEGREE,
        bias_instability=8 / 3600 * DEGREE,
        bias_random_walk=1e-6,
        bias_sigma=1.0 * DEGREE,
        scale_sigma=0.01,
        misalignment_sigma=0.005,
        step=DEGREE / 16.4,
        limit=INT16_MAX * DEGREE / 16.4,
    ),
    accelerometer=TriadErrors(
        noise_density=180e-6 * STANDARD_GRAVITY,
        bias_instability=40e-6 * STANDARD_GRAVITY,
        bias_random_walk=2e-5,
        bias_sigma=0.02 * STANDARD_GRAVITY,
        scale_sigma=0.005,
        misalignment_sigma=0.005,
        step=STANDARD_GRAVITY / 4096,
        limit=INT16_MAX * STANDARD_GRAVITY / 4096,
    ),
    g_sensitivity_sigma=0.05 * DEGREE / STANDARD_GRAVITY,
)

# InvenSense PS-MPU-9150A, tables 6.1 and 6.2, at 2000 deg/s and 8 g.
MPU9150 = ImuErrors(
    model='MPU9150',
    gyroscope=TriadErrors(
        noise_density=0.005 * DEGREE,
        bias_instability=15 / 3600 * DEGREE,
        bias_random_walk=2e-6,
        bias_sigma=5.0 * DEGREE,
        scale_sigma=0.015,
        misalignment_sigma=0.01,
        step=DEGREE / 16.4,
        limit=INT16_MAX * DEGREE / 16.4,
    ),
    accelerometer=TriadErrors(
        noise_density=400e-6 * STANDARD_GRAVITY,
        bias_instability=80e-6 * STANDARD_GRAVITY,
        bias_random_walk=4e-5,
        bias_sigma=0.05 * STANDARD_GRAVITY,
        scale_sigma=0.015,
        misalignment_sigma=0.01,
        step=STANDARD_GRAVITY / 4096,
        limit=INT16_MAX * STANDARD_GRAVITY / 4096,
    ),
    g_sensitivity_sigma=0.05 * DEGREE / STANDARD_GRAVITY,
)

PERFECT = ImuErrors(model='perfect', gyroscope=TriadErrors(), accelerometer=TriadErrors())


def draw_unit(errors: ImuErrors, rng: np.random.Generator) -> Intrinsics:
    """Draw what one unit of the class is like, as a rig file would hold it.

    The accelerometer's axes define the sensor frame, which leaves its misalignment upper
    triangular; the gyroscope's axes are free in that frame.
    """
    sensitivity = errors.g_sensitivity_sigma * rng.standard_normal((3, 3))
    upper, off_diagonal = np.triu(np.ones((3, 3)), 1), np.ones((3, 3)) - np.eye(3)
    gyroscope = _draw_triad(errors.gyroscope, off_diagonal, rng)
    return Intrinsics.model_validate(
        {
            'accelerometer': _draw_triad(errors.accelerometer, upper, rng),
            'gyroscope': gyroscope | {'g_sensitivity': sensitivity.tolist()},
        }
    )


def _draw_triad(
    errors: TriadErrors, free: Matrix, rng: np.random.Generator
) -> dict[str, list[object]]:
    skewed = np.eye(3) + errors.misalignment_sigma * free * rng.standard_normal((3, 3))
    return {
        'misalignment': skewed.tolist(),
        'scale': (1 + errors.scale_sigma * rng.standard_normal(3)).tolist(),
        'bias': (errors.bias_sigma * rng.standard_normal(3)).tolist(),
    }


def noise_block(errors: ImuErrors) -> Noise:
    """Return the noise of the class as the block of a rig file."""
    figures = {
        name: PerTriad(
            accelerometer=(getattr(errors.accelerometer, name),) * 3,
            gyroscope=(getattr(errors.gyroscope, name),) * 3,
        )
        for name in ('noise_density', 'bias_instability', 'bias_random_walk')
    }
    return Noise(**figures)


def apply_errors(
    angular_rate: Vectors,
    specific_force: Vectors,
    rate_hz: float,
    errors: ImuErrors,
    unit: Intrinsics,
    *,
    rng: np.random.Generator,
) -> tuple[Vectors, Vectors]:
    """Return what one unit reads, in SI at nominal scale, when it feels the truth.

    Parameters
    ----------
    angular_rate, specific_force : (N, 3) arrays
        Truth in the sensor frame, at the sensor [rad/s], [m/s^2].
    rate_hz : float
        Sampling rate, which sets the noise of one sample [Hz].
    errors : ImuErrors
        Noise, steps and range.
    unit : Intrinsics
        The unit's own bias, scale, misalignment and g-sensitivity.
    rng : Generator
        Draws the noise.

    Returns
    -------
    angular_rate, specific_force : (N, 3) arrays
        Raw readings [rad/s], [m/s^2].
    """
    leak = specific_force @ np.array(unit.gyroscope.g_sensitivity).T
    felt = (
        (angular_rate + leak, unit.gyroscope, errors.gyroscope),
        (
            specific_force,
            unit.accelerometer,
            errors.accelerometer,
        ),
    )
    rate, force = (_read(truth, triad, own, rate_hz, rng) for truth, triad, own in felt)
    return rate, force


def _read(
    truth: Vectors, triad: Triad, errors: TriadErrors, rate_hz: float, rng: np.random.Generator
) -> Vectors:
    skewed = np.linalg.solve(np.array(triad.misalignment), truth.T).T
    raw = triad.bias + skewed / triad.scale + draw_noise(len(truth), rate_hz, errors, rng)
    if errors.step > 0:
        raw = errors.step * np.round(raw / errors.step)
    return np.asarray(np.clip(raw, -errors.limit, errors.limit))


def draw_noise(
    count: int, rate_hz: float, errors: TriadErrors, rng: np.random.Generator
) -> Vectors:
    """Return white noise, flicker and random walk, `count` samples of three axes (count, 3)."""
    white = errors.noise_density * np.sqrt(rate_hz) * rng.standard_normal((count, 3))
    steps = errors.bias_random_walk / np.sqrt(rate_hz) * rng.standard_normal((count, 3))
    flicker = errors.bias_instability * unit_flicker(count, rng)
    return np.asarray(white + np.cumsum(steps, axis=0) + flicker)


def unit_flicker(count: int, rng: np.random.Generator) -> Vectors:
    """Return noise (count, 3) of two-sided power density 1 / (2 pi f), whatever the rate.

    White noise is shaped in the frequency domain; below 1 / record length there is nothing.
    """
    spectrum = np.fft.rfft(rng.standard_normal((count, 3)), axis=0)
    # The density of unit white noise is 1 per cycle/sample; 1/f has no scale: the rate drops out.
    frequency = np.arange(1, len(spectrum))[:, np.newaxis] / count
    spectrum[1:] *= np.sqrt(1 / (2 * np.pi * frequency))
    spectrum[:1] = 0.0
    return np.asarray(np.fft.irfft(spectrum, n=count, axis=0))
