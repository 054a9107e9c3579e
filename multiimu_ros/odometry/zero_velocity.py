"""Zero-velocity detection by the generalised likelihood-ratio test (GLRT, "SHOE") of [1]_.

A rig that stands still does not turn, and feels only gravity: a constant specific force of
length g.  The test scores how far W samples are from that, in units of their noise:

    T = mean(|w|^2) / sigma_w^2 + mean(|f - g*u|^2) / sigma_f^2,    u = mean(f) / |mean(f)|

Each mean square is the scatter about the mean plus the square of the mean's misfit.  The scatter
owes nothing to calibration, but the misfit does: a constant error of the rate, sigma_b, and of
the force's length, sigma_g, marginalised out (docs/derivations/zupt.md), leave

    T = scatter(w) / sigma_w^2 + |mean(w)|^2 / (sigma_w^2 + W sigma_b^2)
      + scatter(f) / sigma_f^2 + (|mean(f)| - g)^2 / (sigma_f^2 + W sigma_g^2)

which is [1]_ for sigma_b = sigma_g = 0.  At rest, W*T is chi-squared with 6W - 2 degrees of
freedom (sigma_f << g).  So many degrees of freedom could hide a wrong mean, hence the two means
must each also pass on their own.

A stance foot has no velocity and yet rolls and trembles: `still` allows for that motion, and
holds for a zero-velocity update.  `resting` is the same test with hardly any tremor, passed
without a break for `resting_s`: then the rate is zero too.

.. [1] I. Skog et al., "Zero-velocity detection", IEEE Trans. Biomed. Eng. 57(11), 2010.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import as_vectors, Matrix, Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled

CAPACITY = 512  # samples kept for the window: 0.25 s at 2 kHz
SHORTEST = 5  # samples of the shortest window, that of [1]_
GATE_SQUARE = 16.0  # a mean may be 4 sigma off: 1 in 900 for three axes, 1 in 16 000 for one


@dataclass(frozen=True, kw_only=True)
class GlrtConfig:
    """Settings of one detector.

    Parameters
    ----------
    angular_rate_sigma, specific_force_sigma : float
        Tremor of a still rig, one axis [rad/s], [m/s^2]; the sensor's own noise comes on top.
    resting_rate_sigma, resting_force_sigma : float
        Tremor of a resting rig [rad/s], [m/s^2].
    rate_bias_sigma, force_magnitude_sigma : float
        What the calibration leaves as a constant error [rad/s], [m/s^2].
    threshold : float
        Windows that score below it are still [-]; noise alone scores 6 on average.
    window_s : float
        Length of the window [s]; it never holds fewer than 5 samples.
    resting_s : float
        How long the stricter test must hold for rest [s].
    gravity : float
        Local gravity [m/s^2].
    """

    angular_rate_sigma: float
    specific_force_sigma: float
    resting_rate_sigma: float
    resting_force_sigma: float
    rate_bias_sigma: float = 0.0
    force_magnitude_sigma: float = 0.0
    threshold: float = 12.0
    window_s: float = 0.025
    resting_s: float = 1.0
    gravity: float = 9.80665

    def __post_init__(self) -> None:
        may_be_zero = ('rate_bias_sigma', 'force_magnitude_sigma')
        for name, value in vars(self).items():
            if not (value > 0 or (value == 0 and name in may_be_zero)):  # also catches NaN
                msg = f'`{name}` must be positive, got {value}.'
                raise ValueError(msg)


@compiled
def _moments(samples: Matrix, newest: int, window: int) -> tuple[Vector, float, float, float]:
    """Return mean rate (3,), its scatter, length of the mean force and its scatter.

    `samples` (M, 6) is a ring; the window ends at row `newest`.
    """
    size = len(samples)
    mean = np.zeros(6)
    for k in range(window):
        row = samples[(newest - k) % size]
        for axis in range(6):
            mean[axis] += row[axis]
    mean /= window
    scatter = np.zeros(2)
    for k in range(window):
        row = samples[(newest - k) % size]
        for axis in range(6):
            scatter[axis // 3] += (row[axis] - mean[axis]) ** 2
    scatter /= window
    length = np.sqrt(mean[3] ** 2 + mean[4] ** 2 + mean[5] ** 2)
    return mean[:3], scatter[0], length, scatter[1]


@compiled
def _score(
    spin: float, rate_scatter: float, excess: float, force_scatter: float, window: int, law: Vector
) -> float:
    """Return T; `law` (4,): variances of rate and force, of rate bias and force length."""
    turn = rate_scatter / law[0] + spin / (law[0] + window * law[2])
    push = force_scatter / law[1] + excess / (law[1] + window * law[3])
    return float(turn + push)


@compiled
def _batch(samples: Matrix, window: int, law: Vector, gravity: float) -> Scalars:
    scores = np.empty(len(samples) - window + 1)
    for start in range(len(scores)):
        rate, rate_scatter, length, scatter = _moments(samples, start + window - 1, window)
        spin = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
        scores[start] = _score(spin, rate_scatter, (length - gravity) ** 2, scatter, window, law)
    return scores


def glrt_statistic(
    angular_rate: Vectors, specific_force: Vectors, config: GlrtConfig, window: int = SHORTEST
) -> Scalars:
    """Score every full window of noise-free readings: small is still, large is moving.

    Parameters
    ----------
    angular_rate, specific_force : (N, 3) arrays
        Calibrated readings in the body frame [rad/s], [m/s^2].
    config : GlrtConfig
        Its `angular_rate_sigma` and `specific_force_sigma` stand for all of a sample's noise.
    window : int
        Window length W [samples].

    Returns
    -------
    (N - W + 1,) array
        Statistic T of the window that starts at each sample [-].
    """
    rate = as_vectors(angular_rate, 'angular_rate')
    force = as_vectors(specific_force, 'specific_force')
    if not len(rate) == len(force) >= window:
        msg = f'Need >= {window} sample pairs, got {len(rate)} rates, {len(force)} forces.'
        raise ValueError(msg)
    sigmas = (
        config.angular_rate_sigma,
        config.specific_force_sigma,
        config.rate_bias_sigma,
        config.force_magnitude_sigma,
    )
    return _batch(np.hstack((rate, force)), window, np.square(sigmas), config.gravity)


@compiled
def _window_length(steps: Vector, newest: int, count: int, window_s: float) -> int:
    """Return how many of the newest samples the window holds, 0 if they do not fill it yet."""
    span, window = steps[newest], 1
    while window < count and (window < SHORTEST or span < window_s * (1.0 - 1e-6)):
        span += steps[(newest - window) % CAPACITY]
        window += 1
    full = window == CAPACITY or (window >= SHORTEST and span >= window_s * (1.0 - 1e-6))
    return window if full else 0


@compiled
def _passes(
    moments: tuple[Vector, float, float, float],
    window: int,
    tremor: Vector,
    noise: Vector,
    settings: Vector,
) -> bool:
    """Judge one window; `tremor`, `noise` (2,) are variances of rate and force."""
    rate, rate_scatter, length, force_scatter = moments
    law = np.array(
        [tremor[0] + noise[0], tremor[1] + noise[1], settings[0] ** 2, settings[1] ** 2]
    )
    spin = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
    excess = (length - settings[4]) ** 2
    return bool(
        _score(spin, rate_scatter, excess, force_scatter, window, law) < settings[2]
        and spin < GATE_SQUARE * (tremor[0] + noise[0] / window + law[2])
        and excess < GATE_SQUARE * (tremor[1] + noise[1] / window + law[3])
    )


@compiled
def detect(
    samples: Matrix,
    steps: Vector,
    state: Vector,
    settings: Vector,
    dt: float,
    rate: Vector,
    force: Vector,
    rate_density: Vector,
    force_density: Vector,
) -> tuple[bool, bool]:
    """Add one sample; `state` is [samples so far, time at rest so far]."""
    if dt > 2.0 * settings[3] + 0.1:
        state[:] = 0.0  # after a gap, old samples say nothing about the present
    newest = int(state[0]) % CAPACITY
    samples[newest, :3], samples[newest, 3:], steps[newest] = rate, force, dt
    state[0] += 1.0
    window = _window_length(steps, newest, min(int(state[0]), CAPACITY), settings[3])
    if window == 0:
        return False, False
    moments = _moments(samples, newest, window)
    noise = np.array([np.mean(rate_density**2), np.mean(force_density**2)]) / dt
    still = _passes(moments, window, settings[6:8], noise, settings)
    calm = still and _passes(moments, window, settings[8:10], noise, settings)
    state[1] = state[1] + dt if calm else 0.0
    return still, calm and state[1] >= settings[5]


class StillnessDetector:
    """The test on a live stream, one sample at a time."""

    def __init__(self, config: GlrtConfig) -> None:
        self._settings = np.array(
            [
                config.rate_bias_sigma,
                config.force_magnitude_sigma,
                config.threshold,
                config.window_s,
                config.gravity,
                config.resting_s,
                config.angular_rate_sigma**2,
                config.specific_force_sigma**2,
                config.resting_rate_sigma**2,
                config.resting_force_sigma**2,
            ]
        )
        self._samples = np.zeros((CAPACITY, 6))
        self._steps = np.zeros(CAPACITY)
        self._state = np.zeros(2)

    def push(
        self,
        dt: float,
        angular_rate: Vector,
        specific_force: Vector,
        rate_density: Vector,
        force_density: Vector,
    ) -> tuple[bool, bool]:
        """Add a sample; say whether the newest window is still, and whether the rig rests.

        Parameters
        ----------
        dt : float
            Time since the previous sample [s]; the nominal step for the first one.
        angular_rate, specific_force : (3,) arrays
            Readings of the fused IMU [rad/s], [m/s^2]; after a NaN the window fills anew.
        rate_density, force_density : (3,) arrays
            Its white noise [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].

        Returns
        -------
        still, resting : bool
            Zero velocity; zero velocity and rate for at least `resting_s`.
        """
        if not dt > 0:
            msg = f'`dt` must be positive, got {dt}; for the first sample pass the nominal step.'
            raise ValueError(msg)
        still, resting = detect(
            self._samples,
            self._steps,
            self._state,
            self._settings,
            dt,
            angular_rate,
            specific_force,
            rate_density,
            force_density,
        )
        return still, resting
