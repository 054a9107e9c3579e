"""The masters of the sources: how the estimates of K local filters become one.

    average           x = mean x_i                                      thesis (8.22)
    inverse_sigma     w_i ~ 1 / sigma_i, sigma_i = sqrt(R_i)            IJAMCE (11)-(13)
    inverse_variance  w_i ~ 1 / P_i
    carlson           information shared out, see `federated`           Carlson 1990
    mfkf_printed      thesis (8.25)-(8.27), see `printed_master`
    centralised       all measurements in one update: the reference

The local filters of the first three run on their own.  They all follow the same motion, so their
errors are correlated by the process noise that they share, and the variance of a weighted mean is
w'Cw with the covariance C of the errors.  Through the gains K of the local filters

    C+ = (1 - K) (1 - K)' * (C + Q) + diag(K^2 R)               (* is element by element)

holds for any local filter.  To take them as independent, P_f = sum w_i^2 P_i, claims too much.
"""

from typing import Literal, Protocol

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vectors
from multiimu_ros.errors import MultiImuError
from multiimu_ros.fusion.federated import information_shares
from multiimu_ros.fusion.local_filters import LocalFilter, Update

Master = Literal[
    'average', 'inverse_sigma', 'inverse_variance', 'mfkf_printed', 'carlson', 'centralised'
]
Mean = Literal['average', 'inverse_sigma', 'inverse_variance']
Reset = Literal['fusion', 'none', 'zero']
Fused = tuple[Scalars, Scalars, Vectors]  # x_f (A,), P_f (A,), shares (K, A)


class FilterDivergedError(MultiImuError):
    """A filter has run away, and what it says means nothing any more."""


class MasterFilter(Protocol):
    """A master over K x A local filters."""

    def step(self, z: Vectors, R: Vectors, Q: Scalars) -> Fused:
        """Fuse one scan; z, R (K, A), Q (A,)."""


def mean_weights(kind: Mean, R: Vectors, P: Vectors) -> Vectors:
    """Return the weights (K, A) of the local estimates; a column that nobody sees is 0.

    Parameters
    ----------
    kind : str
        Rule.
    R, P : (K, A) arrays
        Noise of the measurements (infinite: none in this scan), variance of the local estimates.
    """
    if kind == 'inverse_variance':
        weights = np.where(np.isfinite(R), 1.0 / P, 0.0)
    elif kind == 'inverse_sigma':
        weights = 1.0 / np.sqrt(R)
    else:
        weights = np.isfinite(R).astype(np.float64)
    total = weights.sum(axis=0)
    return np.asarray(weights / np.where(total > 0.0, total, 1.0))


def propagated(C: Matrix, update: Update, R: Vectors, Q: Scalars) -> Matrix:
    """Return the covariance (A, K, K) of the errors of the local estimates after a scan.

    A filter that knew nothing has gain 1: whatever C says of it is forgotten.
    """
    keeps = ((1.0 - update.gain) * np.sqrt(update.fading)).T
    after: Matrix = keeps[:, :, None] * keeps[:, None, :] * (C + Q[:, None, None])
    diagonal = np.arange(C.shape[1])
    after[:, diagonal, diagonal] += (update.gain**2 * np.where(np.isfinite(R), R, 0.0)).T
    return after


class MeanMaster:
    """Independent local filters and a weighted mean; nothing is fed back."""

    def __init__(self, kind: Mean, local: LocalFilter, count: int, axes: int) -> None:
        self._kind, self._local = kind, local
        self._x, self._P = np.zeros((count, axes)), np.full((count, axes), np.inf)
        self._C, self._weights = np.zeros((axes, count, count)), np.zeros((count, axes))

    def step(self, z: Vectors, R: Vectors, Q: Scalars) -> Fused:
        """Fuse one scan.  Nobody there: the last weights go on, with what their P then is."""
        R, Q = self._local.believe(z, R, Q)
        known = np.diagonal(self._C, axis1=1, axis2=2).T + Q
        update = self._local.step(self._x, self._P, z, R, np.broadcast_to(Q, R.shape), known)
        self._x, self._P = update.x, update.P
        self._C = propagated(self._C, update, R, Q)
        shares = mean_weights(self._kind, R, update.P)
        seen = np.isfinite(R).any(axis=0)
        self._weights = np.where(seen, shares, self._weights)
        weights = self._weights
        variance = np.einsum('ka,akl,la->a', weights, self._C, weights)
        variance[~weights.any(axis=0)] = np.inf  # nobody has ever seen it
        return (weights * update.x).sum(axis=0), variance, shares


def fuse_information(x: Vectors, P: Vectors) -> tuple[Scalars, Scalars]:
    """Return x_f = P_f sum P_i^-1 x_i and P_f = (sum P_i^-1)^-1; 0 and infinite if unknown."""
    information = 1.0 / P
    total = information.sum(axis=0)
    known = total > 0.0
    safe = np.where(known, total, 1.0)
    return (information * x).sum(axis=0) / safe, np.where(known, 1.0 / safe, np.inf)


class CentralisedMaster:
    """One Kalman filter that takes all measurements of a scan at once, in information form."""

    def __init__(self, local: LocalFilter, axes: int) -> None:
        self._local = local
        self._x, self._P = np.zeros(axes), np.full(axes, np.inf)

    def step(self, z: Vectors, R: Vectors, Q: Scalars) -> Fused:
        """Fuse one scan."""
        R, Q = self._local.believe(z, R, Q)
        values = np.vstack([self._x, np.where(np.isfinite(R), z, 0.0)])
        self._x, self._P = fuse_information(values, np.vstack([self._P + Q, R]))
        return self._x.copy(), self._P.copy(), information_shares(R)


class CarlsonMaster:
    """The federated filter, with no share for the master (b_m = 0), and its three resets.

    Shares are taken at the scan that follows a fusion, from the noises of that scan, and hold
    until the next.  Where nobody sees an axis in that scan, the shares of before go on.

    Fusion reset gives every filter its share of the fused state; no reset leaves the filters
    alone; zero reset leaves all that is known to the master (b_m = 1, b_i = 0): local filters
    then know their last reading only, and only with a fusion every scan is nothing lost.
    """

    def __init__(
        self, local: LocalFilter, count: int, axes: int, reset: Reset, every: int
    ) -> None:
        self._local, self._reset, self._every, self._scans = local, reset, every, 0
        self._x, self._P = np.zeros((count, axes)), np.full((count, axes), np.inf)
        self._error = np.zeros((count, axes))  # true variance of the local estimates
        self._b = np.zeros((count, axes))
        self._fused = np.zeros(axes), np.full(axes, np.inf)

    def step(self, z: Vectors, R: Vectors, Q: Scalars) -> Fused:
        """Fuse one scan; between two fusions, what they would be now."""
        R, Q = self._local.believe(z, R, Q)
        shares = information_shares(R)
        if self._scans % self._every == 0:
            self._share_out(shares)
        if self._reset == 'zero':
            self._P = np.full_like(R, np.inf)
        noise = np.full_like(R, np.inf)
        np.divide(Q, self._b, out=noise, where=self._b > 0.0)
        expected = self._error + Q
        update = self._local.step(self._x, self._P, z, R, noise, expected)
        measured = update.gain**2 * np.where(np.isfinite(R), R, 0.0)
        self._error = (1.0 - update.gain) ** 2 * update.fading * expected + measured
        self._x, self._P = update.x, update.P
        self._scans += 1
        x, P = self._fuse(Q)
        return x.copy(), P.copy(), np.where(np.isfinite(R), self._b, 0.0)

    def _fuse(self, Q: Scalars) -> tuple[Scalars, Scalars]:
        if self._reset != 'zero':
            self._fused = fuse_information(self._x, self._P)
            return self._fused
        x, P = self._fused
        self._fused = x, P + Q
        fused = fuse_information(np.vstack([x, self._x]), np.vstack([P + Q, self._P]))
        if self._scans % self._every == 0:
            self._fused = fused
        return fused

    def _share_out(self, shares: Vectors) -> None:
        seen = shares.any(axis=0)
        self._b = np.where(seen, shares, self._b)
        if self._reset == 'fusion':
            x, P = self._fused
            self._x = np.broadcast_to(x, self._b.shape)
            self._error = np.broadcast_to(np.where(np.isinf(P), 0.0, P), self._b.shape)
            self._P = np.full_like(self._b, np.inf)
            np.divide(P, self._b, out=self._P, where=self._b > 0.0)
