"""Where the IMUs sit: the boards of the source documents, from their CAD poses.

This is the knowledge-based registration of thesis 6.1: no measurement, the drawing says it.
All frames are right-handed with x forward, y left and z up; lever arms are in metres.
"""

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Vectors
from multiimu_ros.errors import ConfigError
from multiimu_ros.rig import Extrinsics, Imu, MAX_IMUS, Rig, RigFrame
from multiimu_ros.simulation.errors import BMI160, ImuErrors, noise_block

RING_RADIUS = 0.08  # [m] thesis 9.1.4: eight IMUs around a breadboard
ROW_PITCH = 0.025  # [m] three breakout boards side by side on a breadboard (TUM 3, figure 7a)
CUBE_EDGE = 0.06  # [m] a styrofoam cube (TUM 3, figure 7b)
FOOT_PITCH = 0.02  # [m] boards side by side on the instep
FACE_SPREAD = 0.015  # [m] between the IMUs that share a face of the cube

# Outward normals, in the order in which faces are used: the first three meet in one corner.
CUBE_FACES = ('z', 'x', 'y', '-x', '-y', '-z')
# Turns the sensor's z axis into the outward normal of each face.
FACE_TURN = {
    'z': [0, 0, 0],
    'x': [0, 90, 0],
    'y': [-90, 0, 0],
    '-x': [0, -90, 0],
    '-y': [90, 0, 0],
    '-z': [180, 0, 0],
}


def ring(n: int = 8, radius: float = RING_RADIUS) -> Rig:
    """Return `n` aligned IMUs evenly around a circle, the first one on the x axis."""
    angle = 2 * np.pi * np.arange(n) / n
    arms = radius * np.column_stack((np.cos(angle), np.sin(angle), np.zeros(n)))
    return placed(f'ring{n}', arms, [Rotation.identity()] * n)


def row(n: int = 3) -> Rig:
    """Return `n` aligned IMUs in a row along y, centred on the origin."""
    arms = np.zeros((n, 3))
    arms[:, 1] = ROW_PITCH * ((n - 1) / 2 - np.arange(n))
    return placed(f'row{n}', arms, [Rotation.identity()] * n)


def cube(n: int = 3) -> Rig:
    """Return `n` IMUs on the faces of a cube, z axes outward; a second round shifts sideways."""
    turns = [
        Rotation.from_euler('xyz', FACE_TURN[CUBE_FACES[k % 6]], degrees=True) for k in range(n)
    ]
    sideways = FACE_SPREAD * np.array([0, 1, -1])
    arms = [turn.apply([sideways[k // 6], 0, CUBE_EDGE / 2]) for k, turn in enumerate(turns)]
    return placed(f'cube{n}', np.array(arms), turns)


def foot(n: int = 3) -> Rig:
    """Return `n` IMUs in rows of three on the instep of a shoe, whose top slopes by 20 deg.

    The base frame is level where the foot stands flat, its origin at the middle of the first row.
    """
    slope = Rotation.from_euler('y', 20, degrees=True)
    grid = np.array([[-(k // 3), 1 - k % 3, 0] for k in range(n)])
    return placed(f'foot{n}', slope.apply(FOOT_PITCH * grid), [slope] * n)


def placed(
    name: str, lever_arms_b: Vectors, R_bs: list[Rotation], errors: ImuErrors = BMI160
) -> Rig:
    """Return the rig of IMUs at `lever_arms_b` (n, 3) [m] in attitudes `R_bs`.

    Raises
    ------
    ConfigError
        If there are fewer than 1 or more than 16 IMUs.
    """
    if not 1 <= len(lever_arms_b) <= MAX_IMUS:
        msg = f'`n` must be from 1 to {MAX_IMUS} IMUs, got {len(lever_arms_b)}; choose another.'
        raise ConfigError(msg)
    arms = np.round(lever_arms_b, 9) + 0.0  # no 1e-18 in a file for people, nor -0.0
    imus = tuple(
        Imu(
            name=f'imu{k}',
            frame_id=f'imu{k}_link',
            model=errors.model,
            noise=noise_block(errors),
            extrinsics=Extrinsics(rotation=tuple(turn.as_quat()), lever_arm=tuple(arm)),
        )
        for k, (arm, turn) in enumerate(zip(arms, R_bs, strict=True))
    )
    return Rig(version=1, rig=RigFrame(name=name, gravity=9.80665), imus=imus)
