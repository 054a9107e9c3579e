"""The measured benefit of an array: the fused noise beside that of its IMUs, and the ideal.

In motion no single reading tells its noise, for it holds the truth as well.  At rest the truth is
constant: the second difference over LAG scans of `three_cornered_hat`, of each reading and of the
fused value alike, is noise alone, 6 times its variance.  So only scans in which the rig stands
still are measured, and what was found keeps until the next rest.  A floor that trembles moves all
IMUs alike: it counts as noise of single and fused readings, and the benefit looks smaller.

The ideal is what independent noises of variance R would leave under the best weights,

    1 / sqrt(sum 1 / R_i)

which is 1 / sqrt(K) of one IMU where all are alike.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Scalars, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.three_cornered_hat import (
    clipped,
    GAIN,
    OLDEST,
    RING,
    second_differences,
)

MEMORY = 4000.0  # still scans: 20 s at 200 Hz, the noise of a triad to 0.6 %
LEAST = 200.0  # still scans before anything is said: to 4 %

# Columns of a row, one for each IMU and the last for the fused one: the ring of
# `three_cornered_hat`, scans of each triad, squares of each axis.
COUNTS, SQUARES = OLDEST + 1, OLDEST + 3
BENEFIT_COLUMNS = SQUARES + 6


class Benefit(NamedTuple):
    """Standard deviations per sample and axis, (2,) each: rate [rad/s], force [m/s^2].

    NaN until known.

    Parameters
    ----------
    fused_noise, best_single, mean_single : (2,) arrays
        As measured at rest: of the fused values, of the quietest IMU, of the IMUs on average.
    ideal : (2,) array
        Of the best weighted mean, were the noises R independent.
    """

    fused_noise: Scalars
    best_single: Scalars
    mean_single: Scalars
    ideal: Scalars


def benefit_state(count: int) -> Vectors:
    """Return the memory (K + 1, BENEFIT_COLUMNS) for `count` IMUs, empty."""
    state = np.zeros((count + 1, BENEFIT_COLUMNS))
    state[:, :RING] = np.nan
    return state


@compiled
def measure(state: Vectors, z: Vectors, fused: Vector, still: bool) -> None:
    """Take one scan into account; `state` moves on in place.

    Parameters
    ----------
    state : (K + 1, BENEFIT_COLUMNS) array
        See `benefit_state`.
    z : (K, 6) array
        Readings of the IMUs [rad/s], [m/s^2], NaN where there is none.
    fused : (6,) array
        The fused value.
    still : bool
        Whether the rig stands still; scans next to one in which it does not are left out.
    """
    count = len(z)
    readings = np.empty((count + 1, 6))
    readings[:count] = z
    readings[count] = fused
    D = second_differences(state, readings, np.full(count + 1, 1.0 if still else 0.0))
    keep = 1.0 - 1.0 / MEMORY
    for i in range(count + 1):
        for triad in range(2):
            first = 3 * triad
            if not np.isfinite(D[i, first] + D[i, first + 1] + D[i, first + 2]):
                continue
            scans = state[i, COUNTS + triad]
            for axis in range(first, first + 3):
                total = state[i, SQUARES + axis]
                state[i, SQUARES + axis] = keep * total + clipped(D[i, axis] ** 2, total, scans)
            state[i, COUNTS + triad] = keep * scans + 1.0


def benefit(state: Vectors, R: Vectors) -> Benefit:
    """Return what the rests so far have shown.

    Parameters
    ----------
    state : (K + 1, BENEFIT_COLUMNS) array
        As `measure` left it.
    R : (K, 6) array
        Variance of one reading as it is scanned: that of a sample times its noise gain
        [(rad/s)^2], [(m/s^2)^2]; NaN or infinite for an IMU that does not count.
    """
    scans = np.repeat(state[:, COUNTS:SQUARES], 3, axis=1)
    variance = np.full_like(scans, np.nan)
    np.divide(state[:, SQUARES:], GAIN * scans, out=variance, where=scans >= LEAST)
    noise = np.sqrt(variance.reshape(-1, 2, 3).mean(axis=2))  # (K + 1, 2)
    information = np.where(R > 0.0, 1.0 / np.where(R > 0.0, R, 1.0), 0.0).sum(axis=0)
    best = np.full(6, np.nan)
    np.divide(1.0, information, out=best, where=information > 0.0)
    singles = noise[:-1]
    known = np.isfinite(singles)
    least = np.where(known, singles, np.inf).min(axis=0)
    mean = np.full(2, np.nan)
    np.divide(
        np.where(known, singles, 0.0).sum(axis=0),
        known.sum(axis=0),
        out=mean,
        where=known.any(axis=0),
    )
    return Benefit(
        noise[-1],
        np.where(known.any(axis=0), least, np.nan),
        mean,
        np.sqrt(best.reshape(2, 3).mean(axis=1)),
    )


class BenefitMeter:
    """The same on a live stream of scans of `count` IMUs."""

    def __init__(self, count: int) -> None:
        self.state = benefit_state(count)

    def push(self, z: Vectors, fused: Vector, *, still: bool) -> None:
        """Take the readings (K, 6) and the fused value (6,) of one scan into account."""
        measure(self.state, z, fused, still)

    def benefit(self, R: Vectors) -> Benefit:
        """Return what the rests so far have shown; see `benefit`."""
        return benefit(self.state, R)
