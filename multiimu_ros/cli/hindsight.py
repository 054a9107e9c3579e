"""What `multiimu fuse --smooth` does: the odometry anew, knowing the whole recording."""

from collections.abc import Iterable, Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, NANOSECONDS, Stamps
from multiimu_ros.cli.options import with_progress
from multiimu_ros.errors import ConfigError
from multiimu_ros.fused_frame import columns, FusedFrame
from multiimu_ros.odometry.error_state import pose_covariance, twist_covariance
from multiimu_ros.odometry.smoother import Recording, Smoothed, Smoother
from multiimu_ros.pipeline import Pipeline

BLOCK = 4096  # frames turned into columns at a time
KEPT = (
    'angular_rate',
    'angular_rate_covariance',
    'specific_force',
    'specific_force_covariance',
    'orientation',
    'orientation_covariance',
    'reading',
    'density',
)


class Tape:
    """Keeps of passing frames what smoothing and `imu/data` need: 400 bytes each.

    Attributes
    ----------
    stamp_ns : (N,) int array
        Instants [ns].
    flags : (N, 2) bool array
        Still, resting.
    column : dict of arrays
        What KEPT names.
    """

    def __init__(self, frames: Iterable[FusedFrame]) -> None:
        stamps: list[int] = []
        flags: list[tuple[bool, bool]] = []
        parts: list[Mapping[str, Matrix]] = []
        records: list[Matrix] = []
        for frame in frames:
            stamps.append(frame.stamp_ns)
            flags.append((frame.still, frame.resting))
            records.append(frame.record)
            if len(records) == BLOCK:
                parts.append(_kept(records))
                records.clear()
        if records:
            parts.append(_kept(records))
        if not parts:
            msg = 'There must be frames to smooth, got none; check the recording.'
            raise ConfigError(msg)
        self.stamp_ns: Stamps = np.array(stamps, np.int64)
        self.flags: Flags = np.array(flags)
        self.column = {name: np.concatenate([part[name] for part in parts]) for name in KEPT}


def _kept(records: list[Matrix]) -> Mapping[str, Matrix]:
    column = columns(np.array(records))
    return {name: column[name].copy() for name in KEPT}


def solved(pipeline: Pipeline, tape: Tape, closed_sigma: float | None) -> Smoother:
    """Return the odometry in hindsight, ready to yield its blocks.

    Parameters
    ----------
    pipeline : Pipeline
        What made the frames.
    tape : Tape
        Of the frames.
    closed_sigma : float or None
        The rig ended where it began, to this distance [m]; None if nothing is known of that.

    Raises
    ------
    ConfigError
        If time jumped back in the recording.
    """
    if pipeline.time_jumps:
        msg = f'`--smooth` needs one recording; in this time jumps back {pipeline.time_jumps} x.'
        raise ConfigError(msg)
    reading, density = tape.column['reading'], tape.column['density']
    steps = np.diff(tape.stamp_ns) / NANOSECONDS
    steps = np.concatenate((steps[:1], steps)) if len(steps) else np.ones(1)
    recording = Recording(
        dt=steps, angular_rate=reading[:, :3], specific_force=reading[:, 3:],
        rate_density=density[:, :3], force_density=density[:, 3:],
        still=tape.flags[:, 0], resting=tape.flags[:, 1],
    )  # fmt: skip
    smoother = Smoother(pipeline.odometry_config, recording, closed_sigma)
    for _ in with_progress(smoother.solve(), 2 * smoother.segments, 'Smoothing'):
        pass
    return smoother


def smoothed_columns(tape: Tape, block: Smoothed) -> tuple[Stamps, Mapping[str, Matrix]]:
    """Return stamps and columns of what is written: `imu/data` as it was, `odom` in hindsight."""
    stamp_ns = tape.stamp_ns[block.rows]
    column = {name: tape.column[name][block.rows] for name in KEPT}
    column['position_n'] = block.position_n
    column['odom_orientation'] = Rotation.from_matrix(block.R_nb).as_quat()
    column['velocity_b'] = np.einsum('nji,nj->ni', block.R_nb, block.velocity_n)
    rate_hz = NANOSECONDS / np.median(np.diff(tape.stamp_ns))
    variance = rate_hz * column['density'][:, :3] ** 2
    states = list(zip(block.R_nb, block.velocity_n, block.P, variance, strict=True))
    column['pose_covariance'] = np.array([pose_covariance(R, P) for R, _, P, _ in states])
    column['twist_covariance'] = np.array([twist_covariance(*state) for state in states])
    return stamp_ns, column
