"""SCAAT: a filter that takes one measurement at a time, at its own stamp ([1]_, thesis 8.1).

Nothing is resampled: each reading of each IMU corrects the one state at the instant at which it
was taken, and the filter coasts from stamp to stamp.  The state is

    x = [w, a, f_0, j],    dw/dt = a,   df_0/dt = j,   a and j walk at random,

and IMU i sees w, and with its lever arm r_i the force f_0 + a x r_i + w x (w x r_i), in white
noise of variance (noise density)^2 x its own sampling rate.  The gyroscope corrects first, and
the force is linearised about what it left: each is a constraint of its own.  The jerk j is there
so that a force that changes is not seen late (docs/derivations/scaat.md).

.. [1] G. Welch, G. Bishop, "SCAAT: incremental tracking with incomplete information", SIGGRAPH
   1997.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import as_matrix, Matrix, Scalars, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.scaat_step import (
    ACCELERATION,
    correct_by_imu,
    FORCE,
    JERK,
    predict,
    RATE,
    SIZE,
)
from multiimu_ros.synchronization.arrivals import Arrivals
from multiimu_ros.synchronization.streams import NEVER

HEARD_AT = 1  # of the two instants
REPORTED = 9  # of its first entries the covariance is handed out
# Sigmas are generous, so that nothing lags: by how much above the rms of real motions [-], and
# over which range of rate and force these go to and fro [rad/s], [m/s^2]; scaat.md (3).
GENEROUS = np.array([5.0, 20.0])
SPAN = np.array([5.0, 10.0])
FULL_SCALE = np.array([35.0, 160.0])  # [rad/s], [m/s^2] the first sigma of rate and force
COASTING = 1_000_000_000  # [ns] without a sample, after which the motion is unknown
STARTING_PERIOD = 0.005  # [s] believed of each IMU for its first sample only
PERIOD_MEMORY = 64  # samples that the running mean of a period looks back
OUTAGE_PERIODS = 10.0  # an outage is no change of rate: it counts as so many periods at most


class ScaatState(NamedTuple):
    """What the filter remembers; arrays, changed in place."""

    x: Vector  # (12,)
    P: Matrix  # (12, 12)
    first: Vector  # (12,): variances at the start
    now: Stamps  # (2,): instant of x and of the last sample taken in [ns], NEVER before the first
    heard: Stamps  # (2,): samples of gyroscopes and accelerometers taken in
    latest: Stamps  # (K,): stamp of the last sample of each IMU [ns], NEVER before
    counts: Stamps  # (K,): intervals in the mean, up to PERIOD_MEMORY
    period: Scalars  # (K,): mean time between samples [s]


class ScaatFilter:
    """K registered IMUs to one, sample by sample.

    Parameters
    ----------
    density : (K, 6) array
        White noise density, base-frame axes [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    lever_arms_b : (K, 3) array
        Sensor origins [m].
    angular_acceleration_sigma : float
        What the angular acceleration may reach [rad/s^2].
    jerk_sigma : float
        How fast the specific force may change [m/s^3].
    """

    def __init__(
        self,
        density: Vectors,
        lever_arms_b: Vectors,
        angular_acceleration_sigma: float,
        jerk_sigma: float,
    ) -> None:
        count = len(density)
        self._density = as_matrix(density, 'density', (count, 6))
        self._arms = as_matrix(lever_arms_b, 'lever_arms_b', (count, 3))
        self._sigma = np.array([angular_acceleration_sigma, jerk_sigma])
        if not (self._sigma > 0).all():  # also catches NaN
            sigmas = '`angular_acceleration_sigma` and `jerk_sigma`'
            msg = f'{sigmas} must be positive, got {self._sigma.tolist()}.'
            raise ValueError(msg)
        self._walk = (self._sigma / GENEROUS) ** 3 / SPAN
        self._state = ScaatState(
            np.zeros(SIZE), np.zeros((SIZE, SIZE)),
            np.repeat(np.column_stack([FULL_SCALE, self._sigma]).ravel() ** 2, 3),
            np.zeros(2, np.int64), np.zeros(2, np.int64),
            np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count),
        )  # fmt: skip
        self.restart()

    def restart(self) -> None:
        """Forget the motion (time jumped); keep the sampling rates.

        The state is then zero with a sigma of full scale: after one sample nothing of it is left.
        """
        forget(self._state)
        self._state.latest[:] = NEVER

    @property
    def acceleration(self) -> Vector:
        """Angular acceleration (3,) [rad/s^2]."""
        return self._state.x[ACCELERATION:FORCE].copy()

    def advance(
        self, arrivals: Arrivals, offsets: Vectors, trusted: Vectors, until_ns: int
    ) -> tuple[Vector, Matrix]:
        """Take in samples one by one, and coast to an instant.

        Parameters
        ----------
        arrivals : Arrivals
            In the order of their stamps, none before the last instant nor after `until_ns`.
        offsets : (K, 6) array
            Subtracted from the readings [rad/s], [m/s^2].
        trusted : (K, 2) array
            How far gyroscope and accelerometer of each IMU count: 0 not at all, 1 fully, and in
            between with a variance R / trusted [-].
        until_ns : int
            The instant [ns].

        Returns
        -------
        (6,) array
            Angular rate [rad/s] and specific force [m/s^2]; NaN while no sensor of the kind has
            been trusted, and where none was heard for a second.
        (9, 9) array
            Covariance of rate, angular acceleration and force.
        """
        stamps = arrivals.stamps
        first, last = (stamps[0], stamps[-1]) if len(stamps) else (until_ns, until_ns)
        if not self._state.now[0] <= first <= last <= until_ns:
            came = f'{first} to {last} for {self._state.now[0]} to {until_ns}'
            msg = f'`arrivals` must lie between the last instant and `until_ns`, got {came}.'
            raise ValueError(msg)
        return advance_door(
            *self._state, *arrivals, self._density, self._arms, self._walk, offsets, trusted,
            until_ns,
        )  # fmt: skip


@compiled
def forget(state: ScaatState) -> None:
    """Go back to where nothing is known of the motion."""
    state.x[:] = 0.0
    state.P[:] = 0.0
    for i in range(SIZE):
        state.P[i, i] = state.first[i]
    state.now[:] = NEVER
    state.heard[:] = 0


@compiled
def coast(state: ScaatState, walk: Vector, stamp: int) -> None:
    """Predict to an instant; where nobody has been heard for long, forget instead."""
    if state.now[HEARD_AT] == NEVER:
        return
    if stamp - state.now[HEARD_AT] > COASTING:
        forget(state)
        return
    predict(state.x, state.P, walk, (stamp - state.now[0]) * 1e-9)
    state.now[0] = stamp


@compiled
def follow_period(latest: Stamps, counts: Stamps, period: Scalars, k: int, stamp: int) -> float:
    """Take the interval since the last sample of IMU k into its mean period; return that [s]."""
    if latest[k] != NEVER:
        interval = (stamp - latest[k]) * 1e-9
        if counts[k] > 0:
            interval = min(interval, OUTAGE_PERIODS * period[k])
        counts[k] = min(counts[k] + 1, PERIOD_MEMORY)
        period[k] += (interval - period[k]) / counts[k]
    latest[k] = stamp
    return STARTING_PERIOD if counts[k] == 0 else float(period[k])


@compiled
def advance(
    state: ScaatState,
    arrivals: Arrivals,
    density: Vectors,
    arms: Vectors,
    walk: Vector,
    offsets: Vectors,
    trusted: Vectors,
    until: int,
) -> tuple[Vector, Matrix]:
    """Do what `ScaatFilter.advance` says.

    Samples that are not trusted at all leave no trace, not even of rounding: whether they came in
    time may depend on how the topics were served.
    """
    x, P = state.x, state.P
    for m in range(len(arrivals.stamps)):
        k, stamp = arrivals.streams[m], arrivals.stamps[m]
        if trusted[k, 0] > 0.0 or trusted[k, 1] > 0.0:
            period = follow_period(state.latest, state.counts, state.period, k, stamp)
            coast(state, walk, stamp)
            state.now[:] = stamp
            R = density[k] ** 2 / period
            correct_by_imu(x, P, arrivals.values[m] - offsets[k], arms[k], R, trusted[k])
            for kind in range(2):
                state.heard[kind] += trusted[k, kind] > 0.0
    coast(state, walk, until)
    values = np.full(6, np.nan)
    if state.heard[0] > 0:
        values[:3] = x[RATE:ACCELERATION]
    if state.heard[1] > 0:
        values[3:] = x[FORCE:JERK]
    return values, P[:REPORTED, :REPORTED].copy()


@compiled
def advance_door(
    x: Vector,
    P: Matrix,
    first: Vector,
    now: Stamps,
    heard: Stamps,
    latest: Stamps,
    counts: Stamps,
    period: Scalars,
    stamps: Stamps,
    streams: Stamps,
    values: Vectors,
    density: Vectors,
    arms: Vectors,
    walk: Vector,
    offsets: Vectors,
    trusted: Vectors,
    until: int,
) -> tuple[Vector, Matrix]:
    """Call `advance` with the arrays of its tuples, which numba would study at every call."""
    state = ScaatState(x, P, first, now, heard, latest, counts, period)
    arrivals = Arrivals(stamps, streams, values)
    return advance(state, arrivals, density, arms, walk, offsets, trusted, until)
