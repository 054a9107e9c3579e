"""The whole chain in one object: samples of K IMUs in, fused IMU and odometry out.

    calibrate -> register -> synchronise -> fuse -> detect stillness -> attitude, odometry

The fusion node, the pipeline node, `multiimu fuse` and the tests call this and nothing else, so
that the live output and the one from a bag are the same numbers.  No ROS, no clock: time is what
the stamps say.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from multiimu_ros.arrays import Matrix, Stamps, Vector, Vectors
from multiimu_ros.assembly import entrance, navigator
from multiimu_ros.chain import Block, fresh_block, FUSED, note_rest, RESTING, run_scans, STILL
from multiimu_ros.fused_frame import FusedFrame
from multiimu_ros.fusion.age import is_dated
from multiimu_ros.fusion.array_fusion import ArrayFusion
from multiimu_ros.fusion.benefit import Benefit, BenefitMeter
from multiimu_ros.fusion.drift import DriftMonitor
from multiimu_ros.fusion.rig_model import rig_model
from multiimu_ros.odometry.saved_state import Owner, SavedState
from multiimu_ros.pipeline_config import ImuHealth, PipelineConfig, Rest
from multiimu_ros.rig import Rig
from multiimu_ros.synchronization.synchronizer import scan_of

__all__ = ['FusedFrame', 'ImuHealth', 'Pipeline', 'PipelineConfig', 'Rest']

NO_FRAMES: tuple[FusedFrame, ...] = ()  # what nearly every push returns


class Pipeline:
    """The chain on live streams.

    Parameters
    ----------
    rig : Rig
        Everything known about the IMUs.
    config : PipelineConfig
        What comes in, and what the rig is mounted on.

    Attributes
    ----------
    frames, empty_scans : int
        Scans with and without an IMU that could be trusted.
    odometry_config : ErrorStateConfig
        What the odometry was told of rig and motion.
    """

    def __init__(self, rig: Rig, config: PipelineConfig) -> None:
        self._rig = rig
        self._config = config
        self._build()

    def _build(self) -> None:
        self._synchronizer = entrance(self._rig, self._config)
        self._jumps = -1  # before the first scan
        self._saved: SavedState | None = None
        self._weights = np.zeros(len(self._rig.imus))
        self.frames = 0
        self.empty_scans = 0
        self._build_filters(None)

    def _build_filters(self, now_ns: int | None) -> None:
        """Build what believes the rig file's biases as much as their age allows."""
        rig, config = self._rig, self._config
        model = rig_model(rig, now_ns, config.virtual_imu)
        self._fusion = ArrayFusion(model, config.fusion)
        self._drift = DriftMonitor(rig, model)
        self._meter = BenefitMeter(len(rig.imus))
        self._noise_gain = np.ones(len(rig.imus))
        self._navigator, self.odometry_config = navigator(rig, model, config)

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
        due = self._synchronizer.take(imu, stamp_ns, values)
        if not due:
            return NO_FRAMES
        return [
            frame
            for due_ns, rows in due
            for frame in self._advance(np.array([due_ns]), rows[np.newaxis])
        ]

    def push_block(self, imus: Stamps, stamps_ns: Stamps, values: Vectors) -> Iterator[FusedFrame]:
        """Take N readings at once; yield the frames that N calls of `push` return.

        Parameters
        ----------
        imus, stamps_ns : (N,) int arrays
            Index and stamp of each reading [ns].
        values : (N, 6) array
            Angular rate [rad/s], then specific force [m/s^2].
        """
        if self._config.master == 'scaat':  # which asks for the samples of each scan
            for reading in zip(imus.tolist(), stamps_ns.tolist(), values, strict=True):
                yield from self.push(*reading)
            return
        for stamps, scans in self._synchronizer.take_block(imus, stamps_ns, values):
            yield from self._advance(stamps, scans)

    def _advance(self, stamps: Stamps, scans: Matrix) -> Iterator[FusedFrame]:
        """Take scans with stamps (M,) and rows (M, K, 8), between which time does not jump."""
        if len(stamps) and self._synchronizer.time_jumps != self._jumps:
            self._begin(int(stamps[0]))
        block, first = fresh_block(stamps, scans), 0
        while first < len(stamps):
            rest = block.after(first)
            done = self._run(rest) if self._fusion.is_compiled else self._step(rest)
            for n, (fused, still, resting) in enumerate(rest.flags[:done].tolist()):
                if fused:
                    self.frames += 1
                    self._weights = rest.weights[n]
                    row = self._weights, rest.records[n]
                    yield FusedFrame(int(rest.stamp_ns[n]), still, resting, *row)
                else:
                    self.empty_scans += 1
            first += done

    def _run(self, block: Block) -> int:
        """Take scans in one compiled call, until something is due; return how many."""
        due_ns = min(self._fusion.due_ns, self._drift.due_ns)
        navigated, table = self._navigator.is_compiled, np.empty((4, 6))
        done = run_scans(
            *self._fusion.arrays, *self._navigator.arrays, self._meter.state, self._noise_gain,
            due_ns, table, *block,
        )  # fmt: skip
        last = block.after(done - 1)
        if last.flags[0, FUSED] and not navigated:
            self._navigate(last, table)
        self._look_back(last)
        return done

    def _step(self, block: Block) -> int:
        """Take the first scan with a filter that is not compiled; return 1."""
        scan = scan_of(int(block.stamp_ns[0]), block.scans[0])
        one_by_one = self._config.master == 'scaat'
        arrivals = self._synchronizer.arrivals(scan.stamp_ns) if one_by_one else None
        fused = self._fusion.push(scan, arrivals)
        if fused is not None:
            block.weights[0], block.flags[0, FUSED] = fused.weights, True
            self._navigate(block, fused.table)
        self._look_back(block)
        return 1

    def _navigate(self, block: Block, table: Vectors) -> None:
        """Navigate by the first scan of a block, filter by filter."""
        scan = scan_of(int(block.stamp_ns[0]), block.scans[0])
        trusted = np.where(block.weights[0][:, np.newaxis] > 0.0, scan.values, np.nan)
        density = self._fusion.density * np.sqrt(scan.noise_gain)[:, np.newaxis]
        block.records[0], still, resting = self._navigator.push(
            scan.stamp_ns, table, trusted, density
        )
        block.flags[0, STILL], block.flags[0, RESTING] = still, resting
        note_rest(
            self._meter.state, self._noise_gain, scan.values, scan.noise_gain, table[0], resting
        )

    def _look_back(self, block: Block) -> None:
        """Do what is due every now and then, after the first scan of a block."""
        stamp_ns, resting = int(block.stamp_ns[0]), bool(block.flags[0, RESTING])
        if stamp_ns >= self._fusion.due_ns:
            self._fusion.relearn(stamp_ns)
        if block.flags[0, FUSED] and stamp_ns >= self._drift.due_ns:
            self._drift.take(self._fusion.block, stamp_ns, resting)

    def _begin(self, stamp_ns: int) -> None:
        """Age the rig file to the first scan, or forget the motion where time has jumped."""
        if self._jumps >= 0:
            self._fusion.restart()
            self._drift.restart()
            self._navigator.restart()
        elif is_dated(self._rig):
            self._build_filters(stamp_ns)
        if self._saved is not None:
            self._navigator.restore(self._saved, self.odometry_config, stamp_ns)
            self._saved = None
        self._jumps = self._synchronizer.time_jumps

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

    @property
    def owner(self) -> Owner:
        """Whose state `snapshot` returns and `restore` takes."""
        x, y, z = self._config.virtual_imu
        return Owner(self._rig, self._config.profile, (x, y, z))

    def snapshot(self) -> SavedState | None:
        """Return the state of the filters, for a restart; None before the first frame."""
        return self._navigator.snapshot(self.owner)

    def restore(self, state: SavedState) -> None:
        """Go on from the state of a run before, once the first scan is there."""
        self._saved = state

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
        attitude, odometry = self._navigator.attitude, self._navigator.odometry
        common = np.concatenate([attitude.gyro_bias, odometry.accel_bias])
        shared = np.concatenate([np.diag(attitude.P)[3:], np.diag(odometry.P)[12:]])
        offsets, variance = self._drift.rest_offsets()
        rest = Rest(self._navigator.rested_s, self._navigator.rested_ns)
        return offsets + common, variance + len(variance) * shared, rest


def _state(stream: str, fault: str) -> str:
    """Return the state of an IMU in a word: what its stream is, or what the guard thinks."""
    return fault if stream == 'ok' and fault in ('excluded', 'ambiguous') else stream
