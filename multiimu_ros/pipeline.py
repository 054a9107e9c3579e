"""The whole chain in one object: samples of K IMUs in, fused IMU and odometry out.

    calibrate -> register -> synchronise -> fuse -> detect stillness -> attitude, odometry

The fusion node, the pipeline node, `multiimu fuse` and the tests call this and nothing else, so
that the live output and the one from a bag are the same numbers.  No ROS, no clock: time is what
the stamps say.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import get_args, Literal

import numpy as np

from multiimu_ros.arrays import Vector, Vectors
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.errors import ConfigError
from multiimu_ros.fused_frame import FusedFrame, write_record
from multiimu_ros.fusion.age import is_dated
from multiimu_ros.fusion.array_fusion import ArrayFusion, ArrayFusionConfig, FusedImu
from multiimu_ros.fusion.drift import Disagreement, DriftMonitor
from multiimu_ros.fusion.rig_model import bias_walk_density, rig_model
from multiimu_ros.odometry.attitude import AttitudeFilter
from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.profiles import odometry_configs, PROFILES
from multiimu_ros.odometry.rest import RestBuffer, Sample
from multiimu_ros.odometry.zero_velocity import StillnessDetector
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import Rig
from multiimu_ros.synchronization.synchronizer import Scan, SyncConfig, Synchronizer

__all__ = ['FusedFrame', 'ImuHealth', 'Pipeline', 'PipelineConfig', 'Rest']

Input = Literal['raw', 'calibrated', 'registered']
ProfileName = Literal['hand', 'foot', 'vehicle']
Local = Literal['kf']
Master = Literal['carlson']

# How fast rate and force may change between two scans: generous, so that the fused IMU has no
# lag; smoothing is left to the filters downstream, which know the motion.
MOTION = {
    'hand': ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0),
    'foot': ArrayFusionConfig(angular_acceleration_sigma=300.0, jerk_sigma=5000.0),
    'vehicle': ArrayFusionConfig(angular_acceleration_sigma=10.0, jerk_sigma=100.0),
}
NO_FRAMES: tuple[FusedFrame, ...] = ()  # what nearly every push returns
FIRST_STEP = 0.005  # [s] stands in for the time since a sample that was never there


@dataclass(frozen=True, kw_only=True)
class PipelineConfig:
    """Settings of the chain.

    Parameters
    ----------
    input : {'raw', 'calibrated', 'registered'}
        What is pushed in: which stages are still to do.
    profile : {'hand', 'foot', 'vehicle'}
        What the rig is mounted on.
    local, master : {'kf'}, {'carlson'}
        Local filter and master filter of the fusion.
    sync : SyncConfig
        Patience and probation of the synchroniser.

    Raises
    ------
    ConfigError
        If a choice is unknown; names those that exist.
    """

    input: Input = 'raw'
    profile: ProfileName = 'hand'
    local: Local = 'kf'
    master: Master = 'carlson'
    sync: SyncConfig = field(default_factory=SyncConfig)

    def __post_init__(self) -> None:
        choices = {'input': Input, 'profile': ProfileName, 'local': Local, 'master': Master}
        for name, literal in choices.items():
            value = getattr(self, name)
            if value not in get_args(literal):
                known = ', '.join(f"'{choice}'" for choice in get_args(literal))
                msg = f'`{name}` must be one of {known}, got {value!r}.'
                raise ConfigError(msg)


@dataclass(frozen=True)
class ImuHealth:
    """State and counters of one IMU, for people to read."""

    name: str
    state: str
    rate_hz: float
    weight: float
    received: int
    rejected: int
    gaps: int
    disagreement: Disagreement


@dataclass(frozen=True)
class Rest:
    """What the gyro bias was learnt from.

    Parameters
    ----------
    seconds : float
        Of rest, all together [s].
    last_ns : int
        Stamp of the last of it [ns]; 0 where there was none.
    """

    seconds: float
    last_ns: int


class Pipeline:
    """The chain on live streams.

    Parameters
    ----------
    rig : Rig
        Everything known about the IMUs.
    config : PipelineConfig
        What comes in, and what the rig is mounted on.
    """

    def __init__(self, rig: Rig, config: PipelineConfig) -> None:
        self._rig = rig
        self._config = config
        self._build()

    def _build(self) -> None:
        self._synchronizer = _entrance(self._rig, self._config)
        self._jumps = -1  # before the first scan
        self._weights = np.zeros(len(self._rig.imus))
        self.frames = 0
        self.empty_scans = 0
        self._build_filters(None)

    def _build_filters(self, now_ns: int | None) -> None:
        """Build what believes the rig file's biases as much as their age allows."""
        rig, config = self._rig, self._config
        model = rig_model(rig, now_ns)
        walk = bias_walk_density(rig)
        bias_sigma = np.sqrt(model.bias_variance.sum(axis=0)) / len(model.bias_variance)
        detector, attitude, odometry = odometry_configs(
            PROFILES[config.profile],
            gravity=rig.rig.gravity_magnitude,
            rate_bias_sigma=bias_sigma[:3],
            force_bias_sigma=bias_sigma[3:],
            rate_bias_walk=walk[:3],
            force_bias_walk=walk[3:],
        )
        self._fusion = ArrayFusion(model, MOTION[config.profile])
        self._drift = DriftMonitor(rig, model)
        self._detector = StillnessDetector(detector)
        self._rest = RestBuffer(attitude.resting_lag)
        self._attitude = AttitudeFilter(attitude)
        self._odometry = ErrorStateFilter(odometry)
        self._last_ns: int | None = None
        self._rested_s, self._rested_ns = 0.0, 0

    def reset(self) -> None:
        """Start anew, as after construction."""
        self._build()

    def push(
        self, imu: int, stamp_ns: int, values: Sequence[float] | Vector
    ) -> Sequence[FusedFrame]:
        """Take one reading; return the frames that became due, usually none or one.

        Parameters
        ----------
        imu : int
            Index of the IMU in the rig file.
        stamp_ns : int
            Stamp of the reading [ns].
        values : 6 numbers
            Angular rate [rad/s], then specific force [m/s^2], as `PipelineConfig.input` says.
        """
        scans = self._synchronizer.push(imu, stamp_ns, values)
        if not scans:
            return NO_FRAMES
        return [frame for scan in scans if (frame := self._step(scan)) is not None]

    def _step(self, scan: Scan) -> FusedFrame | None:
        if self._synchronizer.time_jumps != self._jumps:
            self._begin(scan.stamp_ns)
        fused = self._fusion.push(scan)
        if fused is None:
            self.empty_scans += 1
            return None
        self._weights = fused.weights
        self.frames += 1
        return self._navigate(fused)

    def _begin(self, stamp_ns: int) -> None:
        """Age the rig file to the first scan, or forget the motion where time has jumped."""
        if self._jumps >= 0:
            self._fusion.restart()
            self._drift.restart()
            self._odometry.reset_motion()
            self._rest.clear()
            self._last_ns = None
        elif is_dated(self._rig):
            self._build_filters(stamp_ns)
        self._jumps = self._synchronizer.time_jumps

    def _navigate(self, fused: FusedImu) -> FusedFrame:
        """Move attitude and odometry on by one fused reading."""
        dt = FIRST_STEP if self._last_ns is None else (fused.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = fused.stamp_ns
        rate, force = fused.values[:3], fused.values[3:]
        densities = fused.density[:3], fused.density[3:]
        attitude, odometry = self._attitude, self._odometry
        still, resting = self._detector.push(
            dt, rate - attitude.gyro_bias, force - odometry.accel_bias, *densities
        )
        for sample in self._rest.push(Sample(dt, rate, force, *densities, still, resting)):
            attitude.step(sample)
            odometry.step(sample)
            if sample.resting:
                self._rested_s += sample.dt
                self._rested_ns = fused.stamp_ns
        if fused.stamp_ns >= self._drift.due_ns:
            self._drift.take(self._fusion.block, fused.stamp_ns, resting)
        return self._frame(fused, still)

    def _frame(self, fused: FusedImu, still: bool) -> FusedFrame:
        attitude, odometry = self._attitude, self._odometry
        record = write_record(
            fused.table, attitude.R_nb, attitude.gyro_bias, attitude.P,
            odometry.state, odometry.R_nb, odometry.P,
        )  # fmt: skip
        return FusedFrame(fused.stamp_ns, still, fused.weights, record)

    def set_enabled(self, imu: int, enabled: bool) -> None:
        """Leave one IMU out by hand, or take it back."""
        self._synchronizer.set_enabled(imu, enabled)

    def health(self) -> tuple[ImuHealth, ...]:
        """Return state and counters of every IMU."""
        streams, drift = self._synchronizer.health(), self._drift.disagreements()
        columns = (self._rig.names, streams, self._weights, drift)
        return tuple(
            ImuHealth(
                name=name,
                state=stream.state,
                rate_hz=stream.rate_hz,
                weight=float(weight),
                received=stream.received,
                rejected=stream.backward + stream.invalid + stream.stuck,
                gaps=stream.gaps,
                disagreement=disagreement,
            )
            for name, stream, weight, disagreement in zip(*columns, strict=True)
        )

    @property
    def time_jumps(self) -> int:
        """How often the stamps went back by more than `SyncConfig.jump_s`."""
        return self._synchronizer.time_jumps

    def biases(self) -> tuple[Vectors, Vectors, Rest]:
        """Return what is known of each IMU's bias, in the base frame.

        Returns
        -------
        (K, 6) array
            Bias of rate [rad/s] and force [m/s^2]: what an IMU reads at rest beside the fused one,
            plus the bias of the fused one; NaN for an IMU that has not rested.
        (K, 6) array
            Variance of each, as of K independent errors whose mean has the variance of the fused
            bias; with what gravity makes of scale, which a rest cannot tell from a bias.
        Rest
            What the rate was learnt from.
        """
        common = np.concatenate([self._attitude.gyro_bias, self._odometry.accel_bias])
        shared = np.concatenate([np.diag(self._attitude.P)[3:], np.diag(self._odometry.P)[12:]])
        offsets, variance = self._drift.rest_offsets()
        rest = Rest(self._rested_s, self._rested_ns)
        return offsets + common, variance + len(variance) * shared, rest


def _entrance(rig: Rig, config: PipelineConfig) -> Synchronizer:
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
