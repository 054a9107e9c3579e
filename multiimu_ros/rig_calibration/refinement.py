"""All intrinsics, and the attitudes of the poses, in one maximum-likelihood fit.

Tedaldi's two fits take one after the other what a recording says at once: the gravity that poses
feel and the turns between them constrain the same attitudes.  Here those attitudes are unknowns,
every reading is weighed by its own covariance (white noise, the poses' own error, a walking bias;
`measurements`), and Gauss-Newton finds the maximum.  With one IMU this refines its intrinsics;
with several, all feel the same gravity and make the same moves, and their mutual rotations come
out of the same fit.  The inverse of the information is the covariance of every parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, Vectors
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig_calibration.measurements import (
    ImuState,
    ImuView,
    measure,
    ROTATION,
    Rows,
    UNKNOWNS,
    Weights,
)

STEPS = 30
DONE = 1e-3  # of its sigma: a step that small changes nothing that anybody could see
FREE_TURN = 1e-8  # [1/rad^2] holds the yaw, which nothing determines, without weighing in
COMPONENT_ROUNDS = 3


@dataclass(frozen=True)
class Refined:
    """The joint fit of K IMUs.

    Parameters
    ----------
    states : tuple of K ImuState
        Parameters.
    weights : tuple of K Weights
        Variance components; `turn` was estimated here.
    covariance : (33 K, 33 K) array
        Of all parameters; the rotation of the first IMU is not one, and zero.
    R_k : (P, 3, 3) array
        Attitudes of the first IMU in the poses; yaw is arbitrary.
    chi_square : float
        Weighted squared residual per degree of freedom; 1 if the weights are right.
    """

    states: tuple[ImuState, ...]
    weights: tuple[Weights, ...]
    covariance: Matrix
    R_k: Matrix
    chi_square: float

    def covariance_of(self, imu: int) -> Matrix:
        """Return the covariance (33, 33) of one IMU's parameters."""
        own = slice(UNKNOWNS * imu, UNKNOWNS * (imu + 1))
        return self.covariance[own, own]


def first_attitudes(up: Vectors, turns: Sequence[tuple[int, int, Matrix]]) -> Matrix:
    """Return attitudes (P, 3, 3) to begin with: level from gravity, yaw chained by the turns.

    Parameters
    ----------
    up : (P, 3) array
        Direction of the specific force in the first IMU's frame; NaN where unknown.
    turns : sequence of (int, int, (3, 3) array)
        From pose, to pose, and v_from = R v_to.
    """
    R_k = np.tile(np.eye(3), (len(up), 1, 1))
    for k, direction in enumerate(up):
        if np.isfinite(direction).all():
            R_k[k] = _level(np.eye(3), direction)
    for start, stop, R in turns:
        R_k[stop] = _level(R_k[start] @ R, up[stop])
    return R_k


def _level(R: Matrix, up: Vectors) -> Matrix:
    """Return the attitude nearest to `R` that has `up` on top."""
    tilted = R @ up
    axis = np.cross(tilted, [0.0, 0.0, 1.0])
    sine = np.linalg.norm(axis)
    if sine < 1e-12:  # upright, or upside down: any horizontal axis serves
        return np.asarray(R if tilted[2] > 0 else np.diag([1.0, -1.0, -1.0]) @ R)
    angle = np.arctan2(sine, tilted[2])
    return np.asarray(Rotation.from_rotvec(axis / sine * angle).as_matrix() @ R)


def refine(
    views: Sequence[ImuView],
    states: Sequence[ImuState],
    weights: Sequence[Weights],
    R_k: Matrix,
    gravity: float,
) -> Refined:
    """Fit all IMUs at once, starting near the answer.

    Parameters
    ----------
    views, states, weights : sequences of K
        What each IMU saw, its parameters and variance components so far.
    R_k : (P, 3, 3) array
        Attitudes of the first IMU in the poses so far.
    gravity : float
        [m/s^2].

    Raises
    ------
    CalibrationError
        If the fit does not settle.
    """
    problem = _Problem(tuple(views), tuple(states), tuple(weights), R_k, gravity)
    for _ in range(COMPONENT_ROUNDS):
        problem, rows, covariance = _settle(problem)
        previous, problem = problem.weights, problem.reweighted(rows, covariance)
        if np.allclose([w.turn for w in previous], [w.turn for w in problem.weights], rtol=0.02):
            break
    problem, rows, covariance = _settle(problem)
    own = UNKNOWNS * len(problem.views)
    square = sum(float(r.residual @ r.residual) for r in rows)
    freedom = sum(len(r.residual) for r in rows) - int(np.sum(problem.free))
    keep = np.zeros((own, own))
    keep[np.ix_(problem.free[:own], problem.free[:own])] = covariance[
        : problem.free[:own].sum(), : problem.free[:own].sum()
    ]
    return Refined(problem.states, problem.weights, keep, problem.R_k, square / max(freedom, 1))


@dataclass(frozen=True)
class _Problem:
    views: tuple[ImuView, ...]
    states: tuple[ImuState, ...]
    weights: tuple[Weights, ...]
    R_k: Matrix
    gravity: float

    @property
    def free(self) -> Flags:
        """Flag the columns that are unknown: all but the first IMU's rotation into itself."""
        flags = np.ones(UNKNOWNS * len(self.views) + 3 * len(self.R_k), bool)
        flags[ROTATION] = False
        return flags

    def rows(self) -> list[Rows]:
        return [
            measure(view, state, self.R_k, self.gravity, weight)
            for view, state, weight in zip(self.views, self.states, self.weights, strict=True)
        ]

    def jacobian(self, rows: Sequence[Rows]) -> Matrix:
        """Return the stacked derivatives (M, D) of all IMUs by the free unknowns."""
        own = UNKNOWNS * len(rows)
        J = np.zeros((sum(len(r.residual) for r in rows), len(self.free)))
        begin = 0
        for i, r in enumerate(rows):
            end = begin + len(r.residual)
            J[begin:end, UNKNOWNS * i : UNKNOWNS * (i + 1)] = r.own
            J[begin:end, own:] = r.attitudes
            begin = end
        return J[:, self.free]

    def moved(self, step: Matrix) -> '_Problem':
        full = np.zeros(len(self.free))
        full[self.free] = step
        own = UNKNOWNS * len(self.views)
        states = tuple(
            state.moved(full[UNKNOWNS * i : UNKNOWNS * (i + 1)])
            for i, state in enumerate(self.states)
        )
        turn = Rotation.from_rotvec(full[own:].reshape(-1, 3)).as_matrix()
        return replace(self, states=states, R_k=self.R_k @ turn)

    def reweighted(self, rows: Sequence[Rows], covariance: Matrix) -> '_Problem':
        """Return the problem with the turns' own error as large as their residuals say.

        Helmert's estimate: the weighted squares of a group of residuals add up to its number less
        what the fit has spent on it.
        """
        J, begin, weights = self.jacobian(rows), 0, []
        for r, weight in zip(rows, self.weights, strict=True):
            part = slice(begin + r.moves.start, begin + r.moves.stop)
            begin += len(r.residual)
            spent = float(np.einsum('mi,ij,mj->', J[part], covariance, J[part]))
            square = float(np.sum(r.residual[r.moves] ** 2))
            left = r.moves.stop - r.moves.start - spent
            excess = square / left if left > 1.0 else 1.0
            weights.append(replace(weight, turn=_raised(weight.turn, excess)))
        return replace(self, weights=tuple(weights))


FIRST_TURN = 1e-7  # (0.3 mrad per rad)^2, where the first excess shows itself


def _raised(turn: float, excess: float) -> float:
    """Return the component that would explain the excess, coming from below or above."""
    if turn == 0.0:
        return FIRST_TURN if excess > 1.2 else 0.0
    return turn * excess


def _settle(problem: _Problem) -> tuple[_Problem, list[Rows], Matrix]:
    """Iterate Gauss-Newton until the step is far below its own sigma."""
    for _ in range(STEPS):
        rows = problem.rows()
        J = problem.jacobian(rows)
        residual = np.concatenate([r.residual for r in rows])
        information = J.T @ J
        size = np.sqrt(np.diag(information)).clip(1e-300)
        scaled = information / np.outer(size, size) + FREE_TURN * np.eye(len(size))
        factor = cho_factor(scaled)
        step = -cho_solve(factor, J.T @ residual / size) / size
        covariance = cho_solve(factor, np.eye(len(size))) / np.outer(size, size)
        problem = problem.moved(step)
        known = UNKNOWNS * len(problem.views) - 3
        if np.all(np.abs(step[:known]) < DONE * np.sqrt(np.diag(covariance)[:known])):
            return problem, problem.rows(), covariance
    msg = 'The joint fit does not settle; record more poses, and turn the board more slowly.'
    raise CalibrationError(msg)
