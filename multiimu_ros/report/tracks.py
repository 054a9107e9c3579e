"""What one estimator says over a whole recording, as arrays: the fused array, one IMU, the mean.

A single IMU and the plain mean go through the very same `Pipeline` as the array does, as a rig of
one IMU, so that a comparison shows what the number of IMUs is worth and nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, Stamps, Vectors
from multiimu_ros.calibration.sensor_model import calibrate
from multiimu_ros.pipeline import FusedFrame, Pipeline, PipelineConfig
from multiimu_ros.registration.transform import register
from multiimu_ros.rig import (
    Extrinsics,
    GyroscopeTriad,
    Intrinsics,
    Noise,
    NOMINAL_NOISE,
    Rig,
    Triad,
)
from multiimu_ros.samples import ImuSamples

Block = TypeVar('Block', Triad, GyroscopeTriad, Extrinsics)


@dataclass(frozen=True)
class Track:
    """One estimate at N instants.

    Parameters
    ----------
    stamp_ns : (N,) int array
        Instants [ns].
    angular_rate, specific_force : (N, 3) arrays
        At the base origin [rad/s], [m/s^2].
    R_nb : (N, 3, 3) array
        Attitude of the attitude filter.
    attitude_sigma_n : (N, 3) array
        Its standard deviation about the fixed axes [rad].
    position_n : (N, 3) array
        Of the odometry [m].
    odom_R_nb : (N, 3, 3) array
        Attitude of the odometry, whose yaw the position shares.
    still : (N,) bool array
        Where the rig was taken to have no velocity.
    weights : (N, K) array
        Share of each IMU in the fused rate [-].
    """

    stamp_ns: Stamps
    angular_rate: Vectors
    specific_force: Vectors
    R_nb: Matrix
    attitude_sigma_n: Vectors
    position_n: Vectors
    odom_R_nb: Matrix  # noqa: N815 R_nb is the field's name
    still: Flags
    weights: Matrix

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def between(self, begin_ns: int, end_ns: int) -> 'Track':
        """Return the part from one instant up to and with another."""
        kept = (self.stamp_ns >= begin_ns) & (self.stamp_ns <= end_ns)
        return Track(*(column[kept] for column in vars(self).values()))


def as_track(frames: Sequence[FusedFrame]) -> Track:
    """Return the frames of a pipeline as arrays.

    Raises
    ------
    ValueError
        If there are none.
    """
    if not frames:
        msg = '`frames` must hold at least one fused frame, got none; check the recording.'
        raise ValueError(msg)

    def column(name: str) -> Matrix:
        return np.array([getattr(frame, name) for frame in frames])

    variance = np.diagonal(column('orientation_covariance'), axis1=1, axis2=2)
    return Track(
        np.array([frame.stamp_ns for frame in frames], np.int64),
        column('angular_rate'),
        column('specific_force'),
        Rotation.from_quat(column('orientation')).as_matrix(),
        np.sqrt(np.maximum(variance, 0.0)),  # rounding makes a tiny one negative
        column('position_n'),
        Rotation.from_quat(column('odom_orientation')).as_matrix(),
        column('still').astype(bool),
        column('weights'),
    )


def in_order(recording: Sequence[ImuSamples]) -> tuple[Stamps, Stamps, Vectors]:
    """Return IMU (N,), stamp (N,) [ns] and six values (N, 6) of K recordings, oldest first."""
    stamps = np.concatenate([samples.stamp_ns for samples in recording])
    imus = np.repeat(np.arange(len(recording)), [len(samples) for samples in recording])
    values = np.concatenate(
        [np.hstack([samples.angular_rate, samples.specific_force]) for samples in recording]
    )
    order = np.argsort(stamps, kind='stable')
    return imus[order], stamps[order], values[order]


def fused_track(rig: Rig, raw: Sequence[ImuSamples], config: PipelineConfig) -> Track:
    """Run the readings of K IMUs, as `config.input` says they are, through the pipeline."""
    pipeline = Pipeline(rig, config)
    return as_track(list(pipeline.push_block(*in_order(raw))))


def alone(rig: Rig, k: int) -> Rig:
    """Return the rig of which only IMU k is left."""
    return rig.model_copy(update={'imus': (rig.imus[k],)})


def registered(rig: Rig, raw: Sequence[ImuSamples]) -> tuple[ImuSamples, ...]:
    """Calibrate and register the raw readings of K IMUs."""
    return tuple(
        register(calibrate(samples, imu.intrinsics), imu)
        for samples, imu in zip(raw, rig.imus, strict=True)
    )


def plain_mean(rig: Rig, raw: Sequence[ImuSamples], tolerance_ns: int) -> ImuSamples:
    """Average what all K IMUs read in one scan, after calibration and registration.

    Nothing more: lever arms and the few tenths of a millisecond between the IMUs of a scan are
    left in.  The stamp is the mean stamp.

    Parameters
    ----------
    rig : Rig
        Calibration and registration.
    raw : sequence of ImuSamples
        Raw readings, one for each IMU.
    tolerance_ns : int
        Readings of one scan lie this close after the first IMU's [ns]; scans that lack an IMU
        are left out.
    """
    readings = registered(rig, raw)
    first = readings[0].stamp_ns
    complete = np.ones(len(first), bool)
    picked = []
    for samples in readings:
        index = np.searchsorted(samples.stamp_ns, first - tolerance_ns // 2)
        index = np.minimum(index, len(samples) - 1)
        complete &= np.abs(samples.stamp_ns[index] - first) < tolerance_ns
        picked.append(index)
    pairs = list(zip(readings, picked, strict=True))
    offset = np.mean([samples.stamp_ns[index] - first for samples, index in pairs], axis=0)
    return ImuSamples(
        first + np.round(offset).astype(np.int64),
        np.mean([samples.angular_rate[index] for samples, index in pairs], axis=0),
        np.mean([samples.specific_force[index] for samples, index in pairs], axis=0),
    ).select(complete)


def mean_rig(rig: Rig) -> Rig:
    """Return the rig of one IMU that stands for the plain mean of K like ones.

    Its sigmas and noise are those of the first IMU over sqrt(K); it sits at the base origin, and
    its readings are registered ones.
    """
    factor = 1.0 / np.sqrt(len(rig.imus))
    first = rig.imus[0]
    intrinsics = first.intrinsics or Intrinsics()
    extrinsics = _scaled(first.extrinsics or Extrinsics(), factor)
    aligned = {'rotation': Extrinsics().rotation, 'lever_arm': Extrinsics().lever_arm}
    triads = {
        'gyroscope': _scaled(intrinsics.gyroscope, factor),
        'accelerometer': _scaled(intrinsics.accelerometer, factor),
    }
    changed = {
        'name': 'mean',
        'frame_id': rig.rig.base_frame,
        'intrinsics': intrinsics.model_copy(update=triads),
        'noise': _scaled_noise(first.noise or NOMINAL_NOISE, factor),
        'extrinsics': extrinsics.model_copy(update=aligned),
    }
    return rig.model_copy(update={'imus': (first.model_copy(update=changed),)})


def _scaled(block: Block, factor: float) -> Block:
    """Return a block of the rig file with all its standard deviations scaled."""
    sigmas = {
        key: (factor * np.array(value)).tolist()
        for key, value in block
        if key.endswith('_sigma') and value is not None
    }
    return block.model_copy(update=sigmas)


def _scaled_noise(noise: Noise, factor: float) -> Noise:
    figures = {
        key: {triad: [factor * x for x in axes] for triad, axes in value}
        for key, value in noise
        if not key.endswith('_sigma') and value is not None
    }
    return Noise.model_validate(figures)
