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
must each also pass on their own.  Other statistics, and thresholds that adapt to the person, are
those of `detectors`.

A stance foot has no velocity and yet rolls and trembles: `still` allows for that motion, and
holds for a zero-velocity update.  `resting` is the same test with hardly any tremor, passed
without a break for `resting_s`: then the rate is zero too.

.. [1] I. Skog et al., "Zero-velocity detection", IEEE Trans. Biomed. Eng. 57(11), 2010.
"""

from dataclasses import dataclass
from typing import get_args

import numpy as np

from multiimu_ros.arrays import as_vectors, Matrix, Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.detectors import (
    Detector,
    follow,
    GLRT,
    glrt,
    GYRO,
    law_of,
    means_pass,
    moments_of,
    NONE,
    score,
    scores_of,
)

CAPACITY = 512  # samples kept for the window: 0.25 s at 2 kHz
SHORTEST = 5  # samples of the shortest window, that of [1]_
RESTING_THRESHOLD = 12.0  # of rest, twice what noise alone scores

# Settings, those of `GlrtConfig`; TREMOR and LASTING are two squares each, of rate and force.
DETECTOR, RATE_BIAS, MAGNITUDE, THRESHOLD, WINDOW, GRAVITY, RESTING_TIME, TREMOR = range(8)
LASTING, SHARE, ATTACK, DECAY, LOW_TIME = 9, 11, 12, 13, 14
# State: samples so far, how long calm, level of the motion, how long the rate has been low.
COUNT, CALM, LEVEL, LOW = range(4)


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
    detector : {'glrt', 'gyro', 'moving_variance', 'ared', 'none'}
        What is scored; `none` never says still.
    swing_share : float
        Rather than by `threshold`, the rig is still while the root of the score is below this
        share of its recent level [-]; 0 for the fixed threshold.
    swing_attack, swing_decay : float
        How fast that level rises and falls [s].
    shortest_s : float
        How long the rate must have been low for the detector `gyro` [s].
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
    detector: Detector = 'glrt'
    swing_share: float = 0.0
    swing_attack: float = 0.2
    swing_decay: float = 2.0
    shortest_s: float = 0.05

    def __post_init__(self) -> None:
        if self.detector not in get_args(Detector):
            known = ', '.join(get_args(Detector))
            msg = f'`detector` must be one of {known}, got {self.detector!r}.'
            raise ValueError(msg)
        may_be_zero = ('rate_bias_sigma', 'force_magnitude_sigma', 'swing_share')
        for name, value in vars(self).items():
            if name != 'detector' and not (
                value > 0 or (value == 0 and name in may_be_zero)
            ):  # also catches NaN
                msg = f'`{name}` must be positive, got {value}.'
                raise ValueError(msg)


def glrt_statistic(
    angular_rate: Vectors, specific_force: Vectors, config: GlrtConfig, window: int = SHORTEST
) -> Scalars:
    """Score every full window of noise-free readings: small is still, large is moving.

    Parameters
    ----------
    angular_rate, specific_force : (N, 3) arrays
        Calibrated readings in the body frame [rad/s], [m/s^2].
    config : GlrtConfig
        Its `angular_rate_sigma` and `specific_force_sigma` stand for all of a sample's noise,
        its `detector` says what is scored.
    window : int
        Window length W [samples].

    Returns
    -------
    (N - W + 1,) array
        Statistic of the window that starts at each sample [-].
    """
    rate = as_vectors(angular_rate, 'angular_rate')
    force = as_vectors(specific_force, 'specific_force')
    if not len(rate) == len(force) >= window:
        msg = f'Need >= {window} sample pairs, got {len(rate)} rates, {len(force)} forces.'
        raise ValueError(msg)
    tremor = np.square([config.angular_rate_sigma, config.specific_force_sigma])
    law = law_of(tremor, np.zeros(2), config.rate_bias_sigma, config.force_magnitude_sigma)
    code = get_args(Detector).index(config.detector)
    return scores_of(code, np.hstack((rate, force)), window, law, config.gravity)


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
    """Add one sample; say whether the rig is still, and whether it rests."""
    detector, gravity, share = int(settings[DETECTOR]), settings[GRAVITY], settings[SHARE]
    if detector == NONE:
        return False, False
    if dt > 2.0 * settings[WINDOW] + 0.1:
        state[:] = 0.0  # after a gap, old samples say nothing about the present
    newest = int(state[COUNT]) % CAPACITY
    samples[newest, :3], samples[newest, 3:], steps[newest] = rate, force, dt
    state[COUNT] += 1.0
    window = _window_length(steps, newest, min(int(state[COUNT]), CAPACITY), settings[WINDOW])
    if window == 0:
        return False, False
    moments = moments_of(samples, newest, window)
    noise = np.array([np.mean(rate_density**2), np.mean(force_density**2)]) / dt
    tremor, lasting = settings[TREMOR:LASTING], settings[LASTING:SHARE]
    law = law_of(lasting, noise, settings[RATE_BIAS], settings[MAGNITUDE])
    calm = glrt(moments, window, law, gravity) < RESTING_THRESHOLD and means_pass(
        moments, window, lasting, noise, law, gravity
    )
    law = law_of(tremor, noise, settings[RATE_BIAS], settings[MAGNITUDE])
    value = score(detector, moments, rate, window, law, gravity)
    if share > 0.0:
        if np.isfinite(value):
            state[LEVEL] = follow(state[LEVEL], value, dt, settings[ATTACK], settings[DECAY])
        still = value < (share * state[LEVEL]) ** 2
    else:
        still = value < settings[THRESHOLD] and (
            detector != GLRT or means_pass(moments, window, tremor, noise, law, gravity)
        )
    if detector == GYRO:
        state[LOW] = state[LOW] + dt if still else 0.0
        still = state[LOW] >= settings[LOW_TIME]
    state[CALM] = state[CALM] + dt if calm else 0.0
    return still or calm, calm and state[CALM] >= settings[RESTING_TIME]


class StillnessDetector:
    """The test on a live stream, one sample at a time."""

    def __init__(self, config: GlrtConfig) -> None:
        self._settings = np.array(
            [
                get_args(Detector).index(config.detector),
                config.rate_bias_sigma, config.force_magnitude_sigma,
                config.threshold, config.window_s, config.gravity, config.resting_s,
                config.angular_rate_sigma**2, config.specific_force_sigma**2,
                config.resting_rate_sigma**2, config.resting_force_sigma**2,
                config.swing_share, config.swing_attack, config.swing_decay, config.shortest_s,
            ]
        )  # fmt: skip
        self._samples = np.zeros((CAPACITY, 6))
        self._steps = np.zeros(CAPACITY)
        self._state = np.zeros(4)

    @property
    def arrays(self) -> tuple[Matrix, Vector, Vector, Vector]:
        """What `detect` changes in place, and its settings."""
        return self._samples, self._steps, self._state, self._settings

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
