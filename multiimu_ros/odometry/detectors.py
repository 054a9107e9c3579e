"""Statistics that tell a still rig from a moving one, and the level that each is held against.

All look at the W newest samples, and are mean squares in units of what a still rig shows [1]_:

    glrt              rate and force against "no turn, and a constant force of length g"
    moving_variance   scatter of the force about its mean
    ared              mean square of the rate
    gyro              square of the newest rate alone; it needs a least duration

Against a fixed threshold these need tuning, for the stance of a runner moves more than the swing
of who climbs stairs.  Divided by the motion of the same person's swings they need none: with A,
the root of the statistic, rising with `attack` and falling with `decay`, a rig is still below
(share A)^2.  Equations: docs/derivations/zupt.md.

.. [1] I. Skog et al., "Zero-velocity detection", IEEE Trans. Biomed. Eng. 57(11), 2010.
"""

from typing import get_args, Literal

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vector
from multiimu_ros.compiled import compiled

Detector = Literal['none', 'glrt', 'gyro', 'moving_variance', 'ared']
NONE, GLRT, GYRO, MOVING_VARIANCE, ARED = range(len(get_args(Detector)))
GATE_SQUARE = 16.0  # a mean may be 4 sigma off: 1 in 900 for three axes, 1 in 16 000 for one

Moments = tuple[Vector, float, float, float]


@compiled
def moments_of(samples: Matrix, newest: int, window: int) -> Moments:
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
def glrt(moments: Moments, window: int, law: Vector, gravity: float) -> float:
    """Return T; `law` (4,): variances of rate and force, of rate bias and force length."""
    rate, rate_scatter, length, force_scatter = moments
    spin = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
    turn = rate_scatter / law[0] + spin / (law[0] + window * law[2])
    push = force_scatter / law[1] + (length - gravity) ** 2 / (law[1] + window * law[3])
    return float(turn + push)


@compiled
def means_pass(
    moments: Moments, window: int, tremor: Vector, noise: Vector, law: Vector, gravity: float
) -> bool:
    """Judge the two means on their own: many quiet samples must not hide a steady turn."""
    rate, _, length, _ = moments
    spin = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
    excess = (length - gravity) ** 2
    return bool(
        spin < GATE_SQUARE * (tremor[0] + noise[0] / window + law[2])
        and excess < GATE_SQUARE * (tremor[1] + noise[1] / window + law[3])
    )


@compiled
def law_of(tremor: Vector, noise: Vector, rate_bias: float, force_length: float) -> Vector:
    """Return the four variances of `glrt` from those of tremor and noise (2,) and two sigmas."""
    return np.array([tremor[0] + noise[0], tremor[1] + noise[1], rate_bias**2, force_length**2])


@compiled
def score(
    detector: int, moments: Moments, newest_rate: Vector, window: int, law: Vector, gravity: float
) -> float:
    """Return the statistic of one detector [-]; noise alone scores 6 or, on three axes, 3."""
    rate, rate_scatter, _, force_scatter = moments
    if detector == GYRO:
        return float(np.sum(newest_rate**2) / (law[0] + law[2]))
    if detector == MOVING_VARIANCE:
        return float(force_scatter / law[1])
    if detector == ARED:
        spin = rate[0] ** 2 + rate[1] ** 2 + rate[2] ** 2
        return float((rate_scatter + spin) / (law[0] + law[2]))
    return glrt(moments, window, law, gravity)


@compiled
def follow(level: float, value: float, dt: float, attack: float, decay: float) -> float:
    """Return the level of motion A after one more sample: quick to rise, slow to fall."""
    root = np.sqrt(value)
    time = attack if root > level else decay
    return float(level + (root - level) * (1.0 - np.exp(-dt / time)))


@compiled
def scores_of(detector: int, samples: Matrix, window: int, law: Vector, gravity: float) -> Scalars:
    """Return the statistic of every full window of `samples` (N, 6), all of one length."""
    scores = np.empty(len(samples) - window + 1)
    for start in range(len(scores)):
        newest = start + window - 1
        moments = moments_of(samples, newest, window)
        scores[start] = score(detector, moments, samples[newest, :3], window, law, gravity)
    return scores
