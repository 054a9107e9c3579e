"""The rig file: everything known about the IMUs of one board, with its uncertainty.

One YAML file per board, written by the calibration verbs and loaded unchanged by the nodes.  A
block that is absent means nominal: identity, zero, and the wide sigmas of `NOMINAL`, which are
what a data sheet promises, not what a calibration found.  Every estimate `key` may have a sibling
`key_sigma`, its standard deviation.
"""

from collections.abc import Sequence
import os
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat
from scipy.spatial.transform import Rotation
import yaml

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.errors import ConfigError
from multiimu_ros.sheet import load_sheet, parse_sheet, write_sheet

MAX_IMUS = 16

NonNegative = Annotated[FiniteFloat, Field(ge=0.0)]
Triple = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Positives = tuple[NonNegative, NonNegative, NonNegative]
Table = tuple[Triple, Triple, Triple]
IDENTITY: Table = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ZERO_TABLE: Table = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
ZERO: Triple = (0.0, 0.0, 0.0)


def _unit_quaternion(value: tuple[float, float, float, float]) -> tuple[float, ...]:
    norm = float(np.linalg.norm(value))
    if abs(norm - 1.0) > 1e-4:  # a hand-typed quaternion has 5 digits
        msg = f'must be a unit quaternion [x, y, z, w], got one of norm {norm:.6g}'
        raise ValueError(msg)
    return tuple(x / norm for x in value)


def _invertible(value: Table) -> Table:
    if abs(np.linalg.det(np.array(value))) < 1e-3:
        msg = 'must be an invertible matrix'
        raise ValueError(msg)
    return value


def _nonzero(value: Triple) -> Triple:
    if 0.0 in value:
        msg = 'must not contain 0'
        raise ValueError(msg)
    return value


Quaternion = Annotated[
    tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_unit_quaternion)
]


class _Block(BaseModel):
    model_config = ConfigDict(extra='forbid', frozen=True)


class Triad(_Block):
    """Sensor model of three axes: calibrated = misalignment @ (scale * (raw - bias))."""

    misalignment: Annotated[Table, AfterValidator(_invertible)] = IDENTITY
    misalignment_sigma: Table | None = None
    scale: Annotated[Triple, AfterValidator(_nonzero)] = (1.0, 1.0, 1.0)
    scale_sigma: Positives | None = None
    bias: Triple = ZERO
    bias_sigma: Positives | None = None


class GyroscopeTriad(Triad):
    """Adds the g-sensitivity [rad/s per m/s^2], subtracted: rate -= g_sensitivity @ force."""

    g_sensitivity: Table = ZERO_TABLE
    g_sensitivity_sigma: Table | None = None


class Intrinsics(_Block):
    """What turns the raw readings of one IMU into calibrated ones."""

    accelerometer: Triad = Triad()
    gyroscope: GyroscopeTriad = GyroscopeTriad()


class PerTriad(_Block):
    """One noise figure, per axis, of both triads."""

    accelerometer: Positives
    gyroscope: Positives


class Noise(_Block):
    """The noise model of one IMU, as an Allan analysis finds it.

    Units, accelerometer and gyroscope: density [m/s^2/sqrt(Hz)], [rad/s/sqrt(Hz)]; instability
    [m/s^2], [rad/s]; random walk [m/s^3/sqrt(Hz)], [rad/s^2/sqrt(Hz)].
    """

    noise_density: PerTriad
    noise_density_sigma: PerTriad | None = None
    bias_instability: PerTriad | None = None
    bias_instability_sigma: PerTriad | None = None
    bias_random_walk: PerTriad | None = None
    bias_random_walk_sigma: PerTriad | None = None


class Range(_Block):
    """Full scale of the raw readings: the largest that an axis can say."""

    accelerometer: Annotated[FiniteFloat, Field(gt=0.0)] | None = None  # [m/s^2]
    gyroscope: Annotated[FiniteFloat, Field(gt=0.0)] | None = None  # [rad/s]


class Extrinsics(_Block):
    """Pose of one IMU on the rig: v_b = R_bs v_s, and the sensor's origin in the base frame."""

    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)
    rotation_sigma: Positives | None = None  # [rad] about the sensor's axes
    lever_arm: Triple = ZERO
    lever_arm_sigma: Positives | None = None

    @property
    def R_bs(self) -> Matrix:
        """Rotation (3, 3) that maps sensor vectors into the base frame."""
        return np.asarray(Rotation.from_quat(self.rotation).as_matrix())

    @property
    def lever_arm_b(self) -> Vector:
        """Sensor origin (3,) in the base frame [m]."""
        return np.array(self.lever_arm)


class Imu(_Block):
    """One IMU of the rig."""

    name: Annotated[str, Field(pattern=r'^[a-zA-Z][a-zA-Z0-9_]*$')]
    frame_id: str
    model: str = ''
    serial: str = ''
    range: Range | None = None
    intrinsics: Intrinsics | None = None
    noise: Noise | None = None
    extrinsics: Extrinsics | None = None
    time_offset: FiniteFloat = 0.0  # [s], added to the stamp
    time_offset_sigma: NonNegative | None = None
    provenance: dict[str, Any] = {}


# A BMI160's data sheet (BST-BMI160-DS000, table 1), rounded up: what an unknown IMU may be like.
NOMINAL_NOISE = Noise(
    noise_density=PerTriad(accelerometer=(1.8e-3,) * 3, gyroscope=(1.2e-4,) * 3),
    bias_instability=PerTriad(accelerometer=(5e-4,) * 3, gyroscope=(4e-5,) * 3),
    bias_random_walk=PerTriad(accelerometer=(1e-4,) * 3, gyroscope=(4e-6,) * 3),
)
NOMINAL_BIAS_SIGMA = PerTriad(accelerometer=(0.4,) * 3, gyroscope=(0.05,) * 3)
NOMINAL_SCALE_SIGMA = PerTriad(accelerometer=(0.01,) * 3, gyroscope=(0.01,) * 3)


class RigFrame(_Block):
    """The board as a whole; gravity is given, or follows from latitude [deg] and height [m]."""

    name: str
    base_frame: str = 'base_link'
    gravity: Annotated[FiniteFloat, Field(gt=1.0, lt=30.0)] | None = None
    latitude: Annotated[FiniteFloat, Field(ge=-90.0, le=90.0)] | None = None
    height: FiniteFloat = 0.0

    @property
    def gravity_magnitude(self) -> float:
        """Local gravity [m/s^2]; standard gravity where the file says nothing."""
        if self.gravity is not None:
            return self.gravity
        return 9.80665 if self.latitude is None else normal_gravity(self.latitude, self.height)


class Rig(_Block):
    """All that is known about one board."""

    version: Literal[1]
    rig: RigFrame
    imus: Annotated[tuple[Imu, ...], Field(min_length=1, max_length=MAX_IMUS)]

    @property
    def names(self) -> tuple[str, ...]:
        """Topic prefix of each IMU, in order."""
        return tuple(imu.name for imu in self.imus)

    def nominal_blocks(self) -> tuple[str, ...]:
        """Return the paths of the blocks that the file leaves nominal, for the user to be told."""
        return tuple(
            f'imus[{k}].{block}'
            for k, imu in enumerate(self.imus)
            for block in ('intrinsics', 'noise', 'extrinsics')
            if getattr(imu, block) is None
        )


def normal_gravity(latitude_deg: float, height_m: float) -> float:
    """Return gravity on the WGS-84 ellipsoid, Somigliana's formula with free-air decrease [m/s^2].

    NIMA TR8350.2, 2000, eqs. (4-1) and (4-3): within 1 mm/s^2 of the true value nearly everywhere.
    """
    a, f, m = 6378137.0, 1 / 298.257223563, 0.00344978650684
    square = np.sin(np.deg2rad(latitude_deg)) ** 2
    surface = (
        9.7803253359 * (1 + 0.00193185265241 * square) / np.sqrt(1 - 0.00669437999013 * square)
    )
    decrease = 1 - 2 / a * (1 + f + m - 2 * f * square) * height_m + 3 * height_m**2 / a**2
    return float(surface * decrease)


def load_rig(path: str | os.PathLike[str]) -> Rig:
    """Read and validate a rig file.

    Raises
    ------
    ConfigError
        If the file is missing, no YAML, or wrong; names the file and the key's path.
    """
    return _distinct(load_sheet(path, Rig, 'rig'), str(path))


def parse_rig(content: object, source: str) -> Rig:
    """Validate the content of a rig file; `source` names it in the error."""
    return _distinct(parse_sheet(content, Rig, source), source)


def _distinct(rig: Rig, source: str) -> Rig:
    """Return the rig, or refuse it if two IMUs have one name."""
    repeated = sorted({name for name in rig.names if rig.names.count(name) > 1})
    if repeated:
        msg = f'{source}: `imus` must have distinct names, got `{repeated[0]}` more than once.'
        raise ConfigError(msg)
    return rig


class _RigDumper(yaml.SafeDumper):
    """Block style for mappings, flow style for numbers, so that a matrix reads as a matrix."""


def _represent_list(dumper: yaml.SafeDumper, value: Sequence[object]) -> yaml.Node:
    flow = not any(isinstance(item, dict) for item in value)
    return dumper.represent_sequence('tag:yaml.org,2002:seq', value, flow_style=flow)


_RigDumper.add_representer(list, _represent_list)


def save_rig(rig: Rig, path: str | os.PathLike[str]) -> None:
    """Write a rig file atomically; a file that was there survives as `<path>.old`.

    Raises
    ------
    ConfigError
        If the file cannot be written; it stays as it was then.
    """
    content = rig.model_dump(mode='json', exclude_none=True)
    text = yaml.dump(content, Dumper=_RigDumper, sort_keys=False, allow_unicode=True, width=99)
    write_sheet(text, path, 'rig', keep_old=True)
