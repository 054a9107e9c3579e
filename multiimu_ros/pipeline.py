"""The whole chain in one object: samples of K IMUs in, fused IMU and odometry out.

    calibrate -> register -> synchronise -> fuse -> detect stillness -> attitude, odometry

The fusion node, the pipeline node, `multiimu fuse` and the tests call this and nothing else, so
that the live output and the one from a bag are the same numbers.  No ROS, no clock: time is what
the stamps say.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from multiimu_ros.arrays import Stamps, Vector, Vectors
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fused_frame import FusedFrame, write_record
from multiimu_ros.fusion.age import is_dated
from multiimu_ros.fusion.array_fusion import ArrayFusion, FusedImu
from multiimu_ros.fusion.benefit import Benefit, BenefitMeter
from multiimu_ros.fusion.drift import DriftMonitor
from multiimu_ros.fusion.rig_model import bias_walk_density, rig_model
from multiimu_ros.odometry.attitude import AttitudeFilter
from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.profiles import odometry_configs, PROFILES
from multiimu_ros.odometry.rest import RestBuffer, Sample
from multiimu_ros.odometry.zero_velocity import StillnessDetector
from multiimu_ros.pipeline_config import ImuHealth, PipelineConfig, Rest
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import Rig
from multiimu_ros.synchronization.synchronizer import Scan, Synchronizer

__all__ = ['FusedFrame', 'ImuHealth', 'Pipeline', 'PipelineConfig', 'Rest']

NO_FRAMES: tuple[FusedFrame, ...] = ()  # what nearly every push returns
GAIN_MEMORY = 1000  # scans that the mean gain of interpolation looks back
FIRST_STEP = 0.005  # [s] stands in for the time since a sample that was never there


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
        model = rig_model(rig, now_ns, config.virtual_imu)
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
        self._fusion = ArrayFusion(model, config.fusion)
        self._drift = DriftMonitor(rig, model)
        self._meter = BenefitMeter(len(rig.imus))
        self._noise_gain = np.ones(len(rig.imus))
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

    def push_block(self, imus: Stamps, stamps_ns: Stamps, values: Vectors) -> Iterator[FusedFrame]:
        """Take N readings at once; yield the frames that N calls of `push` return.

        Parameters
        ----------
        imus, stamps_ns : (N,) int arrays
            Index and stamp of each reading [ns].
        values : (N, 6) array
            Angular rate [rad/s], then specific force [m/s^2].
        """
        scans: Iterable[Scan] = self._synchronizer.push_block(imus, stamps_ns, values)
        if self._config.master == 'scaat':  # which asks for the samples of each scan
            one_by_one = zip(imus.tolist(), stamps_ns.tolist(), values, strict=True)
            scans = (scan for reading in one_by_one for scan in self._synchronizer.push(*reading))
        for scan in scans:
            if (frame := self._step(scan)) is not None:
                yield frame

    def _step(self, scan: Scan) -> FusedFrame | None:
        if self._synchronizer.time_jumps != self._jumps:
            self._begin(scan.stamp_ns)
        one_by_one = self._config.master == 'scaat'
        arrivals = self._synchronizer.arrivals(scan.stamp_ns) if one_by_one else None
        fused = self._fusion.push(scan, arrivals)
        if fused is None:
            self.empty_scans += 1
            return None
        self._weights = fused.weights
        self.frames += 1
        return self._navigate(scan, fused)

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

    def _navigate(self, scan: Scan, fused: FusedImu) -> FusedFrame:
        """Move attitude and odometry on by one fused reading."""
        dt = FIRST_STEP if self._last_ns is None else (fused.stamp_ns - self._last_ns) * 1e-9
        self._last_ns = fused.stamp_ns
        rate, force = fused.values[:3], fused.values[3:]
        densities = fused.density[:3], fused.density[3:]
        attitude, odometry = self._attitude, self._odometry
        still, resting = self._detector.push(
            dt, rate - attitude.gyro_bias, force - odometry.accel_bias, *densities
        )
        self._meter.push(scan.values, fused.values, still=resting)
        if resting:
            self._noise_gain += (scan.noise_gain - self._noise_gain) / GAIN_MEMORY
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
        columns = (self._rig.names, streams, self._weights, drift, self._fusion.faults())
        return tuple(
            ImuHealth(
                name=name,
                state=_state(stream.state, fault.state),
                rate_hz=stream.rate_hz,
                weight=float(weight),
                received=stream.received,
                rejected=stream.backward + stream.invalid + stream.stuck,
                gaps=stream.gaps,
                disagreement=disagreement,
                fault=fault,
            )
            for name, stream, weight, disagreement, fault in zip(*columns, strict=True)
        )

    def benefit(self) -> Benefit:
        """Return the noise of the fused IMU beside that of the single ones, as rests showed it."""
        rate_hz = np.array([stream.rate_hz for stream in self._synchronizer.health()])
        return self._meter.benefit(
            self._fusion.density**2 * (rate_hz * self._noise_gain)[:, np.newaxis]
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


def _state(stream: str, fault: str) -> str:
    """Return the state of an IMU in a word: what its stream is, or what the guard thinks."""
    return fault if stream == 'ok' and fault in ('excluded', 'ambiguous') else stream


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
