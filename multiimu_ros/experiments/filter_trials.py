"""One filter of the sources on one record of three gyroscopes: how it errs, when it ends.

A record holds many series at once, as axes of one bank: they are independent draws of the same
trial, and cost little more than one.
"""

from dataclasses import dataclass
import time
from typing import Literal, NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vectors
from multiimu_ros.experiments.board import DEGREE, rms
from multiimu_ros.fusion.filter_bank import FilterBank
from multiimu_ros.fusion.local_filters import Local
from multiimu_ros.fusion.masters import FilterDivergedError, Master
from multiimu_ros.fusion.three_cornered_hat import learnt_density
from multiimu_ros.simulation.errors import BMI160, draw_noise
from multiimu_ros.simulation.trajectories import make_motion

RATE_HZ = 100.0
IMUS = 3
DRAWS = 8  # of three axes each
DURATION = 30.0  # [s]
SETTLING = 3.0  # [s] not scored
CORRUPTED = 2.45  # [-] times the noise: averaging three then errs by 1.63, the printed ratio
LEAST_RATIO = float(np.sqrt(3 / (2 + CORRUPTED**-2)))  # with weights 1/sigma^2: 1.18
PARTICLE_DURATION, PARTICLE_AXES = 8.0, 6  # [s] a particle filter is not worth more waiting
MILLIDEGREE = 1e-3 * DEGREE
WHITE = BMI160.gyroscope.noise_density * np.sqrt(RATE_HZ)  # [rad/s] of one reading


class Filter(NamedTuple):
    """What is run: local, master, and how it knows the noise of each IMU."""

    local: Local
    master: Master
    noise: Literal['told', 'alike', 'learnt'] = 'told'


@dataclass(frozen=True)
class Record:
    """Three gyroscopes, A series each.

    Parameters
    ----------
    truth : (N, A) array
        [rad/s].
    like, corrupted : (N, 3, A) arrays
        Readings; in the latter the third IMU has `CORRUPTED` times the noise [rad/s].
    Q : (A,) array
        What the filters are told of the motion: variance gained from scan to scan.
    """

    truth: Vectors
    like: Matrix
    corrupted: Matrix
    Q: Scalars

    def readings(self, *, corrupted: bool) -> Matrix:
        """Return what the filters see."""
        return self.corrupted if corrupted else self.like


def noise_of(*, corrupted: bool) -> Vectors:
    """Return R (3, 1) of one reading [(rad/s)^2]."""
    factors = np.array([[1.0], [1.0], [CORRUPTED if corrupted else 1.0]])
    return np.asarray(np.square(WHITE * factors))


def resting_noise(error: float) -> float:
    """Return the Q with which the mean of three like Kalman filters errs by `error` [rad/s].

    A filter of gain K turns the variance R of white noise into K R / (2 - K), Q = K^2 R / (1 - K).
    """
    part = IMUS * error**2 / WHITE**2
    gain = 2 * part / (1 + part)
    return float(gain**2 * WHITE**2 / (1 - gain))


def make_record(
    motion: str, rng: np.random.Generator, duration: float, Q: float | None = None
) -> Record:
    """Draw a record; by default Q is the mean square of what the motion gains in a scan."""
    rate = make_motion(motion, duration, RATE_HZ, int(rng.integers(2**31))).angular_rate_b
    truth = np.tile(rate, DRAWS)
    noise = np.stack(
        [
            np.hstack(
                [draw_noise(len(rate), RATE_HZ, BMI160.gyroscope, rng) for _ in range(DRAWS)]
            )
            for _ in range(IMUS)
        ],
        axis=1,
    )
    like = truth[:, None, :] + noise
    corrupted = like.copy()
    more = WHITE * np.sqrt(CORRUPTED**2 - 1)
    corrupted[:, -1] += more * rng.standard_normal(truth.shape)
    gained = np.mean(np.square(np.diff(truth, axis=0)), axis=0) if Q is None else Q
    return Record(truth, like, corrupted, np.broadcast_to(gained, truth.shape[1:]).copy())


class Trial(NamedTuple):
    """What became of it.

    Parameters
    ----------
    error : float
        Rms after the settling [rad/s]; NaN if the filter has diverged.
    scans : int
        Until the filter ended.
    diverged : bool
        Whether it ended by itself.
    shares : (scans,) array
        Weight of the third IMU on the first axis.
    """

    error: float
    scans: int
    diverged: bool
    shares: Scalars


def run_trial(
    kind: Filter, z: Matrix, R: Vectors, Q: Scalars, truth: Vectors, seed: int = 0
) -> Trial:
    """Run a filter over readings (N, K, A) with noise R (K, 1) or (K, A) as it knows it."""
    count, axes = z.shape[1:]
    bank = FilterBank(kind.local, kind.master, count, axes, seed=seed)
    noise = np.broadcast_to(R, (count, axes)).copy()
    x, shares = np.empty((len(z), axes)), np.empty(len(z))
    for n, scan in enumerate(z):
        try:
            x[n], _, b = bank.step(scan, noise, Q)
        except FilterDivergedError:
            return Trial(np.nan, n, True, shares[:n])
        shares[n] = b[-1, 0]
    first = round(SETTLING * RATE_HZ)
    return Trial(float(rms((x - truth)[first:])), len(z), False, shares)


def score(kind: Filter, record: Record, *, corrupted: bool, seed: int = 0) -> Trial:
    """Run a filter over a record."""
    z, truth, Q = record.readings(corrupted=corrupted), record.truth, record.Q
    if kind.local == 'particle':
        scans = round(PARTICLE_DURATION * RATE_HZ)
        z, truth = z[:scans, :, :PARTICLE_AXES], truth[:scans, :PARTICLE_AXES]
        Q = Q[:PARTICLE_AXES]
    if kind.noise == 'learnt':
        R = learnt_noise(z)
    else:
        R = noise_of(corrupted=corrupted and kind.noise == 'told')
    return run_trial(kind, z, R, Q, truth, seed)


def learnt_noise(z: Matrix) -> Vectors:
    """Return R (K, A) as the three-cornered hat learns it from readings (N, K, A), six at once."""
    six = np.split(z, z.shape[2] // 6, axis=2)
    return np.hstack([np.square(learnt_density(values, RATE_HZ)) * RATE_HZ for values in six])


def step_time(kind: Filter, scans: int = 200) -> float:
    """Return how long one scan of three IMUs with three axes takes here [s]; the quickest fifth.

    The machine does other things too; what it can do is what the quick steps show.
    """
    rng = np.random.default_rng(0)
    z = WHITE * rng.standard_normal((scans, IMUS, 3))
    bank = FilterBank(kind.local, kind.master, IMUS, 3)
    R, Q = np.full((IMUS, 3), WHITE**2), np.full(3, WHITE**2)
    spent = []
    for scan in z:
        begin = time.perf_counter()
        bank.step(scan, R, Q)
        spent.append(time.perf_counter() - begin)
    return float(np.quantile(spent, 0.2))
