"""Microseconds per fused frame: the pipeline and its fusion step, beside a UKF per IMU.

The reference is what one would write with filterpy: an unscented filter of six states (rate and
force, which walk at random) for each IMU, and the mean of their states.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median
import time

from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
import numpy as np

from multiimu_ros.arrays import Vector
from multiimu_ros.fusion.array_fusion import ArrayFusion
from multiimu_ros.fusion.rig_model import rig_model
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.pipeline_config import MOTION
from multiimu_ros.report.tracks import in_order
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate, SimulatedRecording
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.synchronization.synchronizer import Scan, SyncConfig, Synchronizer

COUNTS = (1, 2, 4, 8, 16)
RATE = 200.0  # [Hz]
SECONDS = 6.0  # of recording; four of rest, two of motion
REPEATS = 5
UKF_FRAMES = 40


def microseconds(run: Callable[[], int]) -> float:
    """Return the time per frame, median of the repeats; `run` returns how many it made."""
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        frames = run()
        times.append((time.perf_counter() - begin) / frames * 1e6)
    return median(times)


def rows() -> list[dict[str, object]]:
    result = []
    for count in COUNTS:
        recording = simulate(ring(count), trajectory('hand', SECONDS), RATE)
        rig = calibrated_rig(recording.rig)
        readings = one_by_one(recording)

        def whole(rig=rig, readings=readings) -> int:
            pipeline = Pipeline(rig, PipelineConfig())
            return sum(len(pipeline.push(*reading)) for reading in readings)

        scans = scans_of(recording)

        def step(rig=rig, scans=scans, *, guard: bool) -> int:
            fusion = ArrayFusion(rig_model(rig), replace(MOTION['hand'], guard=guard))
            return sum(fusion.push(scan) is not None for scan in scans)

        whole(), step(guard=True)  # compiles
        guarded = partial(step, guard=True)
        ours, fusion = microseconds(whole), microseconds(guarded)
        bare = microseconds(partial(step, guard=False))
        theirs = microseconds(lambda count=count, scans=scans: ukf_mean(count, scans))
        first = result[0] if result else {'pipeline': ours}
        result.append(
            {
                'IMUs': count,
                'pipeline': ours,
                'beside one IMU': ours / first['pipeline'],
                'fusion step': fusion,
                'without guard': bare,
                'filterpy UKFs': theirs,
                'UKFs / pipeline': theirs / ours,
            }
        )
    return result


def one_by_one(recording: SimulatedRecording) -> list[tuple[int, int, Vector]]:
    imus, stamps, values = in_order(recording.raw)
    return list(zip(imus.tolist(), stamps.tolist(), values, strict=True))


def scans_of(recording: SimulatedRecording) -> list[Scan]:
    synchronizer = Synchronizer(len(recording.raw), SyncConfig())
    return [scan for reading in one_by_one(recording) for scan in synchronizer.push(*reading)]


def ukf_mean(count: int, scans: list[Scan]) -> int:
    filters = []
    for _ in range(count):
        points = MerweScaledSigmaPoints(6, alpha=0.1, beta=2.0, kappa=-3.0)
        ukf = UnscentedKalmanFilter(6, 6, 1 / RATE, lambda x: x, lambda x, _dt: x, points)
        ukf.Q, ukf.R = np.eye(6), np.diag([1e-6] * 3 + [1e-3] * 3)
        filters.append(ukf)
    whole = [scan for scan in scans if np.isfinite(scan.values).all()]
    for scan in whole[:UKF_FRAMES]:
        for ukf, values in zip(filters, scan.values, strict=True):
            ukf.predict()
            ukf.update(values)
        np.mean([ukf.x for ukf in filters], axis=0)
    return UKF_FRAMES
