"""IMUs that keep no common time, and both ways to fuse what they say."""

from dataclasses import dataclass, replace
import time

import numpy as np

from multiimu_ros.arrays import Flags, NANOSECONDS, Scalars, Stamps, Vectors
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.experiments.board import drawn_rig, rms
from multiimu_ros.fusion.array_fusion import ArrayFusion
from multiimu_ros.fusion.rig_model import rig_model
from multiimu_ros.fusion.scaat import ScaatFilter
from multiimu_ros.pipeline_config import MOTION
from multiimu_ros.rig import Rig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import read_imu
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.synchronization.arrivals import Arrivals
from multiimu_ros.synchronization.synchronizer import SyncConfig, Synchronizer

IMUS, RATE_HZ = 8, 200.0
RUNS, DURATION, BEGIN = 3, 10.0, 4.3  # [s]; the motion begins before 4.3 s
SETTLING = 40  # scans that are not scored
SYNCHRONISED, SCAAT, LATEST = 'synchronised', 'SCAAT', 'latest averaged'


@dataclass(frozen=True, kw_only=True)
class Case:
    """How the IMUs are read.

    Parameters
    ----------
    stagger : float
        From one IMU to the next [s].
    jitter, stamp_jitter : float
        Of each scan's instant, which the stamps follow, and of the stamps alone [s].
    dropout : float
        Share of lost samples [-].
    rates_hz : tuple of float
        Rates of the IMUs, in turn; several come with phases of their own [Hz].
    """

    stagger: float = 0.0
    jitter: float = 0.0
    stamp_jitter: float = 0.0
    dropout: float = 0.0
    rates_hz: tuple[float, ...] = (RATE_HZ,)


CASES = {
    'one instant': Case(),
    'staggered 0.4 ms': Case(stagger=4e-4),
    'spread evenly': Case(stagger=1 / RATE_HZ / IMUS),
    'jitter 0.5 ms, told': Case(stagger=4e-4, jitter=5e-4),
    'false stamps 0.5 ms': Case(stagger=4e-4, stamp_jitter=5e-4),
    'a tenth lost': Case(stagger=4e-4, dropout=0.1),
    '100, 200, 333 Hz': Case(rates_hz=(100.0, 200.0, 333.0)),
}


@dataclass(frozen=True)
class Streams:
    """Samples of all IMUs in the order of their stamps, calibrated and turned."""

    arrivals: Arrivals
    rig: Rig
    motion: Trajectory


@dataclass(frozen=True)
class Compared:
    """Errors without their mean, rms over axes: rate [rad/s], force [m/s^2]; age and times [s]."""

    at_scan: dict[str, Scalars]  # (2,)
    now: dict[str, Scalars]  # (2,)
    age: float
    times: dict[str, float]


def make_streams(case: Case, seed: int, duration: float) -> Streams:
    """Draw a board, carry it in a hand, and read it as the case says."""
    rng = np.random.default_rng(seed)
    true = drawn_rig(ring(IMUS), [BMI160] * IMUS, rng)
    rig = calibrated_rig(true, seed)
    motion = trajectory('hand', duration, seed)
    stamps, streams, values = [], [], []
    scans = np.arange(round(duration * RATE_HZ)) / RATE_HZ
    begin: Scalars = scans + case.jitter * rng.standard_normal(len(scans))
    for k, imu in enumerate(rig.imus):
        rate_hz = case.rates_hz[k % len(case.rates_hz)]
        times: Scalars = begin + k * case.stagger
        if len(case.rates_hz) > 1:
            phase = float(rng.random())
            count = round(duration * rate_hz) - 1
            times = np.asarray((np.arange(count) + phase) / rate_hz, np.float64)
        raw = np.hstack(read_imu(true.imus[k], motion.at(times), rate_hz, BMI160, rng))
        A, c = affine(imu.intrinsics)
        kept = (rng.random(len(times)) >= case.dropout) & (times > BEGIN)
        said = times + case.stamp_jitter * rng.standard_normal(len(times))
        stamps.append(np.round(said[kept] * NANOSECONDS).astype(np.int64))
        streams.append(np.full(int(kept.sum()), k))
        values.append((raw @ A.T + c)[kept])  # the ring's IMUs are aligned with the board
    order = np.argsort(np.concatenate(stamps), kind='stable')
    arrivals = Arrivals(
        np.concatenate(stamps)[order],
        np.concatenate(streams)[order],
        np.concatenate(values)[order],
    )
    return Streams(arrivals, rig, motion)


def _part(arrivals: Arrivals, start: int, stop: int) -> Arrivals:
    part = slice(start, stop)
    return Arrivals(arrivals.stamps[part], arrivals.streams[part], arrivals.values[part])


def compare(streams: Streams) -> Compared:
    """Run both paths, and the mean of the latest readings, over the same samples."""
    model, config = rig_model(streams.rig), replace(MOTION['hand'], guard=False)
    synchronizer, fusion = Synchronizer(IMUS, SyncConfig()), ArrayFusion(model, config)
    sigmas = config.angular_acceleration_sigma, config.jerk_sigma
    behind, live = (ScaatFilter(model.density, model.lever_arms_b, *sigmas) for _ in range(2))
    latest = np.full((IMUS, 6), np.nan)
    said: dict[str, list[Vectors]] = {name: [] for name in (SYNCHRONISED, SCAAT, LATEST, 'live')}
    scans, moments, taken, spent = [], [], 0, np.zeros(2)
    begin = int(streams.arrivals.stamps[0])
    rows = zip(*(column.tolist() for column in streams.arrivals), strict=True)
    for n, (stamp, k, values) in enumerate(rows):
        latest[k] = values
        start = time.perf_counter()
        due = synchronizer.push(k, stamp, values)
        fused = [fusion.push(scan) for scan in due]
        spent[0] += time.perf_counter() - start
        for scan, one in zip(due, fused, strict=True):
            trusted = np.repeat(scan.share[:, None], 2, axis=1)
            arrivals = synchronizer.arrivals(scan.stamp_ns)
            said[SCAAT].append(behind.advance(arrivals, fusion.offsets, trusted, scan.stamp_ns)[0])
            start = time.perf_counter()
            new = _part(streams.arrivals, taken, n + 1)
            said['live'].append(
                live.advance(new, np.zeros((IMUS, 6)), np.ones((IMUS, 2)), stamp)[0]
            )
            spent[1] += time.perf_counter() - start
            taken = n + 1
            said[SYNCHRONISED].append(np.full(6, np.nan) if one is None else one.values)
            said[LATEST].append(latest.mean(axis=0))
            scans.append(scan.stamp_ns)
            moments.append(stamp)
    samples = len(streams.arrivals.stamps)
    return _scored(
        streams.motion, np.array(scans), np.array(moments), said, spent / samples, begin
    )


def _scored(
    motion: Trajectory,
    scans: Stamps,
    moments: Stamps,
    said: dict[str, list[Vectors]],
    spent: Scalars,
    begin: int,
) -> Compared:
    settled = np.arange(len(scans)) >= SETTLING
    settled &= scans > begin
    values = {name: np.array(rows) for name, rows in said.items()}
    at_scan, now = (_truth(motion, instants) for instants in (scans, moments))
    return Compared(
        {name: _errors(values[name] - at_scan, settled) for name in (SYNCHRONISED, SCAAT)},
        {
            SYNCHRONISED: _errors(values[SYNCHRONISED] - now, settled),
            SCAAT: _errors(values['live'] - now, settled),
            LATEST: _errors(values[LATEST] - now, settled),
        },
        float(np.mean(moments[settled] - scans[settled])) / NANOSECONDS,
        dict(zip((SYNCHRONISED, SCAAT), spent.tolist(), strict=True)),
    )


def _truth(motion: Trajectory, stamp_ns: Stamps) -> Vectors:
    true = motion.at(stamp_ns / NANOSECONDS)
    return np.hstack([true.angular_rate_b, true.specific_force_b])


def _errors(error: Vectors, settled: Flags) -> Scalars:
    """Return the rms of rate and force without their mean: a common bias is nobody's fault."""
    scored = error[settled & np.isfinite(error).all(axis=1)]
    scored = scored - scored.mean(axis=0)
    return np.array([rms(scored[:, :3]), rms(scored[:, 3:])])
