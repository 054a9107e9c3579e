"""Where the rig was and what its biases were, kept in a file across a restart.

A rig that is switched on in mid-walk cannot stand still first.  What it needs from before is
where it was, where it was heading and how large its biases were; tilt and velocity are old by the
time it runs again, and the filters find them anew, as after any start in motion.  So the filters
start at their own origin, with the biases from the file, and `Origin` says where that origin lies
in the frame of before, as far as that can be known.  Its uncertainty stays outside the filters:
inside, a heading unknown by a radian would soon be believed, for what is second order in it looks
like information.  Equations: docs/derivations/smoother.md, last section.
"""

from collections.abc import Sequence
import hashlib
import json
import os
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat

from multiimu_ros.arrays import Matrix, NANOSECONDS, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.errors import ConfigError
from multiimu_ros.odometry.attitude import AttitudeEstimator
from multiimu_ros.odometry.error_state import ErrorStateConfig, ErrorStateFilter
from multiimu_ros.rig import Rig, Triple
from multiimu_ros.rotations import product
from multiimu_ros.sheet import parse_sheet, write_sheet

TURNING = 0.35  # [rad/sqrt(s)] a walker turns a corner of 90 deg every 20 s
ANY_HEADING = np.pi / np.sqrt(3.0)  # [rad] deviation of a heading that may be any
Row = tuple[FiniteFloat, ...]
Table = tuple[Triple, Triple, Triple]


def _rotation(value: Table) -> Table:
    R = np.array(value)
    if np.abs(R @ R.T - np.eye(3)).max() > 1e-6 or np.linalg.det(R) < 0:  # saved with 16 digits
        msg = 'must be a rotation matrix'
        raise ValueError(msg)
    return value


def _covariance(value: Sequence[Row]) -> Sequence[Row]:
    if {len(row) for row in value} != {len(value)}:
        msg = 'must be square'
        raise ValueError(msg)
    P = np.array(value)
    scale = np.sqrt(np.abs(np.diag(P))) + 1e-300
    # What a filter's rounding leaves below zero is of 1e-9.
    if np.linalg.eigvalsh(P / np.outer(scale, scale)).min() < -1e-6 or (P != P.T).any():
        msg = 'must be a covariance: symmetric, no variance below zero'
        raise ValueError(msg)
    return value


Attitude = Annotated[Table, AfterValidator(_rotation)]
Covariance6 = Annotated[
    tuple[Row, ...], Field(min_length=6, max_length=6), AfterValidator(_covariance)
]
Covariance15 = Annotated[
    tuple[Row, ...], Field(min_length=15, max_length=15), AfterValidator(_covariance)
]


class SavedState(BaseModel):
    """What is known at one instant; vectors, frames and covariances are those of the filters."""

    model_config = ConfigDict(extra='forbid', frozen=True)

    version: Literal[1] = 1
    rig: str
    rig_digest: str  # of the rig file: biases are those beside one calibration
    profile: str
    virtual_imu: Triple  # [m] the point whose position it is
    stamp_ns: int
    position_n: Triple
    velocity_n: Triple
    R_nb: Attitude
    gyro_bias: Triple
    accel_bias: Triple
    covariance: Covariance15
    attitude_rotation: Attitude
    attitude_gyro_bias: Triple
    attitude_covariance: Covariance6


class Owner(NamedTuple):
    """Whose state it is: rig, profile and point of the virtual IMU."""

    rig: Rig
    profile: str
    virtual_imu: Triple = (0.0, 0.0, 0.0)

    def signature(self) -> dict[str, object]:
        """Return what tells this owner from another, as the file has it."""
        digest = hashlib.sha256(self.rig.model_dump_json().encode()).hexdigest()[:16]
        return {
            'rig': self.rig.rig.name,
            'rig_digest': digest,
            'profile': self.profile,
            'virtual_imu': tuple(map(float, self.virtual_imu)),
        }


def snapshot(
    owner: Owner,
    stamp_ns: int,
    odometry: tuple[Vector, Matrix, Matrix],
    attitude: tuple[Matrix, Matrix],
    attitude_gyro_bias: Vector,
) -> SavedState:
    """Gather what is to be saved.

    Parameters
    ----------
    owner : Owner
        Whose state it is.
    stamp_ns : int
        Its instant [ns].
    odometry : (15,), (3, 3), (15, 15) arrays
        `state`, `R_nb` and `P` of the odometry filter, or what `Origin.seen` makes of them.
    attitude : (3, 3), (6, 6) arrays
        `R_nb` and `P` of the attitude filter, or what `Origin.seen_attitude` makes of them.
    attitude_gyro_bias : (3,) array
        Its gyro bias [rad/s].
    """
    (x, R, P), (attitude_R, attitude_P) = odometry, attitude
    content = owner.signature() | {
        'stamp_ns': stamp_ns,
        'position_n': x[0:3].tolist(),
        'velocity_n': x[3:6].tolist(),
        'R_nb': R.tolist(),
        'gyro_bias': x[9:12].tolist(),
        'accel_bias': x[12:15].tolist(),
        'covariance': (0.5 * (P + P.T)).tolist(),
        'attitude_rotation': attitude_R.tolist(),
        'attitude_gyro_bias': attitude_gyro_bias.tolist(),
        'attitude_covariance': (0.5 * (attitude_P + attitude_P.T)).tolist(),
    }
    return parse_sheet(content, SavedState, 'The state of the filters')


def save_state(state: SavedState, path: str | os.PathLike[str]) -> None:
    """Write the file at once or not at all; whoever reads it meets the old or the new state.

    Raises
    ------
    ConfigError
        If the file cannot be written; it stays as it was then.
    """
    write_sheet(state.model_dump_json(indent=1), path, 'state')


def load_state(
    path: str | os.PathLike[str], owner: Owner, now_ns: int, oldest_s: float = 3600.0
) -> SavedState:
    """Read the file, or refuse it in a sentence.

    Parameters
    ----------
    path : path
        What `save_state` wrote.
    owner : Owner
        Who asks.
    now_ns : int
        The present, on the clock of the stamps [ns].
    oldest_s : float
        Older states are refused [s].

    Raises
    ------
    ConfigError
        If it is missing, damaged, another rig's, too old or of the future.
    """
    try:
        content = json.loads(Path(path).read_text(encoding='utf-8'))
    except OSError as error:
        msg = f'Cannot read the state file `{path}`: {error.strerror}; start from a rest instead.'
        raise ConfigError(msg) from error
    except ValueError as error:  # also UnicodeDecodeError
        msg = f'The state file `{path}` is damaged: {error}; delete it.'
        raise ConfigError(msg) from error
    state = parse_sheet(content, SavedState, str(path))
    for name, own in owner.signature().items():
        found = getattr(state, name)
        if found != own:
            msg = f'{path}: `{name}` must be {own!r} as now, got {found!r}; delete the file.'
            raise ConfigError(msg)
    age = (now_ns - state.stamp_ns) / NANOSECONDS
    if not 0.0 <= age <= oldest_s:
        msg = f'{path}: must be at most {oldest_s:g} s old, got {age:.0f} s; delete the file.'
        raise ConfigError(msg)
    return state


@compiled
def place(
    x: Vector, R: Matrix, P: Matrix, position: Vector, yaw: float, spread: Matrix
) -> tuple[Vector, Matrix, Matrix]:
    """Return x (15,), R (3, 3) and P (15, 15) of the odometry filter as seen from another frame.

    `position` (3,) [m] and `yaw` [rad] are those of the filter's origin in that frame, `spread`
    (4, 4) is their covariance.
    """
    Q = np.eye(3)
    Q[0, 0] = Q[1, 1] = np.cos(yaw)
    Q[1, 0] = np.sin(yaw)
    Q[0, 1] = -Q[1, 0]
    seen = x.copy()
    seen[0:3], seen[3:6] = Q @ x[0:3], Q @ x[3:6]
    turned = product(Q, R)
    J, A = np.eye(15), np.zeros((15, 4))
    J[0:3, 0:3] = J[3:6, 3:6] = Q
    A[0:3, 0:3] = np.eye(3)
    A[0, 3], A[1, 3], A[3, 3], A[4, 3] = -seen[1], seen[0], -seen[4], seen[3]
    A[6:9, 3] = turned[2]
    covariance = product(product(J, P), J.T) + product(product(A, spread), A.T)
    seen[0:3] += position
    return seen, turned, 0.5 * (covariance + covariance.T)


class Origin:
    """Where the filters' origin lies in the frame of before the restart, and how surely.

    Parameters
    ----------
    state : SavedState
        What was known before.
    config : ErrorStateConfig
        That of the odometry filter: how a rig moves, how its biases walk.
    now_ns : int
        Instant of the first sample after the restart [ns].
    """

    def __init__(self, state: SavedState, config: ErrorStateConfig, now_ns: int) -> None:
        self._state, self._config = state, config
        self._elapsed = max(0.0, (now_ns - state.stamp_ns) / NANOSECONDS)
        unknown = min(TURNING**2 * self._elapsed, ANY_HEADING**2)
        R, P = np.array(state.R_nb), np.array(state.covariance)
        pick = np.zeros((4, 15))
        pick[:3, :3], pick[3, 6:9] = np.eye(3), R[2]
        moved = (config.motion_velocity_sigma * self._elapsed) ** 2
        self.position = np.array(state.position_n)
        self.yaw = float(np.arctan2(R[1, 0], R[0, 0]))
        self.spread = pick @ P @ pick.T + np.diag([moved, moved, moved, unknown])
        R, P = np.array(state.attitude_rotation), np.array(state.attitude_covariance)
        self.attitude_yaw = float(np.arctan2(R[1, 0], R[0, 0]))
        self.attitude_variance = float(R[2] @ P[:3, :3] @ R[2]) + unknown

    def restore_biases(self, odometry: ErrorStateFilter, attitude: AttitudeEstimator) -> None:
        """Give new filters the biases of before, widened by their random walk since then."""
        state, config, since = self._state, self._config, self._elapsed
        variance = np.diag(state.covariance)
        rate_walk = np.square(config.rate_bias_walk) * since
        odometry.restore_biases(
            np.array(state.gyro_bias),
            np.sqrt(variance[9:12] + rate_walk),
            np.array(state.accel_bias),
            np.sqrt(variance[12:15] + np.square(config.force_bias_walk) * since),
        )
        variance = np.diag(state.attitude_covariance)[3:]
        attitude.restore_gyro_bias(
            np.array(state.attitude_gyro_bias), np.sqrt(variance + rate_walk)
        )

    def seen(self, odometry: ErrorStateFilter) -> tuple[Vector, Matrix, Matrix]:
        """Return state (15,), R_nb (3, 3), P (15, 15) of the odometry in the frame of before."""
        pose = odometry.state, odometry.R_nb, odometry.P
        return place(*pose, self.position, self.yaw, self.spread)

    def seen_attitude(self, attitude: AttitudeEstimator) -> tuple[Matrix, Matrix]:
        """Return R_nb (3, 3) and P (6, 6) of the attitude filter in the frame of before."""
        cosine, sine = np.cos(self.attitude_yaw), np.sin(self.attitude_yaw)
        R = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ attitude.R_nb
        P = attitude.P
        P[:3, :3] += self.attitude_variance * np.outer(R[2], R[2])
        return R, P
