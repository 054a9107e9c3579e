"""A bootstrap particle filter per IMU and axis, thesis (5.115)-(5.127): a reference.

Particles are drawn from the prior as importance density, p(x_n | x_{n-1}), so that their weights
are multiplied by the likelihood of the measurement.  Where the number of effective particles
1 / sum w^2 (5.127) falls under half, they are resampled systematically [1]_.

On this linear model it can only come near the Kalman filter.  Where the process noise is large
against the measurement noise few particles lie where the measurement is: N_eff is about
N sqrt(2 R / (P + Q)), and the error of the mean sqrt(P_posterior / N_eff).

.. [1] J. Carpenter, P. Clifford, P. Fearnhead, "Improved particle filter for nonlinear problems",
   IEE Proc. Radar Sonar Navig. 146(1), 1999.
"""

import numpy as np

from multiimu_ros.arrays import Flags, Matrix, Scalars, Vectors
from multiimu_ros.fusion.local_filters import KalmanLocal, Update

PARTICLES = 1000


class ParticleLocal(KalmanLocal):
    """K x A clouds of particles.

    A master may have changed the estimates since: the cloud is then moved and stretched to their
    mean and variance, which leaves its shape.
    """

    def __init__(self, seed: int, particles: int = PARTICLES) -> None:
        self._seed, self._particles = seed, particles
        self.restart()

    def restart(self) -> None:
        """Forget the clouds and begin the random numbers again."""
        self._rng = np.random.default_rng(self._seed)
        self._cloud: Matrix | None = None

    def step(
        self,
        x: Vectors,
        P: Vectors,
        z: Vectors,
        R: Vectors,
        Q: Vectors,
        expected: Vectors,  # noqa: ARG002
    ) -> Update:
        """Move, weigh and resample the clouds."""
        unknown, seen = np.isinf(P + Q), np.isfinite(R)
        first = unknown & seen
        cloud, weights = self._moved(x, P, unknown)
        noise = self._rng.standard_normal(cloud.shape)
        cloud = cloud + np.sqrt(np.where(unknown, 0.0, Q))[..., None] * noise
        prior = _moments(cloud, weights)[1]
        weights = _weighed(cloud, weights, z, R, seen & ~unknown)
        # A cloud that knew nothing is one of the measurement.
        cloud = np.where(
            first[..., None],
            np.where(first, z, 0.0)[..., None]
            + np.sqrt(np.where(first, R, 0.0))[..., None] * noise,
            cloud,
        )
        mean, variance = _moments(cloud, weights)
        # One particle with all the weight has no variance: never claim more than N readings would.
        variance = np.maximum(variance, np.where(seen, R, 0.0) / self._particles)
        variance[unknown & ~seen] = np.inf
        self._resample(cloud, weights)
        self._cloud, self._weights, self._x, self._P = cloud, weights, mean, variance
        gain = prior / (prior + R)
        gain[first] = 1.0
        return Update(mean, variance, gain, np.ones_like(gain))

    def _moved(self, x: Vectors, P: Vectors, unknown: Flags) -> tuple[Matrix, Matrix]:
        """Return the clouds and weights (K, A, N) with mean x and variance P."""
        if self._cloud is None:
            shape = (*x.shape, self._particles)
            self._cloud, self._weights = np.zeros(shape), np.full(shape, 1.0 / self._particles)
            self._x, self._P = np.zeros_like(x), np.full_like(P, np.inf)
        fresh = unknown | np.isinf(self._P)
        self._weights[fresh] = 1.0 / self._particles
        moved = ~unknown & ((x != self._x) | (P != self._P))
        if not moved.any():
            return self._cloud, self._weights
        cloud = self._cloud.copy()
        cloud[moved & fresh] = self._rng.standard_normal(
            (int((moved & fresh).sum()), cloud.shape[2])
        )
        mean, variance = _moments(cloud, self._weights)
        variance = np.where(variance > 0.0, variance, 1.0)
        scale = np.sqrt(np.where(moved, P, 1.0) / variance)
        shifted = x[..., None] + scale[..., None] * (cloud - mean[..., None])
        return np.where(moved[..., None], shifted, cloud), self._weights

    def _resample(self, cloud: Matrix, weights: Matrix) -> None:
        """Replace, in place, the clouds with few effective particles."""
        poor = effective_particles(weights) < self._particles / 2
        if poor.any():
            start = self._rng.random(int(poor.sum()))
            cloud[poor] = resample_systematically(cloud[poor], weights[poor], start)
            weights[poor] = 1.0 / self._particles


def effective_particles(weights: Matrix) -> Vectors:
    """Return N_eff (K, A) of (5.127) from weights (K, A, N) that sum to 1."""
    return np.asarray(1.0 / np.einsum('kan,kan->ka', weights, weights))


def resample_systematically(clouds: Vectors, weights: Vectors, start: Scalars) -> Vectors:
    """Draw N particles of each of M clouds (M, N) at equal steps through their weights.

    Parameters
    ----------
    clouds, weights : (M, N) arrays
        Particles, and weights that sum to 1.
    start : (M,) array
        Where in the first step to begin, uniform on [0, 1).

    Returns
    -------
    (M, N) array
        Particle i comes floor(N w_i) or ceil(N w_i) times.
    """
    particles = clouds.shape[1]
    reached = np.cumsum(weights, axis=1)
    reached /= reached[:, -1:]
    drawn = np.ceil(particles * reached - start[:, None]).clip(0, particles).astype(np.int64)
    drawn[:, -1] = particles
    copies = np.diff(drawn, axis=1, prepend=0)
    return np.repeat(clouds.ravel(), copies.ravel()).reshape(clouds.shape)


def _moments(cloud: Matrix, weights: Matrix) -> tuple[Vectors, Vectors]:
    mean = np.einsum('kan,kan->ka', weights, cloud)
    off = cloud - mean[..., None]
    return mean, np.einsum('kan,kan,kan->ka', weights, off, off)


def _weighed(cloud: Matrix, weights: Matrix, z: Vectors, R: Vectors, seen: Flags) -> Matrix:
    """Return the weights times the likelihood, normalised; the exponents are kept from -inf."""
    off = np.where(seen, z, 0.0)[..., None] - cloud
    exponent = -0.5 * off**2 * np.where(seen, 1.0 / R, 0.0)[..., None]
    likely = weights * np.exp(exponent - exponent.max(axis=2, keepdims=True))
    return np.asarray(likely / likely.sum(axis=2, keepdims=True))
