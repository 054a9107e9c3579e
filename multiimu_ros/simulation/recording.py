"""A board of imperfect IMUs carried along a motion: what it records, and the truth beside it.

One scan reads the IMUs one after the other, as the firmware does over its multiplexer, so each
has instants of its own.  What the rig file says about an IMU (intrinsics, extrinsics, time
offset) is taken as the truth; intrinsics that it leaves out are drawn.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import NANOSECONDS, Scalars, Stamps, Vectors
from multiimu_ros.rig import Extrinsics, Imu, Intrinsics, Rig
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.errors import apply_errors, BMI160, draw_unit, ImuErrors, noise_block
from multiimu_ros.simulation.motion import Motion, Trajectory

STAGGER = 0.0004  # [s] one BMI160 read over I2C at 400 kHz


@dataclass(frozen=True, kw_only=True)
class Timing:
    """When the IMUs are read, and how well the stamps say so.

    Parameters
    ----------
    stagger : float
        From one IMU to the next in a scan [s].
    sampling_jitter : float
        Sigma of a scan's instant about its schedule [s]; the stamps follow it.
    stamp_jitter : float
        Sigma of each stamp about its instant [s].
    skew_ppm : float
        By how much the clock of the stamps is fast [ppm].
    dropout : float
        Share of samples that each IMU loses [-].
    start_ns : int
        Stamp of time 0 [ns].
    """

    stagger: float = STAGGER
    sampling_jitter: float = 0.0
    stamp_jitter: float = 0.0
    skew_ppm: float = 0.0
    dropout: float = 0.0
    start_ns: int = 1_700_000_000 * NANOSECONDS


@dataclass(frozen=True)
class SimulatedRecording:
    """What the IMUs recorded, and what was true.

    Parameters
    ----------
    rig : Rig
        The true rig: drawn intrinsics, noise of the class, true extrinsics.
    errors : ImuErrors
        The class of the IMUs.
    rate_hz : float
        Scans per second [Hz].
    truth : Motion
        Of the base frame, at the instants at which the scans begin.
    truth_ns : (N,) int array
        Stamps of `truth` on an exact clock [ns].
    raw : tuple of ImuSamples
        Raw readings in SI at nominal scale, one for each IMU of the rig.
    """

    rig: Rig
    errors: ImuErrors
    rate_hz: float
    truth: Motion
    truth_ns: Stamps
    raw: tuple[ImuSamples, ...]


def simulate(
    rig: Rig,
    trajectory: Trajectory,
    rate_hz: float,
    errors: ImuErrors = BMI160,
    seed: int = 0,
    *,
    timing: Timing = Timing(),
) -> SimulatedRecording:
    """Carry a rig along a trajectory and record it.

    Parameters
    ----------
    rig : Rig
        Its IMUs; what it says about them is true.
    trajectory : Trajectory
        Motion of the base frame; its gravity wins over the rig's.
    rate_hz : float
        Scans per second [Hz].
    errors : ImuErrors
        The class of the IMUs.
    seed : int
        Draws the units, their noise, and the timing.
    timing : Timing
        Instants and stamps.
    """
    rng = np.random.default_rng(seed)
    true_rig = _true_rig(rig, errors, trajectory.gravity, rng)
    schedule = np.arange(round(trajectory.duration * rate_hz)) / rate_hz
    begin = schedule + timing.sampling_jitter * rng.standard_normal(len(schedule))
    raw = []
    for k, imu in enumerate(true_rig.imus):
        times = begin + k * timing.stagger
        values = read_imu(imu, trajectory.at(times), rate_hz, errors, rng)
        samples = ImuSamples(_stamps(times, imu, timing, rng), *values)
        raw.append(samples.select(rng.random(len(samples)) >= timing.dropout))
    truth_ns = timing.start_ns + _nanoseconds(begin)
    return SimulatedRecording(
        true_rig, errors, rate_hz, trajectory.at(begin), truth_ns, tuple(raw)
    )


def _true_rig(rig: Rig, errors: ImuErrors, gravity: float, rng: np.random.Generator) -> Rig:
    imus = tuple(
        imu.model_copy(
            update={
                'model': errors.model,
                'intrinsics': imu.intrinsics or draw_unit(errors, rng),
                'noise': noise_block(errors),
                'extrinsics': imu.extrinsics or Extrinsics(),
            }
        )
        for imu in rig.imus
    )
    return rig.model_copy(
        update={'rig': rig.rig.model_copy(update={'gravity': gravity}), 'imus': imus}
    )


def read_imu(
    imu: Imu, motion: Motion, rate_hz: float, errors: ImuErrors, rng: np.random.Generator
) -> tuple[Vectors, Vectors]:
    """Return the raw angular rate and specific force (N, 3) of one IMU carried along `motion`."""
    extrinsics, unit = imu.extrinsics or Extrinsics(), imu.intrinsics or Intrinsics()
    rate_s = motion.angular_rate_b @ extrinsics.R_bs
    force_s = motion.specific_force_at(extrinsics.lever_arm_b) @ extrinsics.R_bs
    return apply_errors(rate_s, force_s, rate_hz, errors, unit, rng=rng)


def _stamps(times: Scalars, imu: Imu, timing: Timing, rng: np.random.Generator) -> Stamps:
    """Return what the clock writes on samples taken at `times`; the rig's offset leads back."""
    jitter = timing.stamp_jitter * rng.standard_normal(len(times))
    clock = times * (1 + 1e-6 * timing.skew_ppm) - imu.time_offset + jitter
    return timing.start_ns + _nanoseconds(clock)


def _nanoseconds(seconds: Scalars) -> Stamps:
    return np.round(seconds * NANOSECONDS).astype(np.int64)
