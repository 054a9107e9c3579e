"""The odometry of one recording as arrays, gathered while the frames pass."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, NANOSECONDS, Scalars, Stamps, Vectors
from multiimu_ros.errors import ConfigError
from multiimu_ros.fused_frame import columns, FusedFrame
from multiimu_ros.odometry.attitude import OUTAGE
from multiimu_ros.odometry.smoother import Smoothed

BLOCK = 4096  # frames turned into columns at a time
BIASES = ('gyro_bias', 'gyro_bias_sigma', 'accel_bias', 'accel_bias_sigma')
NEEDED = ('position_n', 'velocity_n', 'orientation', 'position_covariance', 'rotation_covariance')


@dataclass(frozen=True, kw_only=True)
class Walk:
    """What the odometry says at N instants.

    Parameters
    ----------
    stamp_ns : (N,) int array
        Instants [ns].
    position_n : (N, 3) array
        From the start, z up [m].
    velocity_n : (N, 3) array
        In the same axes [m/s].
    orientation : (N, 4) array
        Quaternions x, y, z, w of R_nb.
    position_covariance, rotation_covariance : (N, 3, 3) arrays
        Of the position, and of the rotation about fixed axes [m^2], [rad^2].
    gyro_bias, accel_bias : (N, 3) arrays
        In the base frame [rad/s], [m/s^2]; NaN where nobody knows.
    gyro_bias_sigma, accel_bias_sigma : (N, 3) arrays
        Their standard deviations.
    still : (N,) bool array
        Where the rig was found to have no velocity.
    """

    stamp_ns: Stamps
    position_n: Vectors
    velocity_n: Vectors
    orientation: Vectors
    position_covariance: Matrix
    rotation_covariance: Matrix
    gyro_bias: Vectors
    gyro_bias_sigma: Vectors
    accel_bias: Vectors
    accel_bias_sigma: Vectors
    still: Flags

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def select(self, index: 'Flags | slice') -> 'Walk':
        """Return the instants under a mask or slice."""
        return Walk(**{name: column[index] for name, column in vars(self).items()})

    @property
    def seconds(self) -> Scalars:
        """Time since the first instant (N,) [s]."""
        return np.asarray((self.stamp_ns - self.stamp_ns[0]) / NANOSECONDS)

    @property
    def gaps(self) -> Scalars:
        """Times (M,) without any frame that are too long to bridge [s]."""
        steps = np.diff(self.stamp_ns) / NANOSECONDS
        return np.asarray(steps[steps > OUTAGE])


class WalkRecorder:
    """Keeps of passing frames what a walk is made of: 330 bytes each.

    Attributes
    ----------
    watches : bool
        Whether any frames pass.
    """

    def __init__(self) -> None:
        self.watches = False
        self._frames: list[FusedFrame] = []
        self._blocks: list[Walk] = []

    def watch(self, frames: Iterable[FusedFrame]) -> Iterator[FusedFrame]:
        """Yield the frames as they come, and keep them in mind."""
        self.watches = True
        for frame in frames:
            self._frames.append(frame)
            if len(self._frames) == BLOCK:
                self._pack()
            yield frame

    def walk(self) -> Walk:
        """Return what has passed so far."""
        self._pack()
        self._blocks = [joined(self._blocks)]
        return self._blocks[0]

    def _pack(self) -> None:
        if self._frames:
            self._blocks.append(_columns(self._frames))
            self._frames = []


def joined(parts: Sequence[Walk]) -> Walk:
    """Return walks, one after the other, as one."""
    names = [field.name for field in fields(Walk)]
    if not parts:
        msg = 'The odometry must say something to be drawn, got no frame; check the recording.'
        raise ConfigError(msg)
    return Walk(**{name: np.concatenate([vars(part)[name] for part in parts]) for name in names})


def as_walk(frames: Iterable[FusedFrame]) -> Walk:
    """Return the frames of a pipeline as arrays.

    Raises
    ------
    ConfigError
        If there are none.
    """
    recorder = WalkRecorder()
    for _ in recorder.watch(frames):
        pass
    return recorder.walk()


def smoothed_walk(live: Walk, smoothed: Smoothed) -> Walk:
    """Return a walk as a smoother knows it in hindsight.

    Parameters
    ----------
    live : Walk
        One instant for each sample of the recording that was smoothed.
    smoothed : Smoothed
        What became of them.
    """
    R, P = smoothed.R_nb, smoothed.P
    sigma = np.sqrt(np.maximum(np.diagonal(P, axis1=1, axis2=2), 0.0))
    return Walk(
        stamp_ns=live.stamp_ns[smoothed.rows],
        position_n=smoothed.position_n,
        velocity_n=smoothed.velocity_n,
        orientation=Rotation.from_matrix(R).as_quat(),
        position_covariance=P[:, :3, :3],
        rotation_covariance=R @ P[:, 6:9, 6:9] @ R.transpose(0, 2, 1),  # about fixed axes
        gyro_bias=smoothed.gyro_bias,
        gyro_bias_sigma=sigma[:, 9:12],
        accel_bias=smoothed.accel_bias,
        accel_bias_sigma=sigma[:, 12:15],
        still=live.still[smoothed.rows],
    )


def _columns(frames: Sequence[FusedFrame]) -> Walk:
    column = columns(np.array([frame.record for frame in frames]))
    pose, orientation = column['pose_covariance'], column['odom_orientation'].copy()
    velocity_b = column['velocity_b']
    known = np.isfinite(orientation).all(axis=1)
    velocity_n = np.full_like(velocity_b, np.nan)
    velocity_n[known] = Rotation.from_quat(orientation[known]).apply(velocity_b[known])
    return Walk(
        stamp_ns=np.array([frame.stamp_ns for frame in frames], np.int64),
        velocity_n=velocity_n,
        orientation=orientation,
        position_n=column['position_n'].copy(),
        position_covariance=pose[:, :3, :3].copy(),
        rotation_covariance=pose[:, 3:, 3:].copy(),
        still=np.array([frame.still for frame in frames], bool),
        **{name: column[name].copy() for name in BIASES},
    )


def sound(walk: Walk) -> tuple[Walk, tuple[str, ...]]:
    """Return what can be drawn of a walk, and a sentence on each thing that was left out.

    Raises
    ------
    ConfigError
        If nothing is left.
    """
    said = []
    back = np.flatnonzero(np.diff(walk.stamp_ns) <= 0)
    if len(back):
        said.append(
            f'The stamps went back {len(back)} times, where the odometry began anew; what is '
            'shown came after the last time.'
        )
        walk = walk.select(slice(int(back[-1]) + 1, None))
    known = [np.isfinite(vars(walk)[name]).reshape(len(walk), -1) for name in NEEDED]
    finite: Flags = np.asarray(np.hstack(known).all(axis=1))
    if not finite.all():
        said.append(f'{np.sum(~finite)} frames of {len(finite)} were not finite and are left out.')
        walk = walk.select(finite)
    if len(walk) < 2:
        msg = f'The walk must have at least 2 finite frames, got {len(walk)}; check the recording.'
        raise ConfigError(msg)
    return walk, tuple(said)
