"""Five noise terms from an Allan curve, each with the confidence that the record allows.

    sigma^2(tau) = 3 Q^2 / tau^2 + N^2 / tau + (2 ln 2 / pi) B^2 + K^2 tau / 3 + R^2 tau^2 / 2

quantisation, random walk of angle or velocity (white noise), bias instability (flicker; flat at
0.664 B), random walk of the bias, and ramp [1]_.  It is linear in the squares.  None is negative
but that of Q: what a low-pass filter takes from white noise goes with 1 / tau^2 too, once tau is
longer than the filter; N is then still that below the filter's edge.  The fit weights with the
full covariance under its own result, iterated (`allan_covariance`), so that its sigmas hold
although the points share their samples.

All five are always in the model: a term that is left out shrinks the sigmas of its neighbours and
shifts them.  A term that is not twice its sigma is NaN, with the most that it can be and the
length of record that could tell.

.. [1] IEEE Std 952-1997, annex C.
"""

from dataclasses import dataclass
import math

import numpy as np
from scipy.optimize import nnls
from scipy.stats import chi2, norm

from multiimu_ros.arrays import Matrix, Scalars, Vector
from multiimu_ros.calibration.allan import AllanCurve
from multiimu_ros.calibration.allan_covariance import covariance_basis

TERMS = ('Q', 'N', 'B', 'K', 'R')
FLAT = 2 * math.log(2) / math.pi  # 0.664^2

ROUNDS = 6  # of weighting with the result
SIGNIFICANT = 2.0  # sigmas of the square
MISFIT = 1e-3  # p-value below which the five terms certainly do not explain the points
FITS = 0.1  # and above which they do, once that has happened
FILTERED_S = 0.3  # [s] up to here a low-pass filter of the sensor may spoil the points
SPARED = 2  # points that are left out where some had to be
DOUBLINGS = 12  # of the record, when asking how long it would have to be


@dataclass(frozen=True)
class Term:
    """One noise term of one axis, or of several together; NaN where the record cannot tell.

    Parameters
    ----------
    value, sigma : float
        Coefficient and its standard deviation [Q: u s, N: u/sqrt(Hz), B: u, K: u/s/sqrt(Hz),
        R: u/s].
    low, high : float
        95 % confidence interval; where `value` is NaN, zero and the most that it can be.
    needed_s : float
        Where `value` is NaN, the least length of record that would show a term of size `high`
        [s]; infinite where length does not help.
    """

    value: float
    sigma: float
    low: float
    high: float
    needed_s: float = math.nan

    @property
    def determined(self) -> bool:
        """Whether the record tells the term from zero."""
        return not math.isnan(self.value)


@dataclass(frozen=True)
class AllanFit:
    """The terms of one axis.

    Parameters
    ----------
    terms : dict
        Term by letter.
    squares : (5,) array
        Fitted Q^2, N^2, B^2, K^2, R^2, none but the first negative.
    free : (5,) array
        The same without that bound: unbiased, for means over axes.
    covariance : (5, 5) array
        Of `free`.
    dof : (P,) array
        Equivalent degrees of freedom of the Allan variances.
    misfit : float
        Chi-squared of the points per degree of freedom; above 1 it widens `covariance`.
    from_s : float
        Shortest averaging time in the fit [s].
    """

    terms: dict[str, Term]
    squares: Vector
    free: Vector
    covariance: Matrix
    dof: Scalars
    misfit: float
    from_s: float

    def variance(self, tau: Scalars) -> Scalars:
        """Return the Allan variance of the model at (P,) averaging times [u^2]."""
        return np.asarray(shapes(tau) @ self.squares)


def shapes(tau: Scalars) -> Matrix:
    """Return the Allan variance (P, 5) of each term of size 1 at averaging times [s]."""
    return np.stack([3 / tau**2, 1 / tau, np.full_like(tau, FLAT), tau / 3, tau**2 / 2], axis=1)


def deviation_band(deviation: Scalars, dof: Scalars, level: float = 0.95) -> tuple[Scalars, ...]:
    """Return the ends of the confidence intervals of Allan deviations (P,)."""
    tails = (0.5 + level / 2, 0.5 - level / 2)
    low, high = (deviation * np.sqrt(dof / chi2(dof).ppf(tail)) for tail in tails)
    return low, high


def fit_allan(curve: AllanCurve, axis: int) -> AllanFit:
    """Fit the five terms to one axis of a curve.

    Where they do not explain the points, as within the low-pass filter of a sensor, the shortest
    averaging times up to 0.3 s are left out, one after the other, until they do; and then two
    more, for a misfit ends to show before it ends.  Where nothing helps the sigmas are widened.
    """
    longest = int(np.searchsorted(curve.tau, FILTERED_S))
    tried = []
    for first in range(longest + 1):
        tried.append(_Fit(curve, axis, first))
        if tried[-1].p_value > (FITS if first else MISFIT):
            break
    else:  # it is not a filter: the best of bad fits, with wide sigmas
        return min(tried, key=lambda fit: fit.misfit).result()
    return _Fit(curve, axis, min(first + SPARED, longest) if first else 0).result()


class _Fit:
    """Generalised least squares with non-negative squares, from averaging time `first` on."""

    def __init__(self, curve: AllanCurve, axis: int, first: int) -> None:
        self._curve, self._basis = curve, covariance_basis(curve.count).since(first)
        self._factor = curve.factor[first:]
        self._variance = curve.deviation[first:, axis] ** 2
        self._solve()

    def _solve(self) -> None:
        rate = self._curve.rate_hz
        model = shapes(self._factor / rate)
        relative = self._factor / self._curve.count  # nearly the variance of a white one's
        covariance = np.diag(self._variance**2 * relative)
        for _ in range(ROUNDS):
            design, points = _whiten(covariance, model), _whiten(covariance, self._variance)
            self.squares = _bounded(design, points)
            covariance = self._basis.covariance(self.squares, rate, self._factor)
        design, points = _whiten(covariance, model), _whiten(covariance, self._variance)
        self.information = design.T @ design
        self.free = _inverse(self.information) @ design.T @ points
        dof = len(points) - int((self.squares != 0).sum())  # a bound that binds is no freedom
        square = float(np.sum((points - design @ self.squares) ** 2))
        self.p_value = float(chi2(dof).sf(square))
        self.misfit = square / dof

    def result(self) -> AllanFit:
        """Return the terms with their confidence."""
        spread = max(1.0, self.misfit) if self.p_value < MISFIT else 1.0
        covariance = spread * _inverse(self.information)
        whole = covariance_basis(self._curve.count)
        noisy = np.maximum(self.squares, 0.0)
        scatter = whole.covariance(noisy, self._curve.rate_hz, self._curve.factor)
        expected = shapes(self._curve.tau) @ noisy
        return AllanFit(
            terms={name: self._term(k, covariance, spread) for k, name in enumerate(TERMS)},
            squares=self.squares,
            free=self.free,
            covariance=covariance,
            dof=np.asarray(2 * expected**2 / np.diag(scatter)),
            misfit=self.misfit,
            from_s=float(self._factor[0] / self._curve.rate_hz),
        )

    def _term(self, index: int, covariance: Matrix, spread: float) -> Term:
        term = term_of(float(self.squares[index]), float(np.sqrt(covariance[index, index])))
        if term.determined:
            return term
        squares, most = self.squares.copy(), term.high**2
        for _ in range(ROUNDS):  # a larger term scatters more itself
            squares[index] = most
            sigma = np.sqrt(spread) * self._sigma(index, squares, self._curve.rate_hz)
            most = float(max(self.squares[index], 0.0) + SIGNIFICANT * sigma)
        return Term(math.nan, math.nan, 0.0, math.sqrt(most), self._needed(index, most))

    def _sigma(self, index: int, squares: Vector, rate: float) -> float:
        """Return the sigma of one square if `squares` were true and the rate another."""
        covariance = self._basis.covariance(squares, rate, self._factor)
        design = _whiten(covariance, shapes(self._factor / rate))
        return float(np.sqrt(_inverse(design.T @ design)[index, index]))

    def _needed(self, index: int, square: float) -> float:
        """Return the length at which a term of that size would be significant [s].

        A record twice as long with half the rate has the same basis; what it lacks are the
        shortest averaging times, which say nothing about slow noise.
        """
        if TERMS[index] in 'QN':
            return math.inf  # a matter of rate, not of length
        squares = self.squares.copy()
        squares[index] = square
        for factor in 2.0 ** np.arange(1, DOUBLINGS + 1):
            sigma = self._sigma(index, squares, self._curve.rate_hz / factor)
            if square > 2 * SIGNIFICANT * sigma:  # not by luck alone
                return float(factor * self._curve.count / self._curve.rate_hz)
        return math.inf


def term_of(square: float, sigma: float) -> Term:
    """Return the term whose square was estimated with that sigma.

    The interval ends where the wider of two laws does: below as if the square were normal, which
    allows for noise that covers the term; above as if it were a sum of squares, chi-squared with
    2 (square/sigma)^2 degrees of freedom.
    """
    if not square > SIGNIFICANT * sigma:
        return Term(math.nan, math.nan, 0.0, math.sqrt(max(square, 0.0) + SIGNIFICANT * sigma))
    value, dof = math.sqrt(square), 2 * (square / sigma) ** 2
    low = math.sqrt(square + norm.ppf(0.025) * sigma)
    return Term(value, sigma / (2 * value), low, value * math.sqrt(dof / chi2(dof).ppf(0.025)))


def _bounded(design: Matrix, points: Scalars) -> Vector:
    """Return the least-squares solution of which only the first unknown, Q^2, may be negative."""
    both = np.column_stack([design, -design[:, 0]])
    scale = np.linalg.norm(both, axis=0)
    solution = nnls(both / scale, points)[0] / scale
    return np.asarray(solution[:-1] - np.array([solution[-1], 0.0, 0.0, 0.0, 0.0]))


def _whiten(covariance: Matrix, values: Matrix) -> Matrix:
    """Return `values` (P, ...) in units in which the covariance is the identity.

    A ten-millionth more on the diagonal keeps the factorisation from failing.
    """
    root = np.linalg.cholesky(covariance + 1e-7 * np.diag(np.diag(covariance)))
    return np.asarray(np.linalg.solve(root, values), dtype=np.float64)


def _inverse(information: Matrix) -> Matrix:
    """Invert, with the unknowns scaled to like size first."""
    scale = np.diag(1 / np.sqrt(np.diag(information)))
    return np.asarray(scale @ np.linalg.inv(scale @ information @ scale) @ scale, np.float64)
