"""What the experiments of thesis 9.1.4 share: the ring of eight, its groups, dead reckoning.

The thesis integrates: the rate to angles, the force without gravity to velocity and position, and
sets the velocity to zero whenever the rate is small (9.6).  A step adds a dt^2 / 2 to the position
whether or not its velocity is reset, which is all that moves the position of a board at rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Scalars, Vectors
from multiimu_ros.experiments.board import DEGREE, drawn_rig, instants, Readings, record, rms
from multiimu_ros.odometry.attitude import level
from multiimu_ros.odometry.strapdown import mechanise
from multiimu_ros.rig import Rig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.motion import Motion
from multiimu_ros.simulation.placements import ring

RATE_HZ = 100.0
IMUS = 8
LEVELLING = 2.0  # [s] of rest at the start
STILL_RATE = 1.0 * DEGREE  # [rad/s] the threshold of (9.6)
STILL_TIME = 0.3  # [s] that it must last: an instant below it, as printed, comes in mid-turn too
# IMU numbers from 1, as in the thesis; k and k + 4 are opposite.
GROUPS: dict[str, tuple[tuple[int, ...], ...]] = {
    '1 IMU': tuple((k,) for k in range(1, 9)),
    '2 IMUs': ((1, 5), (2, 6), (3, 7), (4, 8)),
    '4 IMUs': ((1, 3, 5, 7), (2, 4, 6, 8)),
    '8 IMUs': (tuple(range(1, 9)),),
}


@dataclass(frozen=True)
class Reckoned:
    """What integration made of one fused IMU.

    Parameters
    ----------
    angle_n : (N, 3) array
        Error of the attitude about the fixed axes [rad].
    velocity_n, position_n : (N, 3) arrays
        [m/s], [m].
    """

    angle_n: Vectors
    velocity_n: Vectors
    position_n: Vectors


def draw_board(motion: Motion, rng: np.random.Generator) -> tuple[Rig, Readings]:
    """Return the calibrated rig file of a newly drawn ring, and its raw readings (N, 8, 6)."""
    true = drawn_rig(ring(IMUS), [BMI160] * IMUS, rng)
    raw = record(true, motion, RATE_HZ, [BMI160] * IMUS, rng)
    return calibrated_rig(true, int(rng.integers(2**31))), raw


def chosen(group: Sequence[int]) -> list[int]:
    """Return the columns of a group of IMU numbers."""
    return [number - 1 for number in group]


def called(group: Sequence[int]) -> str:
    """Return the thesis' name of a group."""
    return '&'.join(map(str, group))


def reckon(fused: Vectors, motion: Motion, gravity: float = 9.80665) -> Reckoned:
    """Integrate a fused IMU (N, 6) from rest, with hard zero-velocity updates."""
    rate, force = fused[:, :3], fused[:, 3:]
    first = round(LEVELLING * RATE_HZ)
    # Tilt from the first rest; yaw is that of the truth, for no IMU knows it.
    start = level(force[:first].mean(axis=0))
    yaw = np.arctan2(motion.R_nb[0, 1, 0], motion.R_nb[0, 0, 0])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    stamps = instants(len(fused), RATE_HZ)
    attitude = mechanise(stamps, rate, force, turn @ start, np.zeros(3)).R_nb
    excess = np.linalg.norm(force[:first].mean(axis=0)) - gravity
    acceleration = np.einsum('nij,nj->ni', attitude, force) - [0.0, 0.0, gravity + excess]
    error = Rotation.from_matrix(attitude @ motion.R_nb.transpose(0, 2, 1)).as_rotvec()
    return Reckoned(error, *integrate(acceleration, is_still(rate)))


def is_still(rate: Vectors) -> Flags:
    """Flag the instants (N,) in a span of `STILL_TIME` in which the rate is below its limit."""
    slow = np.linalg.norm(rate, axis=1) < STILL_RATE
    width = round(STILL_TIME * RATE_HZ)
    inside = np.convolve(slow, np.ones(width), 'valid') > width - 0.5
    return np.asarray(np.convolve(inside, np.ones(width)) > 0.5)


def integrate(acceleration_n: Vectors, still: Flags) -> tuple[Vectors, Vectors]:
    """Return velocity and position (N, 3); the velocity is zero where `still` (N,) says so."""
    dt = 1 / RATE_HZ
    velocity = np.zeros_like(acceleration_n)
    for k in range(1, len(velocity)):
        if not still[k]:
            mean = 0.5 * (acceleration_n[k - 1] + acceleration_n[k])
            velocity[k] = velocity[k - 1] + dt * mean
    steps = dt * velocity[:-1] + 0.5 * dt**2 * acceleration_n[:-1]
    return velocity, np.vstack([np.zeros(3), np.cumsum(steps, axis=0)])


def worst(values: Vectors) -> Scalars:
    """Return the infinity norm (3,) of each axis."""
    return np.asarray(np.abs(values).max(axis=0))


def gain(errors: dict[str, Scalars]) -> float:
    """Return how many times smaller the error (3,) of eight is than that of one IMU."""
    return float(rms(errors['1 IMU']) / rms(errors['8 IMUs']))
