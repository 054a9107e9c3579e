"""The modified federated filter as the thesis prints it, kept to compare with; do not use it.

(8.25)-(8.27), with every P a number:

    P_m = P_f + Q,    P_f^-1 = P_m^-1 + sum P_i^-1,    X_f = P_f (P_m^-1 X_f + sum P_i^-1 X_i)
    b_i = P_i^2 / (P_m^2 + sum P_j^2),                 X_i = X_f,  P_i = P_f / b_i

The factor P_f is not printed; without it X_f is no estimate at all.  The rest is as printed: the
prior is counted (2 - b_m) times, the process noise is not shared, and b_i comes from the P_i that
were reset (and predicted) rather than from the noise.  So P_i / P_j becomes (P_j / P_i)^2 from
scan to scan: the logarithm of the ratio of two sensors is multiplied by -2 each time.  Equal
sensors stay equal; others end in a share of zero, unless Q is so large that it hides P_i / b_i.

.. [1] thesis "Multi-IMU", 8.1.2.2.
"""

import numpy as np

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.fusion.local_filters import LocalFilter
from multiimu_ros.fusion.masters import FilterDivergedError, fuse_information, Fused

ABSURD = 1e6  # sigmas of the noisiest measurement that the state may be away from all of them


class PrintedMaster:
    """The modified federated filter as printed; ends with an error when it diverges."""

    def __init__(self, local: LocalFilter, count: int, axes: int) -> None:
        self._local, self._scans = local, 0
        self._x, self._P = np.zeros((count, axes)), np.full((count, axes), np.inf)
        self._fused = np.zeros(axes), np.full(axes, np.inf)

    def step(self, z: Vectors, R: Vectors, Q: Scalars) -> Fused:
        """Fuse one scan, or raise FilterDivergedError."""
        with np.errstate(all='ignore'):  # what overflows is found by the check
            return self._step(z, *self._local.believe(z, R, Q))

    def _step(self, z: Vectors, R: Vectors, Q: Scalars) -> Fused:
        self._scans += 1
        prior, master = self._P + Q, self._fused[1] + Q
        update = self._local.step(self._x, self._P, z, R, np.broadcast_to(Q, R.shape), prior)
        x, P = fuse_information(
            np.vstack([self._fused[0], update.x]), np.vstack([master, update.P])
        )
        # Nothing was known of it before: its first estimate stands for its prediction.
        local = np.where(np.isinf(prior), update.P, prior)
        squares = np.where(np.isinf(local), 0.0, local**2)
        total = np.where(np.isinf(master), 0.0, master**2) + squares.sum(axis=0)
        b = squares / np.where(total > 0.0, total, 1.0)
        self._check(x, P, b, np.isfinite(local), z, R)
        self._fused = x, P
        self._x, self._P = np.broadcast_to(x, R.shape), np.where(b > 0.0, P / b, np.inf)
        return x.copy(), P.copy(), np.where(np.isfinite(R), b, 0.0)

    def _check(
        self, x: Scalars, P: Scalars, b: Vectors, known: Vectors, z: Vectors, R: Vectors
    ) -> None:
        seen = np.isfinite(R)
        sigma = np.sqrt(np.where(seen, R, 0.0).max(axis=0))
        off = np.where(seen, np.abs(np.where(seen, z, 0.0) - x), np.inf).min(axis=0)
        lost = seen.any(axis=0) & ~(off <= ABSURD * sigma)
        sound = np.isfinite(x).all() and (P > 0.0).all() and (b[known] > 0.0).all()
        if lost.any() or not sound:
            msg = (
                f'The `master` mfkf_printed has diverged after {self._scans} scans, as its '
                f'printed recursion does where sensors differ: choose `carlson`, which does not.'
            )
            raise FilterDivergedError(msg)
