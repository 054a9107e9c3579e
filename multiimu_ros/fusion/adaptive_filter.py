"""A Kalman filter that learns R and Q from its innovations r, thesis (5.79)-(5.81) made whole.

With the gain K of any filter, right or wrong, and S = E r_n^2, C = E r_n r_{n+1}:

    R = (1 - K) S - C,      Q = K^2 S + 2 K C

(5.80) and (5.81) are these with C = 0, as it is for the right gain.  Alone they are true of
every gain, so R and Q learnt by them stay where they began: one number S cannot tell two.  The
covariance C of successive innovations is what tells them apart [1]_.

The innovations are those of filters of their own with the R and Q that are given, one per IMU:
what is learnt does not feed back into how it is learnt, and no master disturbs it.

.. [1] R. Mehra, "On the identification of variances and adaptive Kalman filtering", IEEE Trans.
   Autom. Control 15(2), 1970.
"""

import numpy as np

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.fusion.local_filters import kalman_step, KalmanLocal

WINDOW = 200  # [scans] R is then known to some 15 %
LEAST_NOISE = 0.01  # of S that R keeps: a gain of at most 99 %
LEAST_PART = 1e-6  # of what was believed before: coarse readings at rest never change
LEAST_GAIN = 0.01  # Q is at least its square of S, as for a gain of 1 %


class AdaptiveLocal(KalmanLocal):
    """The linear Kalman filter with R and Q as learnt from the last `window` scans.

    Until half a window has been seen, it believes what is given.  Q is that of one motion, the
    mean of what all IMUs show.  A motion that starts after a rest is late by part of a window.
    """

    def __init__(self, window: int = WINDOW) -> None:
        self._window = window
        self.restart()

    def restart(self) -> None:
        """Forget what was learnt."""
        self._terms: Vectors | None = None  # (4, W, K, A): R, Q, S, and whether there is one
        self._scans = 0

    def believe(self, z: Vectors, R: Vectors, Q: Scalars) -> tuple[Vectors, Scalars]:
        """Return R and Q as the scans before this one show them, then learn from this one."""
        if self._terms is None:
            self._begin(z.shape)
        assert self._terms is not None
        count = self._terms[3].sum(axis=0)
        enough = count >= self._window / 2
        noise, motion = R, Q
        if enough.any():
            noise, walk, spread = self._terms[:3].sum(axis=1) / np.maximum(count, 1.0)
            noise = np.maximum(noise, LEAST_NOISE * spread)
            noise = np.maximum(noise, LEAST_PART * np.where(np.isfinite(R), R, 0.0))
            noise = np.where(enough & np.isfinite(R), noise, R)
            walk = np.maximum(walk, LEAST_GAIN**2 * spread)
            walk = np.maximum(walk, LEAST_PART * Q)
            weights = enough / np.maximum(enough.sum(axis=0), 1)
            motion = np.where(enough.any(axis=0), (weights * walk).sum(axis=0), Q)
        self._learn(z, R, Q)
        return noise, motion

    def _begin(self, shape: tuple[int, ...]) -> None:
        self._terms = np.zeros((4, self._window, *shape))
        self._x, self._P = np.zeros(shape), np.full(shape, np.inf)
        self._last, self._gain = np.full(shape, np.nan), np.zeros(shape)

    def _learn(self, z: Vectors, R: Vectors, Q: Scalars) -> None:
        """Add the products of the last innovation and this one to the window."""
        assert self._terms is not None
        usable = np.isfinite(R) & np.isfinite(self._P)
        innovation = np.where(usable, z - self._x, np.nan)
        last, K = self._last, self._gain
        pair = np.isfinite(last) & usable
        square, cross = np.where(pair, last**2, 0.0), np.where(pair, last * innovation, 0.0)
        row = self._scans % self._window
        self._terms[0, row] = (1.0 - K) * square - cross
        self._terms[1, row] = K**2 * square + 2.0 * K * cross
        self._terms[2, row] = square
        self._terms[3, row] = pair
        self._scans += 1
        update = kalman_step(self._x, self._P, z, R, np.broadcast_to(Q, R.shape))
        self._x, self._P, self._gain, self._last = update.x, update.P, update.gain, innovation
