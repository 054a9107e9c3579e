"""Planned poses from a drawing: the way in for a board that was built but not yet measured.

One YAML file says for each IMU where it sits in the base frame b (x forward, y left, z up) and
how, in the one of four ways that the drawing offers:

    rotation: [x, y, z, w]                quaternion of R_bs, v_b = R_bs v_s
    matrix: [[...], [...], [...]]         R_bs; its columns are the sensor's axes in b
    euler_deg: {order: ZYX, angles: [90, 0, 0]}   scipy's orders: capitals turn about the axes
                                          turned before (ZYX is yaw, pitch, roll), small ones
                                          about those of b
    axes: {x: forward, z: down}           where two or three of the sensor's axes point

A frame that is left-handed or has axes that are not square is refused: both are slips of a
drawing that would silently turn into some rotation near it.
"""

from collections.abc import Mapping
import os
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, FiniteFloat, model_validator
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix
from multiimu_ros.rig import Extrinsics, Quaternion, Table, Triple
from multiimu_ros.sheet import load_sheet

SQUARE = 1e-3  # a matrix typed with four digits is that orthogonal

Axis = Literal['x', 'y', 'z']
Direction = Literal['forward', 'backward', 'left', 'right', 'up', 'down']
DIRECTIONS: Mapping[Direction, tuple[int, int, int]] = {
    'forward': (1, 0, 0),
    'backward': (-1, 0, 0),
    'left': (0, 1, 0),
    'right': (0, -1, 0),
    'up': (0, 0, 1),
    'down': (0, 0, -1),
}
WAYS = ('rotation', 'matrix', 'euler_deg', 'axes')


class _Block(BaseModel):
    model_config = ConfigDict(extra='forbid', frozen=True)


class EulerAngles(_Block):
    """Three turns by `angles` [deg], about the axes that `order` names from left to right."""

    order: Annotated[str, Field(pattern='^([XYZ]{3}|[xyz]{3})$')]
    angles: Triple

    @field_validator('order')
    @classmethod
    def _turns(cls, order: str) -> str:
        if order[0] == order[1] or order[1] == order[2]:
            msg = 'must not turn about one axis twice in a row'
            raise ValueError(msg)
        return order


def _square(R: Matrix) -> None:
    """Refuse a matrix whose columns are no right-handed frame of unit axes."""
    product = R.T @ R - np.eye(3)
    i, k = np.unravel_index(int(np.argmax(np.abs(product))), (3, 3))
    if abs(product[i, k]) > SQUARE:
        first, second = 'xyz'[int(i)], 'xyz'[int(k)]
        what = f'axes {first} and {second} are not orthogonal'
        if i == k:
            what = f'axis {first} has length {np.sqrt(product[i, i] + 1):.4g}'
        msg = f'must have columns of length 1 at right angles, but {what}'
        raise ValueError(msg)
    if np.linalg.det(R) < 0:
        msg = 'must be right-handed, but its axes are left-handed: turn one of them round'
        raise ValueError(msg)


class CadImu(_Block):
    """The planned pose of one IMU: position [m], and orientation in one of four ways."""

    position: Triple
    rotation: Quaternion | None = None
    matrix: Table | None = None
    euler_deg: EulerAngles | None = None
    axes: dict[Axis, Direction] | None = None

    @field_validator('matrix')
    @classmethod
    def _is_rotation(cls, matrix: Table | None) -> Table | None:
        if matrix is not None:
            _square(np.array(matrix))
        return matrix

    @field_validator('axes')
    @classmethod
    def _are_axes(cls, axes: dict[Axis, Direction] | None) -> dict[Axis, Direction] | None:
        if axes is not None:
            _square(_matrix_of(axes))
        return axes

    @model_validator(mode='after')
    def _one_way(self) -> 'CadImu':
        ways = [way for way in WAYS if getattr(self, way) is not None]
        if len(ways) != 1:
            came = ' and '.join(ways) or 'none'
            msg = f'must have one of {", ".join(WAYS)}, got {came}'
            raise ValueError(msg)
        return self

    @property
    def R_bs(self) -> Rotation:
        """Orientation, v_b = R_bs v_s."""
        if self.rotation is not None:
            return Rotation.from_quat(self.rotation)
        if self.euler_deg is not None:
            turns = self.euler_deg
            return Rotation.from_euler(turns.order, turns.angles, degrees=True)
        if self.matrix is not None:
            return Rotation.from_matrix(self.matrix)
        return Rotation.from_matrix(_matrix_of(self.axes or {}))


class CadSheet(_Block):
    """A drawing of the board.

    Parameters
    ----------
    position_sigma : float, optional
        How far a coordinate may be off, per axis [m].
    angle_sigma_deg : float, optional
        How far an IMU may be turned, per axis [deg].
    imus : dict
        One `CadImu` for each IMU.
    """

    version: Literal[1]
    position_sigma: Annotated[FiniteFloat, Field(gt=0.0)] | None = None
    angle_sigma_deg: Annotated[FiniteFloat, Field(gt=0.0)] | None = None
    imus: Annotated[dict[str, CadImu], Field(min_length=1)]


def _matrix_of(axes: Mapping[Axis, Direction]) -> Matrix:
    """Return R_bs from two or three directions; the third axis completes a right-handed frame."""
    if len(axes) < 2:
        msg = f'must name two or three axes, got {len(axes)}'
        raise ValueError(msg)
    columns = {axis: np.array(DIRECTIONS[word], dtype=np.float64) for axis, word in axes.items()}
    cycle: tuple[Axis, ...] = ('x', 'y', 'z')
    for k, axis in enumerate(cycle):
        if axis not in columns:
            columns[axis] = np.cross(columns[cycle[k - 2]], columns[cycle[k - 1]])
            if not columns[axis].any():
                first, second = axes
                msg = f'must be at right angles, but {first} and {second} are on one line'
                raise ValueError(msg)
    return np.column_stack([columns[axis] for axis in cycle])


def load_cad(path: str | os.PathLike[str]) -> dict[str, Extrinsics]:
    """Read planned poses, the YAML form of `CadSheet`.

    Returns
    -------
    dict of Extrinsics
        By the IMU's name, in the base frame; with sigmas where the file states its accuracy.

    Raises
    ------
    ConfigError
        If the file is missing or wrong, or an orientation is no rotation; names the key's path.
    """
    sheet = load_sheet(path, CadSheet, 'CAD')
    sigmas: dict[str, object] = {}
    if sheet.position_sigma is not None:
        sigmas['lever_arm_sigma'] = (sheet.position_sigma,) * 3
    if sheet.angle_sigma_deg is not None:
        sigmas['rotation_sigma'] = (float(np.deg2rad(sheet.angle_sigma_deg)),) * 3
    return {
        name: Extrinsics.model_validate(
            {'rotation': imu.R_bs.as_quat().tolist(), 'lever_arm': imu.position} | sigmas
        )
        for name, imu in sheet.imus.items()
    }
