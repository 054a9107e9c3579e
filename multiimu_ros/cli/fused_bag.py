"""The bag that `multiimu fuse` makes: `imu/data` and `odom`."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
import shutil

import numpy as np

from multiimu_ros.arrays import Matrix, Stamps
from multiimu_ros.bags import BagWriter
from multiimu_ros.bags.cdr import encode_imus, encode_odometry
from multiimu_ros.fused_frame import columns, FusedFrame
from multiimu_ros.samples import ImuSamples

BLOCK = 4096  # frames written at a time


class FusedBag:
    """Writes columns of frames, in the frame `frame_id`."""

    def __init__(self, bag: BagWriter, frame_id: str) -> None:
        self._bag, self._frame_id = bag, frame_id
        bag.add_topic('/imu/data', 'sensor_msgs/msg/Imu')
        bag.add_topic('/odom', 'nav_msgs/msg/Odometry')

    def write(self, stamp_ns: Stamps, column: Mapping[str, Matrix]) -> None:
        """Write N frames: their stamps [ns] and the columns of `fused_frame.columns`."""
        samples = ImuSamples(stamp_ns, column['angular_rate'], column['specific_force'])
        imus = encode_imus(
            self._frame_id,
            samples,
            rate_covariance=column['angular_rate_covariance'],
            force_covariance=column['specific_force_covariance'],
            orientation=column['orientation'],
            orientation_covariance=column['orientation_covariance'],
        )
        odometry = encode_odometry(
            ('odom', self._frame_id),
            samples.stamp_ns,
            (column['position_n'], column['odom_orientation'], column['pose_covariance']),
            (column['velocity_b'], column['angular_rate'], column['twist_covariance']),
        )
        for stamp, imu, odom in zip(samples.stamp_ns.tolist(), imus, odometry, strict=True):
            self._bag.write('/imu/data', stamp, imu)
            self._bag.write('/odom', stamp, odom)


@contextmanager
def fused_bag(path: Path, storage: str, frame_id: str) -> Iterator[FusedBag]:
    """Open a bag to write, which vanishes if that fails."""
    writer = BagWriter(path, storage)
    try:
        with writer:
            yield FusedBag(writer, frame_id)
    except BaseException:
        shutil.rmtree(path)
        raise


def write_fused(bag: FusedBag, frames: Iterator[FusedFrame]) -> float:
    """Write the frames; return the share of still ones."""
    still = count = 0
    block: list[FusedFrame] = []
    for frame in frames:
        block.append(frame)
        still += frame.still
        count += 1
        if len(block) == BLOCK:
            _write_block(bag, block)
            block.clear()
    _write_block(bag, block)
    return still / count if count else float('nan')


def _write_block(bag: FusedBag, frames: list[FusedFrame]) -> None:
    if frames:
        records = np.array([frame.record for frame in frames])
        finite = np.isfinite(records).all(axis=1)  # as the nodes do
        stamp_ns = np.array([frame.stamp_ns for frame in frames], np.int64)
        bag.write(stamp_ns[finite], columns(records[finite]))
