"""All intrinsics, and the attitudes of the poses, in one maximum-likelihood fit.

Tedaldi's two fits take one after the other what a recording says at once: the gravity that poses
feel and the turns between them constrain the same attitudes.  Here those attitudes are unknowns,
every reading is weighed by its own covariance (white noise, the poses' own error, a walking bias;
`measurements`), and Gauss-Newton finds the maximum.  With one IMU this refines its intrinsics;
with several, all feel the same gravity and make the same moves, and their mutual rotations come
out of the same fit; what they all get wrong alike in a move is an unknown of that move (a slip).
The inverse of the information is the covariance of every parameter.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve, LinAlgError
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, Vector, Vectors
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig_calibration.imu_state import ImuState, ImuView, ROTATION, UNKNOWNS, Weights
from multiimu_ros.rig_calibration.measurements import measure, Rows, Slips, turned_angle

STEPS = 30
DONE = 1e-3  # of its sigma: a step that small changes nothing that anybody could see
HELD = 1e4  # [1/rad] of a yaw that nothing determines: any weight holds it, and bends nothing
COMPONENT_ROUNDS = 12
FIRST_TURN = 1e-7  # (0.3 mrad per rad)^2, where the first excess shows itself
FIRST_SLIP, LEAST_SLIP = 1e-5, 1e-9  # the former is (3 mrad per rad)^2
LEAST_ANGLE = 1e-3  # [rad] a rest that was cut in two is no move


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
    if len(views) > 1:  # coming from above, no single bad move bends the first fit
        weights = [replace(weight, turn=FIRST_SLIP) for weight in weights]
    problem = _Problem(
        tuple(views), tuple(states), tuple(weights), R_k, gravity, *_common_moves(views, states)
    )
    for _ in range(COMPONENT_ROUNDS):
        problem, rows, covariance = _settle(problem)
        previous, problem = problem.components, problem.reweighted(rows, covariance)
        close = 0.03 * max(problem.components)
        if np.allclose(previous, problem.components, rtol=0.03, atol=close):
            break
    problem, rows, covariance = _settle(problem)
    own = UNKNOWNS * len(problem.views)
    J, residual = problem.stacked(rows)
    square = float(residual @ residual)
    freedom = len(J) - float(np.einsum('mi,ij,mj->', J, covariance, J, optimize=True))
    keep = np.zeros((own, own))
    keep[np.ix_(problem.free[:own], problem.free[:own])] = covariance[
        : problem.free[:own].sum(), : problem.free[:own].sum()
    ]
    return Refined(problem.states, problem.weights, keep, problem.R_k, square / max(freedom, 1.0))


def _common_moves(views: Sequence[ImuView], states: Sequence[ImuState]) -> tuple[Slips, Vector]:
    """Return the slips, all zero, of the moves that several IMUs saw, and their angles [rad].

    One IMU alone cannot tell a slip from an error of its own.
    """
    angles: dict[tuple[int, int], list[float]] = {}
    for view, state in zip(views, states, strict=True):
        for move in view.transitions:
            own = turned_angle(view, state, move)
            angles.setdefault((move.start, move.stop), []).append(own)
    common = [move for move, seen in angles.items() if len(seen) > 1]
    places = {move: place for place, move in enumerate(common)}
    means = np.array([np.mean(angles[move]) for move in common])
    return Slips(places, np.zeros((len(common), 3))), means.clip(LEAST_ANGLE)


@dataclass(frozen=True)
class _Problem:
    views: tuple[ImuView, ...]
    states: tuple[ImuState, ...]
    weights: tuple[Weights, ...]
    R_k: Matrix
    gravity: float
    slips: Slips
    angles: Vector  # (U,): how far the board was turned in each of the moves [rad]
    slip: float = FIRST_SLIP  # variance of a slip per squared radian of its move

    @property
    def components(self) -> list[float]:
        """The variance components that are estimated here."""
        slip = [self.slip] if len(self.angles) else []
        return [*(weight.turn for weight in self.weights), *slip]

    @property
    def free(self) -> Flags:
        """Flag the columns that are unknown: all but the first IMU's rotation into itself."""
        flags = np.ones(UNKNOWNS * len(self.views) + 3 * (len(self.R_k) + len(self.angles)), bool)
        flags[ROTATION] = False
        flags[UNKNOWNS * len(self.views) :][: 3 * len(self.R_k)] = np.repeat(self.seen, 3)
        return flags

    @property
    def seen(self) -> Flags:
        """Flag the poses (P,) in which any IMU was heard: of the others nothing is known."""
        return np.asarray(np.any([view.poses.known for view in self.views], axis=0))

    def rows(self) -> list[Rows]:
        return [
            measure(view, state, self.R_k, self.gravity, weight, self.slips)
            for view, state, weight in zip(self.views, self.states, self.weights, strict=True)
        ]

    def stacked(self, rows: Sequence[Rows]) -> tuple[Matrix, Vector]:
        """Return derivatives (M, D) by the free unknowns and residuals (M,), slips' own last."""
        own, shared = UNKNOWNS * len(rows), 3 * len(self.angles)
        residual = np.concatenate([r.residual for r in rows])
        J = np.zeros((len(residual) + len(self.roots) + shared, len(self.free)))
        begin = 0
        for i, r in enumerate(rows):
            end = begin + len(r.residual)
            J[begin:end, UNKNOWNS * i : UNKNOWNS * (i + 1)] = r.own
            J[begin:end, own:] = r.attitudes
            begin = end
        for row, root in enumerate(self.roots, start=begin):
            column = own + 3 * root
            J[row, column : column + 3] = HELD * self.R_k[root, 2]
        weight = np.repeat(1 / (np.sqrt(self.slip) * self.angles), 3)
        J[len(J) - shared :, len(self.free) - shared :] = np.diag(weight)
        slipped = weight * self.slips.values.ravel()
        return J[:, self.free], np.concatenate((residual, np.zeros(len(self.roots)), slipped))

    @property
    def roots(self) -> list[int]:
        """First pose of every chain of moves: its yaw is free, and held."""
        P = len(self.R_k)
        moves = [(m.start, m.stop) for view in self.views for m in view.transitions]
        start, stop = np.array(moves).T
        graph = coo_array((np.ones(len(moves)), (start, stop)), shape=(P, P))
        labels = connected_components(graph, directed=False)[1]
        first = np.unique(labels, return_index=True)[1]
        return [int(root) for root in first if self.seen[root]]

    def moved(self, step: Matrix) -> '_Problem':
        full = np.zeros(len(self.free))
        full[self.free] = step
        own = UNKNOWNS * len(self.views)
        states = tuple(
            state.moved(full[UNKNOWNS * i : UNKNOWNS * (i + 1)])
            for i, state in enumerate(self.states)
        )
        turns = full[own:].reshape(-1, 3)
        P = len(self.R_k)
        R_k = self.R_k @ Rotation.from_rotvec(turns[:P]).as_matrix()
        slips = replace(self.slips, values=self.slips.values + turns[P:])
        return replace(self, states=states, R_k=R_k, slips=slips)

    def reweighted(self, rows: Sequence[Rows], covariance: Matrix) -> '_Problem':
        """Return the problem with the turns' own error as large as their residuals say.

        Helmert's estimate: the weighted squares of a group of residuals add up to its number less
        what the fit has spent on it.
        """
        J, residual = self.stacked(rows)

        def excess(part: slice) -> float:
            spent = np.einsum('mi,ij,mj->', J[part], covariance, J[part], optimize=True)
            left = len(J[part]) - float(spent)
            return float(np.sum(residual[part] ** 2)) / left if left > 1.0 else 1.0

        begin, weights = 0, []
        for r, weight in zip(rows, self.weights, strict=True):
            grown = excess(slice(begin + r.moves.start, begin + r.moves.stop))
            begin += len(r.residual)
            weights.append(replace(weight, turn=_raised(weight.turn, grown)))
        common = slice(len(J) - 3 * len(self.angles), None)
        slip = max(self.slip * excess(common), LEAST_SLIP)
        return replace(self, weights=tuple(weights), slip=slip)


def _raised(turn: float, excess: float) -> float:
    """Return the component that would explain the excess, coming from below or above."""
    if turn == 0.0:
        return FIRST_TURN if excess > 1.2 else 0.0
    return max(turn * excess, LEAST_SLIP)


def _settle(problem: _Problem) -> tuple[_Problem, list[Rows], Matrix]:
    """Iterate Gauss-Newton until the step is far below its own sigma."""
    for _ in range(STEPS):
        try:
            rows = problem.rows()
            J, residual = problem.stacked(rows)
            information = J.T @ J
            size = np.sqrt(np.diag(information)).clip(1e-300)
            factor = cho_factor(information / np.outer(size, size))
        except LinAlgError:  # far from any sensible attitude the moves lose their meaning
            break
        step = -cho_solve(factor, J.T @ residual / size) / size
        covariance = cho_solve(factor, np.eye(len(size))) / np.outer(size, size)
        known = UNKNOWNS * len(problem.views) - 3
        problem = problem.moved(step)
        if np.all(np.abs(step[:known]) < DONE * np.sqrt(np.diag(covariance)[:known])):
            return problem, problem.rows(), covariance
    msg = 'The joint fit does not settle; record more poses, and turn the board more slowly.'
    raise CalibrationError(msg)
