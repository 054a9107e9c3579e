"""A simulated board whose IMUs are all read at the same instants, and the array fusion over it.

Without stagger and jitter nothing is interpolated: what an experiment shows is of the sensors
and the filters alone.  The IMUs of a board may be of different classes.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from multiimu_ros.arrays import NANOSECONDS, Stamps, Vectors
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fusion.array_fusion import ArrayFusion, ArrayFusionConfig
from multiimu_ros.fusion.rig_model import rig_model
from multiimu_ros.pipeline_config import MOTION
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import Rig
from multiimu_ros.simulation.errors import draw_unit, ImuErrors, noise_block
from multiimu_ros.simulation.motion import Motion
from multiimu_ros.simulation.recording import read_imu
from multiimu_ros.synchronization.synchronizer import Scan

Readings = NDArray[np.float64]  # (N, K, 6): rate [rad/s], then force [m/s^2], of K IMUs
Progress = Callable[[float], None]  # is told the share that is done [-]
DEGREE = np.pi / 180


def drawn_rig(rig: Rig, errors: Sequence[ImuErrors], rng: np.random.Generator) -> Rig:
    """Return the rig with units of the given classes, one class per IMU."""
    imus = tuple(
        imu.model_copy(
            update={
                'model': own.model,
                'intrinsics': draw_unit(own, rng),
                'noise': noise_block(own),
            }
        )
        for imu, own in zip(rig.imus, errors, strict=True)
    )
    return rig.model_copy(update={'imus': imus})


def without_intrinsics(rig: Rig) -> Rig:
    """Return the rig file of a board that nobody calibrated: poses and noise are known."""
    imus = tuple(imu.model_copy(update={'intrinsics': None}) for imu in rig.imus)
    return rig.model_copy(update={'imus': imus})


def part_of(rig: Rig, chosen: Sequence[int]) -> Rig:
    """Return the rig with the chosen IMUs only."""
    return rig.model_copy(update={'imus': tuple(rig.imus[k] for k in chosen)})


def record(
    rig: Rig,
    motion: Motion,
    rate_hz: float,
    errors: Sequence[ImuErrors],
    rng: np.random.Generator,
) -> Readings:
    """Return the raw readings (N, K, 6) of a true rig carried along `motion`."""
    pairs = [
        np.hstack(read_imu(imu, motion, rate_hz, own, rng))
        for imu, own in zip(rig.imus, errors, strict=True)
    ]
    return np.stack(pairs, axis=1)


def registered(rig: Rig, raw: Readings) -> Readings:
    """Return the readings calibrated and turned into the base frame, as the rig file says."""
    values = np.empty_like(raw)
    for k, imu in enumerate(rig.imus):
        A, c = affine(imu.intrinsics)
        turn = mounting(imu)[0]
        values[:, k] = raw[:, k] @ (turn @ A).T + turn @ c
    return values


def instants(count: int, rate_hz: float) -> Stamps:
    """Return stamps (N,) at even spacing [ns]."""
    return np.round(np.arange(count) * (NANOSECONDS / rate_hz)).astype(np.int64)


def fuse(
    rig: Rig,
    values: Readings,
    rate_hz: float,
    *,
    motion: ArrayFusionConfig = MOTION['hand'],
    arms: bool = True,
) -> Vectors:
    """Return what the fusion stage makes of registered readings, (N, 6).

    The guard is off: no IMU is faulty, and it would take arms that are left in for a fault.

    Parameters
    ----------
    rig : Rig
        What the rig file says of the IMUs.
    values : (N, K, 6) array
        Registered readings.
    rate_hz : float
        Scans per second [Hz].
    motion : ArrayFusionConfig
        How the rig may move.
    arms : bool
        Whether lever arms are taken out; without, the force is that of the centroid.
    """
    model = rig_model(rig)
    if not arms:
        model = model._replace(lever_arms_b=np.zeros_like(model.lever_arms_b))
    fusion = ArrayFusion(model, replace(motion, guard=False))
    ones = np.ones(len(rig.imus))
    fused = np.full((len(values), 6), np.nan)
    for k, stamp_ns in enumerate(instants(len(values), rate_hz).tolist()):
        one = fusion.push(Scan(stamp_ns, values[k], ones, ones))
        if one is not None:
            fused[k] = one.values
    return fused


def rms(
    values: NDArray[np.float64], axis: int | tuple[int, ...] | None = None
) -> NDArray[np.float64]:
    """Return the root mean square."""
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=axis)))
