"""Registration by tip calibration: a tracked pointer touches named corners of every board.

The drawing of board i has its corners b_k in the sensor's frame, the pointer measures them as
a_k = R_i b_k + p_i in the tracker's frame w (thesis 6.3, TUM report 2.2.1). With both sets about
their means this is Wahba's problem, and p_i = mean(a) - R_i mean(b). Relative to the main IMU

    R = R_main' R_i,    lever arm = R_main' (p_i - p_main).

Each coordinate of a tip errs by s, which is given or pooled from the residuals of all boards. To
first order the covariance of R_i (perturbed on the right) is s^2 (sum |b|^2 I - b b')^-1, that of
mean(a) s^2/N; both enter the relative pose of both boards. A mix-up of corners leaves a residual
of the size of the board; but where the drawing is symmetric, as a bare rectangle is, a mix-up
that follows the symmetry leaves none, and only gravity can tell (`TipFit.symmetric`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations
import os
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, model_validator
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.errors import CalibrationError
from multiimu_ros.registration.wahba import fit_rotation
from multiimu_ros.rig import Extrinsics, Triple
from multiimu_ros.rotations import skew
from multiimu_ros.sheet import load_sheet

MAX_MISFIT = 0.08  # of the board's radius, where no pointer sigma says what to expect
MIN_WIDTH = 0.05  # of the board's length, below which corners count as collinear
FALSE_ALARM = 1e-4  # chance that a good board is refused for its residual
ALL_ORDERS = 6  # corners up to which every mix-up is tried; exchanges of two beyond


class _Block(BaseModel):
    model_config = ConfigDict(extra='forbid', frozen=True)


class TipBoard(_Block):
    """The corners of one board, by name: as drawn in the sensor's frame, as measured [m]."""

    corners: Annotated[dict[str, Triple], Field(min_length=3)]
    points: dict[str, Triple]

    @model_validator(mode='after')
    def _same_names(self) -> 'TipBoard':
        if odd := sorted(self.corners.keys() ^ self.points.keys()):
            msg = f'`corners` and `points` must name the same corners, `{odd[0]}` is in one only'
            raise ValueError(msg)
        return self


class TipSurvey(_Block):
    """A tip calibration: all points in one frame of the tracker.

    Parameters
    ----------
    main : str
        The IMU in whose frame the others are wanted.
    pointer_sigma : float, optional
        Of one coordinate of one measured point [m]; from the residuals by default.
    imus : dict
        One `TipBoard` for each IMU.
    """

    version: Literal[1]
    main: str
    pointer_sigma: Annotated[FiniteFloat, Field(gt=0.0)] | None = None
    imus: Annotated[dict[str, TipBoard], Field(min_length=1)]

    @model_validator(mode='after')
    def _main_is_there(self) -> 'TipSurvey':
        if self.main not in self.imus:
            msg = f'`main` must be one of {", ".join(self.imus)}, got `{self.main}`'
            raise ValueError(msg)
        return self


@dataclass(frozen=True)
class TipFit:
    """Where each IMU sits in the main IMU's frame.

    Parameters
    ----------
    extrinsics : dict of Extrinsics
        By name; the main IMU's is the identity, exactly.
    residual_rms : dict of float
        Root mean square distance of the points from the fitted board [m].
    pointer_sigma : float
        Of one coordinate, as given or as the residuals say [m].
    symmetric : tuple of str
        IMUs whose corners fit in another order as well: check their axes by gravity.
    """

    extrinsics: dict[str, Extrinsics]
    residual_rms: dict[str, float]
    pointer_sigma: float
    symmetric: tuple[str, ...]


def load_tip(path: str | os.PathLike[str]) -> TipSurvey:
    """Read a tip calibration, the YAML form of `TipSurvey`.

    Raises
    ------
    ConfigError
        If the file is missing or wrong; names the key's path.
    """
    return load_sheet(path, TipSurvey, 'tip calibration')


def fit_tip(survey: TipSurvey) -> TipFit:
    """Fit the pose of each board, and return it relative to the main IMU's.

    Raises
    ------
    CalibrationError
        If corners are collinear, mixed up or badly measured; names the IMU and the corners.
    """
    fits = {
        name: _fit_board(name, board, survey.pointer_sigma) for name, board in survey.imus.items()
    }
    sigma = survey.pointer_sigma
    if sigma is None:
        freedom = sum(3 * len(fit.corners) - 6 for fit in fits.values())
        sigma = float(np.sqrt(sum(fit.square for fit in fits.values()) / freedom))
    main = fits[survey.main]
    extrinsics = {name: _relative(main, fit, sigma) for name, fit in fits.items()}
    zero = (0.0, 0.0, 0.0)
    extrinsics[survey.main] = Extrinsics(rotation_sigma=zero, lever_arm_sigma=zero)
    residuals = {name: float(np.sqrt(fit.square / len(fit.corners))) for name, fit in fits.items()}
    symmetric = tuple(name for name, board in survey.imus.items() if _is_symmetric(board))
    return TipFit(extrinsics, residuals, sigma, symmetric)


@dataclass(frozen=True)
class _BoardFit:
    corners: Vectors  # (N, 3) about their mean, in s
    mean: Vector  # of the corners, in s
    R_ws: Rotation
    position_w: Vector  # of the sensor's origin
    square: float  # sum of squared residuals

    @property
    def unit_covariance(self) -> Matrix:
        """Covariance of R_ws for a pointer sigma of 1 m."""
        b = self.corners
        return np.asarray(np.linalg.inv(np.sum(b**2) * np.eye(3) - b.T @ b), dtype=np.float64)


def _fit_board(name: str, board: TipBoard, sigma: float | None) -> _BoardFit:
    drawn = np.array(list(board.corners.values()))
    points = np.array([board.points[corner] for corner in board.corners])
    for what, places in (('corners', drawn), ('points', points)):
        lengths = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if lengths[1] <= MIN_WIDTH * lengths[0]:
            msg = f'The `{what}` of `{name}` lie on a line, about which the board may turn; '
            msg += 'measure a corner well off it.'
            raise CalibrationError(msg)
    square = _misfit(points, drawn)
    if square > _limit(drawn, sigma):
        raise CalibrationError(_blame(name, list(board.corners), points, drawn, sigma))
    mean = drawn.mean(axis=0)
    R_ws = fit_rotation(points - points.mean(axis=0), drawn - mean).rotation
    return _BoardFit(drawn - mean, mean, R_ws, points.mean(axis=0) - R_ws.apply(mean), square)


def _limit(drawn: Vectors, sigma: float | None) -> float:
    """Return the largest sum of squared residuals that passes for noise [m^2]."""
    if sigma is None:
        return float(MAX_MISFIT**2 * np.sum((drawn - drawn.mean(axis=0)) ** 2))
    return float(sigma**2 * chi2.isf(FALSE_ALARM, 3 * len(drawn) - 6))


def _residuals(points: Vectors, drawn: Vectors) -> Vectors:
    """Return those of the best rotation, also where it is not unique or the sets are mirrored."""
    a, b = points - points.mean(axis=0), drawn - drawn.mean(axis=0)
    left, _, right = np.linalg.svd(a.T @ b)
    left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
    return np.asarray(a - b @ (left @ right).T)


def _misfit(points: Vectors, drawn: Vectors) -> float:
    return float(np.sum(_residuals(points, drawn) ** 2))


def _orders(count: int) -> list[tuple[int, ...]]:
    """Return the mix-ups of corners to be tried, those that move fewest corners first."""
    if count <= ALL_ORDERS:
        orders = list(permutations(range(count)))[1:]
        return sorted(orders, key=lambda order: sum(k != i for i, k in enumerate(order)))
    exchanged = []
    for i, k in combinations(range(count), 2):
        order = list(range(count))
        order[i], order[k] = k, i
        exchanged.append(tuple(order))
    return exchanged


def _blame(
    name: str, corners: Sequence[str], points: Vectors, drawn: Vectors, sigma: float | None
) -> str:
    """Say which corners were mixed up, or else which point fits worst."""
    residuals = _residuals(points, drawn)
    rms = 1e3 * np.sqrt(np.mean(np.sum(residuals**2, axis=1)))
    for order in _orders(len(corners)):
        if _misfit(points[list(order)], drawn) < _limit(drawn, sigma):
            moved = ', '.join(f'`{corners[i]}`' for i, k in enumerate(order) if i != k)
            return (
                f'The corners {moved} of `{name}` look swapped: as they stand, they miss the '
                f'drawing by {rms:.2g} mm rms; exchange them, or measure them again.'
            )
    worst = corners[int(np.argmax(np.sum(residuals**2, axis=1)))]
    return (
        f'The points of `{name}` miss the drawing by {rms:.2g} mm rms, `{worst}` most; measure '
        'them again, or correct the drawing.'
    )


def _is_symmetric(board: TipBoard) -> bool:
    drawn = np.array(list(board.corners.values()))
    return any(
        _misfit(drawn[list(order)], drawn) < _limit(drawn, None) for order in _orders(len(drawn))
    )


def _relative(main: _BoardFit, fit: _BoardFit, sigma: float) -> Extrinsics:
    """Return the pose in the main IMU's frame; docs/derivations/registration_other_ways.md (5)."""
    R = main.R_ws.inv() * fit.R_ws
    lever_arm = main.R_ws.inv().apply(fit.position_w - main.position_w)
    turn, tilt = fit.unit_covariance, main.unit_covariance
    A = R.as_matrix()
    rotation = turn + A.T @ tilt @ A
    of_main, of_fit = skew(lever_arm - main.mean), A @ skew(fit.mean)
    place = of_main @ tilt @ of_main.T + of_fit @ turn @ of_fit.T
    place += (1 / len(main.corners) + 1 / len(fit.corners)) * np.eye(3)
    return Extrinsics.model_validate(
        {
            'rotation': R.as_quat().tolist(),
            'rotation_sigma': (sigma * np.sqrt(np.diag(rotation))).tolist(),
            'lever_arm': lever_arm.tolist(),
            'lever_arm_sigma': (sigma * np.sqrt(np.diag(place))).tolist(),
        }
    )
