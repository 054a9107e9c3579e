"""The local filters of the sources: one state per IMU and axis, all stepped at once.

The state is one number (a rate or a specific force) that walks at random, seen with noise:

    x_n = x_{n-1} + w, w ~ (0, Q),      z_n = x_n + v, v ~ (0, R)

A local filter keeps no estimate of its own: it takes the estimates x, P (K, A) of the last scan
and returns those of this one, so that a master may feed back what it likes.  P infinite is a prior
that knows nothing: the first measurement is then the estimate.  R infinite is no measurement.

The thesis [1]_ prints W_i = lambda / (2 (M + lambda)) for the sigma points (5.96-5.97); it must be
1 / (2 (M + lambda)), or the weights do not sum to 1.

.. [1] thesis "Multi-IMU", 5.3.1: Kalman (5.73-5.78), unscented (5.92-5.108), fading (5.109-5.114).
"""

from typing import Literal, NamedTuple, Protocol

import numpy as np
from scipy.stats import chi2

from multiimu_ros.arrays import Flags, Scalars, Vectors

Local = Literal['kf', 'ukf', 'adaptive', 'afukf', 'particle']

# Spread of the sigma points (5.95).  With alpha = 1 no weight is large, which keeps 15 digits;
# kappa = 0 puts them at sqrt(3) sigma, the fourth moment of a Gaussian; beta = 2 suits one, too.
ALPHA, BETA, KAPPA = 1.0, 2.0, 0.0
AUGMENTED = 3  # state, process noise, measurement noise
SIGNIFICANCE = 1e-3  # q of (5.111): one false alarm in 1000 readings
SECANT_STEPS, SECANT_TOLERANCE = 60, 1e-12  # steps grow as Fibonacci's numbers: enough for 1e12


class Update(NamedTuple):
    """What the local filters make of one scan; all (K, A).

    Parameters
    ----------
    x, P : (K, A) arrays
        Estimates and the variances that the filters claim.
    gain : (K, A) array
        Weight of the measurement in the estimate; 0 where there was none.
    fading : (K, A) array
        What the predicted variance was multiplied by.
    """

    x: Vectors
    P: Vectors
    gain: Vectors
    fading: Vectors


class LocalFilter(Protocol):
    """K x A filters of one kind."""

    def believe(self, z: Vectors, R: Vectors, Q: Scalars) -> tuple[Vectors, Scalars]:
        """Return R (K, A) and Q (A,) as the filters believe them; most believe what is given."""

    def step(
        self, x: Vectors, P: Vectors, z: Vectors, R: Vectors, Q: Vectors, expected: Vectors
    ) -> Update:
        """Predict and update.

        Parameters
        ----------
        x, P : (K, A) arrays
            Estimates after the last scan, and their variances (infinite: unknown).
        z, R, Q : (K, A) arrays
            Measurements, their variances (infinite: none), and process noise of each filter.
        expected : (K, A) array
            True variance of the predicted state.  A federated master makes P + Q larger.
        """

    def restart(self) -> None:
        """Forget what was learnt."""


def predicted(P: Vectors, Q: Vectors, R: Vectors) -> tuple[Vectors, Flags, Flags]:
    """Return P + Q, 0 where unknown; where it is unknown; where there is a measurement."""
    prior = P + Q
    unknown = np.isinf(prior)
    prior[unknown] = 0.0
    return prior, unknown, np.isfinite(R)


def kalman_step(x: Vectors, P: Vectors, z: Vectors, R: Vectors, Q: Vectors) -> Update:
    """Step K x A linear Kalman filters, with the covariance in the form of Joseph."""
    prior, unknown, seen = predicted(P, Q, R)
    gain = prior / (prior + R)  # 0 where R is infinite
    gain[unknown & seen] = 1.0
    innovation = np.where(seen, z - x, 0.0)
    posterior = (1.0 - gain) ** 2 * prior + gain**2 * np.where(seen, R, 0.0)
    posterior[unknown & ~seen] = np.inf
    return Update(x + gain * innovation, posterior, gain, np.ones_like(gain))


def sigma_weights() -> tuple[Scalars, Scalars]:
    """Return the weights (7,) of mean and covariance, (5.96-5.97) without the misprint."""
    scaling = ALPHA**2 * (AUGMENTED + KAPPA) - AUGMENTED  # lambda
    mean = np.full(2 * AUGMENTED + 1, 0.5 / (AUGMENTED + scaling))
    mean[0] = scaling / (AUGMENTED + scaling)
    covariance = mean.copy()
    covariance[0] += 1.0 - ALPHA**2 + BETA
    return mean, covariance


MEAN_WEIGHTS, COVARIANCE_WEIGHTS = sigma_weights()


def unscented_step(x: Vectors, P: Vectors, z: Vectors, R: Vectors, Q: Vectors) -> Update:
    """Step K x A unscented filters on the augmented state (x, w, v) of (5.92-5.108).

    The last covariance is that of the corrected sigma points.  (5.108) is the same in algebra,
    but a difference, and may come out negative.
    """
    _, unknown, seen = predicted(P, Q, R)
    first = unknown & seen
    augmented = np.stack([P, Q, R])  # the diagonal of (5.94): a square root is one of its entries
    augmented[:, unknown | ~seen] = 0.0
    states, measured = _sigma_points(x, augmented)
    mean = np.tensordot(MEAN_WEIGHTS, states, 1)
    measurement = np.tensordot(MEAN_WEIGHTS, measured, 1)
    off, measured_off = states - mean, measured - measurement
    innovation_variance = np.tensordot(COVARIANCE_WEIGHTS, measured_off**2, 1)
    cross = np.tensordot(COVARIANCE_WEIGHTS, off * measured_off, 1)
    gain = np.divide(cross, innovation_variance, out=np.zeros_like(cross), where=seen & ~first)
    posterior = np.tensordot(COVARIANCE_WEIGHTS, (off - gain * measured_off) ** 2, 1)
    gain[first] = 1.0
    posterior[~seen] = (P + Q)[~seen]
    posterior[first] = R[first]
    innovation = np.where(seen, z - np.where(first, x, measurement), 0.0)
    return Update(x + gain * innovation, posterior, gain, np.ones_like(gain))


def _sigma_points(x: Vectors, augmented: Vectors) -> tuple[Vectors, Vectors]:
    """Return the predicted states and measurements (7, K, A) of the sigma points."""
    spread = ALPHA * np.sqrt((AUGMENTED + KAPPA) * augmented)
    points = np.zeros((3, 2 * AUGMENTED + 1, *x.shape))
    points[0] = x
    for i in range(AUGMENTED):
        points[i, 1 + i] += spread[i]
        points[i, 1 + AUGMENTED + i] -= spread[i]
    states = points[0] + points[1]
    return states, states + points[2]


def fading_factors(square: Vectors, prior: Vectors, R: Vectors, threshold: float) -> Vectors:
    """Find the factors >= 1 that bring squared innovations down to what chi-square allows.

    M^2 = square / (factor * prior + R) is to be `threshold`; the secant recursion (5.112-5.114)
    starts at 0 and 1.  M^2 is convex in the factor, so the iterates come from below and none is
    too large.  (Scaling S itself, as printed beside them, has no value at 0 to start from.)

    Parameters
    ----------
    square, prior, R : (K, A) arrays
        Squared innovation, predicted variance, noise (infinite: none).
    threshold : float
        Quantile of chi-square with one degree of freedom.
    """
    last, factor = np.zeros_like(square), np.ones_like(square)
    last_distance, distance = square / R, square / (prior + R)
    for _ in range(SECANT_STEPS):
        open_ = (distance > threshold * (1.0 + SECANT_TOLERANCE)) & (distance != last_distance)
        if not open_.any():
            break
        slope = np.ones_like(square)
        np.divide(factor - last, distance - last_distance, out=slope, where=open_)
        following = np.where(open_, factor - (distance - threshold) * slope, factor)
        last, last_distance = factor, distance
        factor, distance = following, square / (following * prior + R)
    return factor


class KalmanLocal:
    """The linear Kalman filter."""

    def believe(
        self,
        z: Vectors,  # noqa: ARG002
        R: Vectors,
        Q: Scalars,
    ) -> tuple[Vectors, Scalars]:
        """Believe what is given."""
        return R, Q

    def step(
        self,
        x: Vectors,
        P: Vectors,
        z: Vectors,
        R: Vectors,
        Q: Vectors,
        expected: Vectors,  # noqa: ARG002
    ) -> Update:
        """Predict and update."""
        return kalman_step(x, P, z, R, Q)

    def restart(self) -> None:
        """Nothing was learnt."""


class UnscentedLocal(KalmanLocal):
    """The unscented Kalman filter; on this linear model it is the linear one, at more cost."""

    def step(
        self,
        x: Vectors,
        P: Vectors,
        z: Vectors,
        R: Vectors,
        Q: Vectors,
        expected: Vectors,  # noqa: ARG002
    ) -> Update:
        """Predict and update."""
        return unscented_step(x, P, z, R, Q)


class FadingLocal(KalmanLocal):
    """The adaptive fading unscented filter: where a reading surprises, the prediction counts less.

    P and Q are multiplied by the factor before the sigma points are drawn again.
    """

    def __init__(self, significance: float = SIGNIFICANCE) -> None:
        self.threshold = float(chi2.isf(significance, 1))

    def step(
        self, x: Vectors, P: Vectors, z: Vectors, R: Vectors, Q: Vectors, expected: Vectors
    ) -> Update:
        """Predict, test, fade where the test fails, and update."""
        testable = np.isfinite(R) & np.isfinite(P + Q)
        square = np.where(testable, z - x, 0.0) ** 2
        prior = np.where(testable, expected, 0.0)
        if not (square > self.threshold * (prior + R)).any():
            return unscented_step(x, P, z, R, Q)
        fading = fading_factors(square, prior, R, self.threshold)
        return unscented_step(x, fading * P, z, R, fading * Q)._replace(fading=fading)
