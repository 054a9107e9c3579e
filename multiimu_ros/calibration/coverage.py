"""What a recording can determine before anything is fitted, and in words what it lacks.

Accelerometer.  Each still pose p gives one equation, |M S (raw - b)| = g, with M upper triangular
of unit diagonal [1]_.  About the nominal sensor, where raw = g u and u is the direction that
points up, its row of the Jacobian is

    g [u_x^2, u_y^2, u_z^2, u_x u_y, u_x u_z, u_y u_z],  -[u_x, u_y, u_z]

for scale, shear and bias: where the poses point decides everything, so that the standard
deviations of the parameters (Cramer and Rao) follow from the directions alone.

Gyroscope.  Its integrated rate must carry the up direction of one pose into that of the next
[1]_; what turns about the vertical leaves that direction where it is and teaches nothing.

Lever arms.  Between two points r apart the specific force differs by L r with
L = [a]x + [w]x [w]x (a angular acceleration): noise of density N on either side leaves
sigma = sqrt(2) N / sqrt(eigenvalue) [m] of the integral of L'L over time.

.. [1] D. Tedaldi et al., "A robust and easy to implement method for IMU calibration without
   external equipments", ICRA 2014.
"""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from multiimu_ros.arrays import as_matrix, as_vectors, Matrix, Scalars, Vector, Vectors
from multiimu_ros.rig import NOMINAL_BIAS_SIGMA, NOMINAL_SCALE_SIGMA

PARAMETERS = (
    *('scale x', 'scale y', 'scale z'),
    *('shear xy', 'shear xz', 'shear yz'),
    *('bias x', 'bias y', 'bias z'),
)
FACE = np.cos(np.deg2rad(35.0))  # a pose this close to a face stands for it
EDGE = np.cos(np.deg2rad(25.0))
SINGULAR = 1e-6  # of the greatest singular value: what noise makes of a zero is larger
TURN = np.pi / 3  # [rad] a quarter turn about each of three axes, as carelessly as hands do it
MIXED = 0.4  # of the greatest component: what else a direction's name mentions
POSE_SIGMA = 2e-3  # [m/s^2] of one mean at rest; decides only between poses equally new
UNIT_GRAVITY = 9.80665


def missing_poses(up_s: ArrayLike) -> tuple[str, ...]:
    """Name the faces and edges that no pose has had on top, the most useful first.

    A pose within 35 deg of a face, or within 25 deg of an edge, stands for it.  Useful is what
    gains most information about the nine parameters of the accelerometer, given the poses so far
    and those named before (a greedy D-optimal choice).

    Parameters
    ----------
    up_s : (P, 3) array
        Direction of the specific force of each static pose in the sensor frame [-].

    Returns
    -------
    tuple of str
        `+x up`, `-y+z up`: the axes of the sensor that should point up.
    """
    up = _unit(as_vectors(up_s, 'up_s'))
    limits = np.where(np.count_nonzero(CANDIDATES, axis=1) == 1, FACE, EDGE)
    open_ = [k for k in range(len(CANDIDATES)) if not (up @ CANDIDATES[k] >= limits[k]).any()]
    rows = pose_jacobian(CANDIDATES, UNIT_GRAVITY) / POSE_SIGMA
    prior = np.r_[NOMINAL_SCALE_SIGMA.accelerometer, [0.01] * 3, NOMINAL_BIAS_SIGMA.accelerometer]
    seen = pose_jacobian(up, UNIT_GRAVITY) / POSE_SIGMA
    information = seen.T @ seen + np.diag(prior**-2.0)
    names = []
    while open_:
        gains = np.einsum('ki,ki->k', rows[open_], np.linalg.solve(information, rows[open_].T).T)
        # Faces come first in the list, and win a tie but for rounding.
        best = open_.pop(int(np.flatnonzero(gains >= gains.max() * (1 - 1e-9))[0]))
        names.append(f'{name_direction(CANDIDATES[best], signed=True)} up')
        information += np.outer(rows[best], rows[best])
    return tuple(names)


def pose_jacobian(up_s: ArrayLike, gravity: float) -> Matrix:
    """Return d|M S (raw - b)| by scale, shear and bias (P, 9), about the nominal sensor.

    Parameters
    ----------
    up_s : (P, 3) array
        Unit vectors of the specific force in the sensor frame [-].
    gravity : float
        Local gravity [m/s^2].
    """
    x, y, z = as_vectors(up_s, 'up_s').T
    squares = np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1)
    return np.hstack([gravity * squares, -np.stack([x, y, z], axis=1)])


def pose_sigmas(up_s: ArrayLike, force_sigma: float, gravity: float) -> Vector:
    """Predict the standard deviation of the nine accelerometer parameters; see `PARAMETERS`.

    Parameters
    ----------
    up_s : (P, 3) array
        Direction of the specific force of each static pose in the sensor frame [-].
    force_sigma : float
        Standard deviation of the mean of one pose [m/s^2].
    gravity : float
        Local gravity [m/s^2].

    Returns
    -------
    (9,) array
        Of scale [-], shear [rad] and bias [m/s^2]; infinite where the poses do not tell.
    """
    units = np.r_[np.full(6, gravity), np.ones(3)]  # all columns become directions
    jacobian = pose_jacobian(_unit(as_vectors(up_s, 'up_s')), gravity) / units
    padded = np.vstack([jacobian, np.zeros((9, 9))])
    _, singular, axes = np.linalg.svd(padded, full_matrices=False)
    seen = singular > SINGULAR * max(singular.max(), SINGULAR)
    unseen = np.square(axes[~seen]).sum(axis=0) > SINGULAR
    variance = np.square(axes[seen] / singular[seen, np.newaxis]).sum(axis=0)
    return np.where(unseen, np.inf, force_sigma * np.sqrt(variance) / units)


@dataclass(frozen=True)
class RotationCoverage:
    """How much a board was turned between poses, as far as gravity shows it.

    Parameters
    ----------
    turned : (3,) array
        About each axis of the sensor, over all turns [rad].
    principal : (3,) array
        Root of the summed squares about the principal axes of all turns, ascending [rad].
    lacking : tuple of str
        Axes that lack a quarter turn or its worth: `x`, or `x+y` for one in between.
    """

    turned: Vector
    principal: Vector
    lacking: tuple[str, ...]


def rotation_coverage(turns: ArrayLike, up_s: ArrayLike) -> RotationCoverage:
    """Say about which axes the board was turned between poses.

    Parameters
    ----------
    turns : (T, 3) array
        Integral of the angular rate from each pose to the next [rad].
    up_s : (T, 3) array
        Direction of the specific force at the end of each [-]; what turns about it is not seen.
    """
    turn, up = as_vectors(turns, 'turns'), _unit(as_vectors(up_s, 'up_s'))
    seen = turn - up * np.einsum('ti,ti->t', turn, up)[:, np.newaxis]
    squares, axes = np.linalg.eigh(seen.T @ seen)
    principal = np.sqrt(np.maximum(squares, 0.0))
    lacking = _lacking(principal, axes)
    return RotationCoverage(np.abs(seen).sum(axis=0), principal, lacking)


def _lacking(principal: Vector, axes: Matrix) -> tuple[str, ...]:
    """Name the principal axes that were turned about too little; those of the sensor if all."""
    weak = principal < TURN
    if weak.all():
        return ('x', 'y', 'z')
    if weak.sum() == 2:  # any two axes of the plane; take those of the sensor that lie in it
        strong = np.abs(axes[:, 2])
        return tuple('xyz'[k] for k in range(3) if k != int(np.argmax(strong)))
    return tuple(name_direction(axis) for axis in axes.T[weak])


@dataclass(frozen=True)
class LeverArmCoverage:
    """How well a lever arm can be told along its principal axes.

    Parameters
    ----------
    eigenvalues : (3,) array
        Of the integral of L'L over time, ascending [1/s^3].
    weakest : str
        The axis along which the lever arm is told worst: `x`, or `x+y` for one between.
    """

    eigenvalues: Vector
    weakest: str

    def sigmas(self, noise_density: float) -> Vector:
        """Predict the standard deviation along the principal axes, descending [m].

        Parameters
        ----------
        noise_density : float
            Of the specific force of either IMU [m/s^2/sqrt(Hz)].
        """
        with np.errstate(divide='ignore'):
            return np.asarray(np.sqrt(2.0 / self.eigenvalues) * noise_density)


def lever_arm_information(
    angular_rate: ArrayLike, angular_acceleration: ArrayLike, dt: Scalars
) -> Matrix:
    """Return the integral (3, 3) of L'L over time, L = [a]x + [w]x [w]x [1/s^3].

    Parameters
    ----------
    angular_rate, angular_acceleration : (N, 3) arrays
        In the sensor frame [rad/s], [rad/s^2].
    dt : (N,) array
        Time that each sample stands for [s].
    """
    spin = _cross_matrices(as_vectors(angular_rate, 'angular_rate'))
    tangential = _cross_matrices(as_vectors(angular_acceleration, 'angular_acceleration'))
    lever = tangential + spin @ spin
    return np.asarray(np.einsum('nki,nkj,n->ij', lever, lever, dt, optimize=True))


def lever_arm_coverage(information: ArrayLike) -> LeverArmCoverage:
    """Say how well, and along which axis worst, `lever_arm_information` tells a lever arm."""
    eigenvalues, axes = np.linalg.eigh(as_matrix(information, 'information'))
    rounding = SINGULAR**2 * eigenvalues[2]
    told = np.where(eigenvalues > rounding, eigenvalues, 0.0)
    return LeverArmCoverage(told, name_direction(axes[:, 0]))


def name_direction(vector: ArrayLike, *, signed: bool = False) -> str:
    """Name a direction by the axes that it goes along: `x`, `y-z`; `+x`, `-y+z` where signed.

    Without `signed` both ways along it are the same axis.
    """
    direction = np.asarray(vector, dtype=np.float64)
    strong = np.flatnonzero(np.abs(direction) >= MIXED * np.abs(direction).max())
    sign = 1.0 if signed else np.sign(direction[strong[0]])
    name = ''.join(f'{"+" if sign * direction[k] > 0 else "-"}{"xyz"[k]}' for k in strong)
    return name if signed else name.removeprefix('+')


def _cross_matrices(vectors: Vectors) -> Matrix:
    """Return the matrices [v]x (N, 3, 3), whose columns are v x e_k."""
    return np.asarray(np.cross(vectors[:, np.newaxis, :], np.eye(3)).transpose(0, 2, 1))


def _candidates() -> Vectors:
    """Return the 6 faces, then the 12 edges of a cube (18, 3)."""
    corners = np.array(list(product((0.0, 1.0, -1.0), repeat=3)))
    corners = corners[np.isin(np.abs(corners).sum(axis=1), (1, 2))]
    order = np.argsort(np.abs(corners).sum(axis=1), kind='stable')
    return _unit(corners[order])


def _unit(vectors: Vectors) -> Vectors:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


CANDIDATES = _candidates()
