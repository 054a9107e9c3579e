"""How much poses disagree beyond the white noise of their means: variance components.

A recording's own residuals say how far to trust its fit.  Their covariance is taken as

    V = W + e^2 C_0 + q C_1,

W the known white part, C_0 an error of each pose on its own (the hand, the table, a non-linear
sensor), C_1 a bias that walks from pose to pose (temperature, flicker).  e^2 and q maximise the
restricted likelihood [1]_, which allows for the parameters that the fit has spent.

.. [1] H. D. Patterson, R. Thompson, "Recovery of inter-block information when block sizes are
   unequal", Biometrika 58(3), 1971.
"""

from collections.abc import Sequence

import numpy as np
from scipy.linalg import cho_solve, cholesky, orth, solve_triangular
from scipy.optimize import minimize

from multiimu_ros.arrays import Matrix, Scalars, Vector

SMALLEST, LARGEST = 1e-4, 1e6  # of a component, beside the white part
STARTS = (0.03, 3.0)


def walk_covariance(time: Scalars) -> Matrix:
    """Return the covariance (P, P) of a unit random walk about its own mean at `time` (P,)."""
    walk = np.minimum.outer(time, time) - time.min()
    centre = np.eye(len(time)) - 1 / len(time)
    return np.asarray(centre @ walk @ centre)


def fit_components(
    residuals: Matrix, jacobian: Matrix, whites: Matrix, kernels: Sequence[Matrix]
) -> Vector:
    """Return the non-negative factors of the kernels under which the residuals are likeliest.

    Parameters
    ----------
    residuals : (A, M) array
        Residuals at, or near, the fitted parameters, of A independent axes of one nature.
    jacobian : (M, D) array
        Their derivatives with respect to the D parameters that were fitted to each axis.
    whites : (A, M) array
        Diagonals of W, positive.
    kernels : sequence of C (M, M) arrays
        Positive semidefinite.

    Returns
    -------
    (C,) array
        Factors, in units of the residuals squared per unit of the kernel.
    """
    level, spent = float(whites.mean()), orth(jacobian)  # any basis of what was fitted will do
    units = np.array([level / max(np.trace(kernel) / len(kernel), 1e-300) for kernel in kernels])

    def cost(logarithms: Vector) -> float:
        factors = units * np.exp(logarithms)
        K = np.asarray(sum(f * kernel for f, kernel in zip(factors, kernels, strict=True)))
        axes = zip(residuals, whites, strict=True)
        return sum(_restricted_likelihood(r, spent, np.diag(w) + K) for r, w in axes)

    bounds = [(np.log(SMALLEST), np.log(LARGEST))] * len(kernels)
    starts = [np.full(len(kernels), np.log(start)) for start in STARTS]
    fits = [minimize(cost, start, method='L-BFGS-B', bounds=bounds) for start in starts]
    best = min(fits, key=lambda fit: float(fit.fun))
    factors = np.where(best.x <= np.log(1.5 * SMALLEST), 0.0, np.exp(best.x))
    return np.asarray(units * factors)


def _restricted_likelihood(residual: Vector, jacobian: Matrix, V: Matrix) -> float:
    """Return -2 log of the restricted likelihood, but for a constant."""
    L = cholesky(V, lower=True)
    whitened = solve_triangular(L, np.column_stack([jacobian, residual]), lower=True)
    A, r = whitened[:, :-1], whitened[:, -1]
    information = cholesky(A.T @ A, lower=True)
    fitted = A @ cho_solve((information, True), A.T @ r)
    logarithms = np.log(np.diag(L)).sum() + np.log(np.diag(information)).sum()
    return float(2 * logarithms + np.sum((r - fitted) ** 2))
