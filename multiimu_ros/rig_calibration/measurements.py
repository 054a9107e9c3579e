"""What the joint fit measures, linearised: the residuals of one IMU and their derivatives.

Beside the 33 unknowns of each IMU (`imu_state`) every pose has an attitude R_k of the first IMU
(3 unknowns).  With s = R_i' R_k' [0, 0, g], the specific force of the pose in the frame of IMU i:

    accelerometer in pose k   f_raw - (b_a + E_a^-1 s)
    gyroscope in pose k       w_raw - (b_g + E_g^-1 G s)
    gyroscope from k to l     Log(dR_i' R_i' R_k' R_l exp(slip) R_i),   dR_i the turn it integrated

A slip is what all gyroscopes of a board get wrong alike in one move, as when a knock is quicker
than their sampling: seen on real boards, where it is ten times their noise.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.calibration.poses import Transition
from multiimu_ros.calibration.preintegration import preintegrate
from multiimu_ros.calibration.tedaldi import UPPER
from multiimu_ros.calibration.variance import walk_covariance
from multiimu_ros.rig_calibration.imu_state import (
    FORCE_BIAS,
    ImuState,
    ImuView,
    RATE_BIAS,
    RATE_E,
    ROTATION,
    SENSITIVITY,
    UNKNOWNS,
    Weights,
)
from multiimu_ros.rotations import exp_so3, skew


@dataclass(frozen=True)
class Rows:
    """Whitened residuals (M,) of one IMU, derivatives by its unknowns (M, 33) and shared ones.

    `attitudes` (M, 3 P + 3 U) is dense, U slips last; `moves` says which rows are the turns.
    """

    residual: Vector
    own: Matrix
    attitudes: Matrix
    moves: slice


@dataclass(frozen=True)
class Slips:
    """Common errors of U moves: where each stands by (start, stop), and their values.

    Parameters
    ----------
    places : mapping
        Index of a slip by the move's first and last pose.
    values : (U, 3) array
        Rotation vectors at the end of each move, in the first IMU's frame [rad].
    """

    places: Mapping[tuple[int, int], int]
    values: Vectors


NO_SLIPS = Slips({}, np.zeros((0, 3)))


def measure(
    view: ImuView,
    state: ImuState,
    R_k: Matrix,
    gravity: float,
    weights: Weights,
    slips: Slips = NO_SLIPS,
) -> Rows:
    """Return residuals and derivatives of one IMU, whitened by their covariance.

    Parameters
    ----------
    R_k : (P, 3, 3) array
        Attitude of the first IMU in each pose, v_n = R_k v_0.
    gravity : float
        [m/s^2].
    slips : Slips
        Of the moves that several IMUs saw.
    """
    known = np.flatnonzero(view.poses.known)
    up = R_k[known, 2, :] * gravity  # third row: gravity's reaction in the first IMU's frame
    s = up @ state.R
    force = _force_rows(view, state, known, up, s)
    rate = _rate_rows(view, state, known, up, s)
    turn, J = _turn_rows(view, state, R_k, slips)
    shared = turn[2].shape[1]
    force, rate = (_widened(block, shared) for block in (force, rate))
    whitened = [
        _whiten(_force_covariance(view, weights, known), *force),
        _whiten(_rate_covariance(view, state, weights, known, J), *_stack(rate, turn)),
    ]
    residual, own, attitudes = (np.concatenate(parts) for parts in zip(*whitened, strict=True))
    return Rows(residual, own, attitudes, slice(6 * len(known), len(residual)))


Block = tuple[Vector, Matrix, Matrix]
Index = NDArray[np.intp]


def _stack(one: Block, other: Block) -> Block:
    residual, own, attitudes = (np.concatenate(parts) for parts in zip(one, other, strict=True))
    return residual, own, attitudes


def _widened(block: Block, columns: int) -> Block:
    """Return the block with columns of zeros for the slips, on which its rows do not depend."""
    residual, own, attitudes = block
    return residual, own, np.pad(attitudes, ((0, 0), (0, columns - attitudes.shape[1])))


def _whiten(V: Matrix, residual: Vector, own: Matrix, attitudes: Matrix) -> Block:
    stacked = np.column_stack((residual, own, attitudes))
    white = solve_triangular(cholesky(V, lower=True), stacked, lower=True)
    return white[:, 0], white[:, 1 : 1 + UNKNOWNS], white[:, 1 + UNKNOWNS :]


def _empty(rows: int, poses: int) -> Block:
    return np.zeros((rows, 3)), np.zeros((rows, 3, UNKNOWNS)), np.zeros((rows, 3, 3 * poses))


def _flat(residual: Vectors, own: Matrix, attitudes: Matrix) -> Block:
    rows = residual.size
    return residual.ravel(), own.reshape(rows, -1), attitudes.reshape(rows, -1)


def _force_rows(view: ImuView, state: ImuState, known: Index, up: Vectors, s: Vectors) -> Block:
    residual, own, attitudes = _empty(len(known), len(view.poses))
    inverse = np.linalg.inv(state.E_a)
    y = s @ inverse.T
    residual[:] = view.poses.specific_force[known] - state.force_bias - y
    for j in range(3):
        own[:, j, j] = y[:, j] / state.scale[j]
    for column, (row, col) in enumerate(zip(*UPPER, strict=True)):
        own[:, :, 3 + column] = np.outer(y[:, col] * state.scale[col], inverse[:, row])
    own[:, :, FORCE_BIAS] = -np.eye(3)
    for m, k in enumerate(known):
        own[m, :, ROTATION] = -inverse @ skew(s[m])
        attitudes[m, :, 3 * k : 3 * k + 3] = -inverse @ state.R.T @ skew(up[m])
    return _flat(residual, own, attitudes)


def _rate_rows(view: ImuView, state: ImuState, known: Index, up: Vectors, s: Vectors) -> Block:
    residual, own, attitudes = _empty(len(known), len(view.poses))
    inverse = np.linalg.inv(state.E)
    H = inverse @ state.G
    h = s @ H.T
    residual[:] = view.poses.angular_rate[known] - state.rate_bias - h
    own[:, :, RATE_E] = np.einsum('aj,mc->majc', inverse, h).reshape(-1, 3, 9)
    own[:, :, RATE_BIAS] = -np.eye(3)
    own[:, :, SENSITIVITY] = -np.einsum('aj,mc->majc', inverse, s).reshape(-1, 3, 9)
    for m, k in enumerate(known):
        own[m, :, ROTATION] = -H @ skew(s[m])
        attitudes[m, :, 3 * k : 3 * k + 3] = -H @ state.R.T @ skew(up[m])
    return _flat(residual, own, attitudes)


def _turn_rows(view: ImuView, state: ImuState, R_k: Matrix, slips: Slips) -> tuple[Block, Matrix]:
    moves, P = view.transitions, len(view.poses)
    residual, own, attitudes = _empty(len(moves), P + len(slips.values))
    force = (view.raw_force - state.force_bias) @ state.E_a.T
    gyroscope = state.E, state.rate_bias, state.G
    turned, J = preintegrate(view.time, view.raw_rate, force, moves, gyroscope)
    for m, move in enumerate(moves):
        k, m_to = move.start, move.stop
        D = R_k[k].T @ R_k[m_to]
        place = slips.places.get((k, m_to))
        if place is not None:
            D = D @ exp_so3(slips.values[place])
            column = 3 * (P + place)
            attitudes[m, :, column : column + 3] = state.R.T
        seen = state.R.T @ D @ state.R
        residual[m] = Rotation.from_matrix(turned[m].T @ seen).as_rotvec()
        own[m, :, 9:30] = -J[m]
        own[m, :, ROTATION] = np.eye(3) - seen.T
        attitudes[m, :, 3 * m_to : 3 * m_to + 3] += state.R.T
        attitudes[m, :, 3 * k : 3 * k + 3] -= state.R.T @ D.T
    return _flat(residual, own, attitudes), J


def _force_covariance(view: ImuView, weights: Weights, known: Index) -> Matrix:
    poses = view.poses
    walk = walk_covariance(poses.time[known])
    white = np.square(poses.force_density) / poses.duration[known, np.newaxis] + weights.force[0]
    return np.asarray(np.diag(white.ravel()) + weights.force[1] * np.kron(walk, np.eye(3)))


def _rate_covariance(
    view: ImuView, state: ImuState, weights: Weights, known: Index, J: Matrix
) -> Matrix:
    """Return the covariance of the rates in the poses and the turns between: one bias, walking."""
    poses, moves = view.poses, view.transitions
    rows, turns = 3 * len(known), 3 * len(moves)
    white = np.square(poses.rate_density) / poses.duration[known, np.newaxis] + weights.rate[0]
    calibrated = np.square(state.E) @ np.square(poses.rate_density)
    length = np.array([view.time[move.end - 1] - view.time[move.begin] for move in moves])
    angles = np.array([turned_angle(view, state, move) for move in moves])
    walked = np.outer(length, calibrated) + weights.turn * np.square(angles)[:, np.newaxis]
    V = np.diag(np.concatenate((white.ravel(), walked.ravel())))
    A = np.zeros((rows + turns, rows))
    A[:rows] = np.eye(rows)
    place = {int(k): m for m, k in enumerate(known)}
    for m, move in enumerate(moves):
        for k in (place[move.start], place[move.stop]):
            A[rows + 3 * m : rows + 3 * m + 3, 3 * k : 3 * k + 3] = 0.5 * J[m][:, 9:12]
    walk = np.kron(walk_covariance(poses.time[known]), np.eye(3))
    return np.asarray(V + weights.rate[1] * A @ walk @ A.T)


def turned_angle(view: ImuView, state: ImuState, move: Transition) -> float:
    """Return how far the board was turned in a move, all directions added up [rad]."""
    span = slice(move.begin, move.end)
    rate = np.linalg.norm((view.raw_rate[span] - state.rate_bias) @ state.E.T, axis=1)
    return float(np.trapezoid(rate, view.time[span]))
