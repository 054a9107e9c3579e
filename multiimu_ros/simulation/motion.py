"""What an ideal IMU in the base frame feels along a path, and the pose that goes with it.

With the attitude R_nb = Rz(yaw) Ry(pitch) Rx(roll), the angular rate is E(roll, pitch) times the
rates of roll, pitch and yaw, and its derivative follows by the product rule.  The specific force
is f_b = R_nb' (a_n + [0, 0, g]): at rest with z up it reads [0, 0, +g].
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, Scalars, Vector, Vectors
from multiimu_ros.simulation.paths import Path

STANDARD_GRAVITY = 9.80665  # [m/s^2]


@dataclass(frozen=True)
class Motion:
    """The truth at N instants; frames: b the base frame, n local level with z up.

    Parameters
    ----------
    time : (N,) array
        Since the start of the motion [s].
    position_n, velocity_n : (N, 3) arrays
        Of the base origin [m], [m/s].
    R_nb : (N, 3, 3) array
        Attitude, v_n = R_nb v_b.
    angular_rate_b, angular_acceleration_b : (N, 3) arrays
        [rad/s], [rad/s^2].
    specific_force_b : (N, 3) array
        At the base origin [m/s^2].
    still : (N,) bool array
        Whether nothing moves.
    """

    time: Scalars
    position_n: Vectors
    velocity_n: Vectors
    R_nb: Matrix
    angular_rate_b: Vectors
    angular_acceleration_b: Vectors
    specific_force_b: Vectors
    still: Flags

    def specific_force_at(self, lever_arm_b: Vector) -> Vectors:
        """Return the force (N, 3) at a point (3,) of the body: f + a x r + w x (w x r)."""
        rate = self.angular_rate_b
        swing = np.cross(self.angular_acceleration_b, lever_arm_b)
        pull = np.cross(rate, np.cross(rate, lever_arm_b))
        return np.asarray(self.specific_force_b + swing + pull)


@dataclass(frozen=True)
class Trajectory:
    """A motion that can be asked for at any instants; before and after its path it stands still.

    Parameters
    ----------
    path : Path
        Position and attitude of the base frame.
    duration : float
        What the motion was made for [s].
    gravity : float
        Local gravity [m/s^2].
    """

    path: Path
    duration: float
    gravity: float = STANDARD_GRAVITY

    def at(self, times: Scalars) -> Motion:
        """Return the truth at `times` (N,) [s], in any spacing."""
        value, first, second = self.path.at(times)
        R_nb = Rotation.from_euler('ZYX', value[:, [5, 4, 3]]).as_matrix()
        rate, angular_acceleration = _body_rates(value[:, 3:], first[:, 3:], second[:, 3:])
        feels_n = second[:, :3] + np.array([0.0, 0.0, self.gravity])
        force = np.einsum('nji,nj->ni', R_nb, feels_n)
        return Motion(
            times,
            value[:, :3],
            first[:, :3],
            R_nb,
            rate,
            angular_acceleration,
            force,
            self.path.still(times),
        )


def _body_rates(angles: Vectors, first: Vectors, second: Vectors) -> tuple[Vectors, Vectors]:
    """Return rate and acceleration (N, 3) in b from roll, pitch, yaw and their derivatives."""
    sr, cr = np.sin(angles[:, 0]), np.cos(angles[:, 0])
    sp, cp = np.sin(angles[:, 1]), np.cos(angles[:, 1])
    (r1, p1, y1), (r2, p2, y2) = first.T, second.T
    rate = np.column_stack((r1 - y1 * sp, p1 * cr + y1 * cp * sr, -p1 * sr + y1 * cp * cr))
    # d/dt of the yaw's share [-sp, cp sr, cp cr], and of the pitch's share [0, cr, -sr].
    acceleration = np.column_stack(
        (
            r2 - y2 * sp - y1 * cp * p1,
            p2 * cr - p1 * sr * r1 + y2 * cp * sr + y1 * (cp * cr * r1 - sp * sr * p1),
            -p2 * sr - p1 * cr * r1 + y2 * cp * cr - y1 * (cp * sr * r1 + sp * cr * p1),
        )
    )
    return rate, acceleration
