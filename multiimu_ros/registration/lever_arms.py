"""Where the IMUs sit on the body, from what their accelerometers feel differently while it turns.

    f_i = f_0 + L r_i + b_i + D_i f_0 + n_i,    L = [a]x + [w]x [w]x

in the frame of the body, with rate w and angular acceleration a.  Taking the mean over the IMUs
removes f_0; what is left is linear in the lever arms r_i, the biases b_i that calibration left,
and D_i, what it left of scale, misalignment and mounting.  Without D_i an error of 50 ppm in scale
would pass for a tenth of a millimetre where the board is rocked slowly.  One axis of rotation
leaves r unknown along itself; the prior of `REACH` keeps it finite there, and its sigma says so.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vectors

BLOCK_S = 1.0  # residuals of one second count as one: noise may have any colour
REACH = 0.1  # [m] what is known of a lever arm beforehand
MIXING = 1e-3  # [-] what calibration may have left of scale, misalignment and mounting
BIAS = 0.1  # [m/s^2]


@dataclass(frozen=True)
class LeverArms:
    """Positions of K IMUs relative to the first, in the frame of the body.

    Parameters
    ----------
    position : (K, 3) array
        [m]; the first is zero.
    covariance : (K, 3, 3) array
        [m^2].
    residual_rms : (K,) array
        What is left of the difference from the mean force [m/s^2].
    residual_rms_before : (K,) array
        The same with all lever arms at zero.
    """

    position: Vectors
    covariance: Matrix
    residual_rms: Scalars
    residual_rms_before: Scalars

    @property
    def sigma(self) -> Vectors:
        """Standard deviations (K, 3) [m]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))


def lever_arm_matrices(rate_products: Matrix, angular_acceleration: Vectors) -> Matrix:
    """Return L (N, 3, 3) from w w' (N, 3, 3) and the angular acceleration (N, 3).

    [w]x [w]x = w w' - |w|^2 I; the products come smoothed, for the product of two smoothed rates
    is not the smoothed product.
    """
    trace = np.trace(rate_products, axis1=1, axis2=2)
    L = rate_products - trace[:, np.newaxis, np.newaxis] * np.eye(3)
    x, y, z = angular_acceleration.T
    L[:, 0, 1] -= z
    L[:, 0, 2] += y
    L[:, 1, 0] += z
    L[:, 1, 2] -= x
    L[:, 2, 0] -= y
    L[:, 2, 1] += x
    return np.asarray(L)


def fit_lever_arms(
    force: Matrix, L: Matrix, block: Scalars, start: Vectors | None = None
) -> LeverArms:
    """Fit the positions of K IMUs.

    Parameters
    ----------
    force : (N, K, 3) array
        Calibrated and registered specific forces at common instants [m/s^2], all finite.
    L : (N, 3, 3) array
        Of the same instants, smoothed alike [1/s^2].
    block : (N,) int array
        Number of the second that each instant lies in.
    start : (K, 3) array, optional
        What the prior is centred at, relative to the first IMU; zero by default [m].
    """
    count = force.shape[1]
    centre = np.zeros((count, 3)) if start is None else start - start.mean(axis=0)
    mean = force.mean(axis=1)
    X = _regressors(L, mean)
    prior = np.repeat([REACH, BIAS, MIXING], [3, 3, 9])
    noise = np.var(force - mean[:, np.newaxis], axis=0).mean()
    A = np.einsum('nip,niq->pq', X, X)
    theta, residuals = np.zeros((count, 15)), np.empty((count, len(force), 3))
    for _ in range(3):  # the weight of the prior follows the noise
        information = A + noise * np.diag(prior**-2.0)
        for i in range(count):
            y = force[:, i] - mean
            known = np.r_[centre[i], np.zeros(12)]
            score = np.einsum('nip,ni->p', X, y - X @ known)
            theta[i] = known + np.linalg.solve(information, score)
            residuals[i] = y - X @ theta[i]
        noise = float(np.square(residuals).mean())
    inverse = np.linalg.inv(information)
    apart = residuals - residuals[0]
    covariance = _covariances(X, apart, block, inverse, 2 * noise**2 * np.diag(prior**-2.0))
    covariance[0] = 0.0
    before = np.sqrt(np.square(force - mean[:, np.newaxis]).sum(axis=2).mean(axis=0))
    after = np.sqrt(np.square(residuals).sum(axis=2).mean(axis=1))
    return LeverArms(theta[:, :3] - theta[0, :3], covariance, after, before)


def _regressors(L: Matrix, mean: Vectors) -> Matrix:
    """Return [L, I, kron(I, f')] (N, 3, 15)."""
    X = np.zeros((len(L), 3, 15))
    X[:, :, :3] = L
    X[:, :, 3:6] = np.eye(3)
    for row in range(3):
        X[:, row, 6 + 3 * row : 9 + 3 * row] = mean
    return X


def _covariances(
    X: Matrix, residuals: Matrix, block: Scalars, inverse: Matrix, prior: Matrix
) -> Matrix:
    """Return the covariance (K, 3, 3) of each lever arm less the first, from scores of blocks.

    A block pulls the fit towards itself, by X_b A^-1 X_b' of its noise; the jackknife's
    (I - A_b A^-1)^-1 undoes that.  `prior` (15, 15) is what the prior adds to the spread.
    """
    spread = np.tile(prior, (len(residuals), 1, 1))
    for number in np.unique(block):
        own = X[block == number].reshape(-1, 15)
        scores = residuals[:, block == number].reshape(len(residuals), -1) @ own
        scores = np.linalg.solve(np.eye(15) - own.T @ own @ inverse, scores.T).T
        spread += scores[:, :, np.newaxis] * scores[:, np.newaxis]
    return np.stack([_cautious(inverse, one) for one in inverse @ spread])


def _cautious(inverse: Matrix, relative: Matrix) -> Matrix:
    """Return inverse S inverse for positions (3, 3), nowhere below its own average level.

    A minute has few blocks that turn fast, so that the spread along a single direction is a
    chance figure, too small as often as too large; the level of all 15 together is well known.

    Parameters
    ----------
    inverse : (15, 15) array
        Of the information, in units in which the noise is one.
    relative : (15, 15) array
        inverse S: a multiple of the identity if all blocks were alike.
    """
    level = np.trace(relative) / 15
    root = np.linalg.cholesky(inverse[:3, :3])
    found = np.linalg.solve(root, (relative @ inverse)[:3, :3])
    values, axes = np.linalg.eigh(np.linalg.solve(root, found.T))
    turned = root @ axes
    return np.asarray(turned * np.maximum(values, level) @ turned.T)


def weakest_axis(L: Matrix) -> tuple[Scalars, Matrix]:
    """Return the eigenvalues (3,), ascending, and axes (3, 3) of the mean of L'L [1/s^4]."""
    values, axes = np.linalg.eigh(np.einsum('nji,njk->ik', L, L) / max(len(L), 1))
    return values, axes
