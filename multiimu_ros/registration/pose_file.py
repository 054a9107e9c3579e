"""A tracker's poses in a file of comma-separated values, as most trackers export them.

The first line names the columns: `time` [s] or `stamp_ns` [ns]; `x`, `y`, `z` [m]; `qx`, `qy`,
`qz`, `qw`, the quaternion of v_w = R_wt v_t.  Others are passed over.  Where the target was not
seen the fields are empty, or nan.
"""

import os

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.errors import ConfigError
from multiimu_ros.registration.pose_stream import TrackerPoses

POSITION, QUATERNION = ('x', 'y', 'z'), ('qx', 'qy', 'qz', 'qw')


def load_poses(path: str | os.PathLike[str]) -> TrackerPoses:
    """Read the poses of a target.

    Raises
    ------
    ConfigError
        If the file is missing, lacks a column, or its times do not rise.
    """
    try:
        table = np.atleast_1d(np.genfromtxt(path, delimiter=',', names=True, encoding='utf-8'))
    except (OSError, ValueError) as error:
        reason = ' '.join(str(error).split()).rstrip('.')
        msg = f'Cannot read the poses `{path}`: {reason}; pass a file of comma-separated values.'
        raise ConfigError(msg) from error
    names = table.dtype.names or ()
    clock = 'stamp_ns' if 'stamp_ns' in names else 'time'
    missing = [name for name in (clock, *POSITION, *QUATERNION) if name not in names]
    if missing:
        msg = f'{path}: the first line must name a column `{missing[0]}`, got {", ".join(names)}.'
        raise ConfigError(msg)
    unit = 1 if clock == 'stamp_ns' else NANOSECONDS
    stamps = np.round(table[clock] * unit)
    if not np.isfinite(stamps).all() or (np.diff(stamps) <= 0).any():
        msg = f'{path}: `{clock}` must rise from line to line; sort the poses, drop repeated ones.'
        raise ConfigError(msg)
    position = np.stack([table[name] for name in POSITION], axis=1)
    quaternion = np.stack([table[name] for name in QUATERNION], axis=1)
    seen = np.isfinite(position).all(axis=1) & (np.linalg.norm(quaternion, axis=1) > 0.5)
    position[~seen] = np.nan
    R_wt = np.full((len(table), 3, 3), np.nan)
    R_wt[seen] = Rotation.from_quat(quaternion[seen]).as_matrix()
    return TrackerPoses(stamps.astype(np.int64), position, R_wt)
