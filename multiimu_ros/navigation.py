"""One fused reading after the other becomes stillness, attitude and odometry.

    detect -> withhold rests -> attitude, odometry -> record

`navigate` is all of it in one compiled call, for the filters that are the default; `Navigator`
is its door, and steps other filters one by one.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fused_frame import SIZE, write_record
from multiimu_ros.odometry.attitude import AttitudeEstimator, AttitudeFilter
from multiimu_ros.odometry.attitude_steps import step_attitude, told_covariance
from multiimu_ros.odometry.error_dynamics import step as step_odometry
from multiimu_ros.odometry.error_state import ErrorStateConfig, ErrorStateFilter
from multiimu_ros.odometry.federated_odometry import FederatedOdometry
from multiimu_ros.odometry.rest import COLUMNS, DT, RestBuffer, RESTING, Sample, STILL, withhold
from multiimu_ros.odometry.saved_state import Origin, Owner, SavedState, snapshot
from multiimu_ros.odometry.zero_velocity import detect, StillnessDetector

FIRST_STEP = 0.005  # [s] stands in for the time since a sample that was never there
# Fields of the stamps: the newest reading, whether there is one, the last sample of a rest, and
# whether `navigate` may take the next reading: the filters are the default and have started.
NEWEST, STARTED, RESTED, READY = range(4)


class Navigation(NamedTuple):
    """Arrays, changed in place."""

    samples: Matrix  # of the detector
    steps: Vector
    detector: Vector
    detector_settings: Vector
    ring: Matrix  # of the rest buffer
    rest: Vector
    ready: Matrix
    R: Matrix  # of the attitude filter
    bias: Vector
    P: Matrix
    memory: Vector
    settings: Vector
    x: Vector  # of the odometry filter
    R_odom: Matrix
    P_odom: Matrix
    odom_memory: Vector
    odom_settings: Vector
    rested: Vector  # (1,): seconds of rest that the filters learnt from
    stamps: Stamps  # (4,): see NEWEST


@compiled
def step_length(stamps: Stamps, stamp: int) -> float:
    """Return the time since the newest reading [s], and make `stamp` [ns] the newest."""
    dt = (stamp - stamps[NEWEST]) * 1e-9 if stamps[STARTED] > 0 else FIRST_STEP
    stamps[NEWEST], stamps[STARTED] = stamp, 1
    return dt


@compiled
def navigate(nav: Navigation, stamp: int, table: Vectors, record: Vector) -> tuple[bool, bool]:
    """Move on by one fused reading and write its record.

    Parameters
    ----------
    nav : Navigation
        Filters that have started.
    stamp : int
        Instant of the reading [ns].
    table : (4, 6) array
        See `FusedImu`.
    record : (SIZE,) array
        Filled; see `FusedFrame`.

    Returns
    -------
    still, resting : bool
        What the detector says.
    """
    row = np.empty(COLUMNS)
    row[DT] = step_length(nav.stamps, stamp)
    row[1:7], row[7:13] = table[0], table[3]
    rate, force = table[0, :3] - nav.bias, table[0, 3:] - nav.x[12:15]
    still, resting = detect(
        nav.samples, nav.steps, nav.detector, nav.detector_settings,
        row[DT], rate, force, row[7:10].copy(), row[10:13].copy(),
    )  # fmt: skip
    row[STILL], row[RESTING] = still, resting
    for k in range(withhold(nav.ring, nav.rest, row, nav.ready)):
        late = nav.ready[k]
        dt, rate, force = late[DT], late[1:4].copy(), late[4:7].copy()
        rate_density, force_density = late[7:10].copy(), late[10:13].copy()
        was_still, rested = late[STILL] > 0.0, late[RESTING] > 0.0
        step_attitude(
            nav.R, nav.bias, nav.P, nav.memory, nav.settings,
            dt, rate, force, rate_density, force_density, was_still, rested,
        )  # fmt: skip
        step_odometry(
            nav.x, nav.R_odom, nav.P_odom, nav.odom_memory, nav.odom_settings,
            dt, rate, force, rate_density, force_density, was_still, rested,
        )  # fmt: skip
        if rested:
            nav.rested[0] += dt
            nav.stamps[RESTED] = stamp
    told = told_covariance(nav.R, nav.P, nav.memory)
    write_record(record, table, nav.R, nav.bias, told, nav.x, nav.R_odom, nav.P_odom)
    return still, resting


class Navigator:
    """Detector, rest buffer, attitude and odometry filter, on a live stream of fused readings.

    Parameters
    ----------
    detector : StillnessDetector
        What tells that the rig stands still.
    attitude, odometry : filters
        `navigate` steps those that are the default, `push` all.
    resting_lag : float
        How late the end of a rest may be noticed [s].

    Attributes
    ----------
    arrays : Navigation
        What `navigate` changes in place.
    origin : Origin or None
        Where the start lies in the frame of before a restart; None where there was none.
    """

    def __init__(
        self,
        detector: StillnessDetector,
        attitude: AttitudeEstimator,
        odometry: ErrorStateFilter,
        resting_lag: float,
    ) -> None:
        self.detector, self.attitude, self.odometry = detector, attitude, odometry
        self._rest = RestBuffer(resting_lag)
        self._rested, self._stamps = np.zeros(1), np.zeros(4, np.int64)
        self.origin: Origin | None = None
        self._is_default = (type(attitude), type(odometry)) == (AttitudeFilter, ErrorStateFilter)
        self.arrays = Navigation(
            *detector.arrays, *self._rest.arrays, *attitude.arrays, *odometry.arrays,
            self._rested, self._stamps,
        )  # fmt: skip

    @property
    def is_compiled(self) -> bool:
        """Whether `navigate` may take the next reading."""
        return bool(self._stamps[READY])

    @property
    def rested_s(self) -> float:
        """Seconds of rest that the filters learnt from."""
        return float(self._rested[0])

    @property
    def rested_ns(self) -> int:
        """Stamp of the last sample of a rest [ns]; 0 before the first."""
        return int(self._stamps[RESTED])

    def restart(self) -> None:
        """Put the origin here and forget the motion, after a jump in time."""
        self.odometry.reset_motion()
        self._rest.clear()
        self.origin = None
        self._stamps[STARTED] = self._stamps[READY] = 0

    def snapshot(self, owner: Owner) -> SavedState | None:
        """Return what is to be saved for a restart; None before the first reading."""
        if not self._stamps[STARTED]:
            return None
        turned, pose = self._told()
        return snapshot(owner, int(self._stamps[NEWEST]), pose, turned, self.attitude.gyro_bias)

    def restore(self, state: SavedState, config: ErrorStateConfig, now_ns: int) -> None:
        """Go on, at the first reading, from what was saved."""
        self.origin = Origin(state, config, now_ns)
        self.origin.restore_biases(self.odometry, self.attitude)

    def _told(self) -> tuple[tuple[Matrix, Matrix], tuple[Vector, Matrix, Matrix]]:
        """Return R, P of the attitude and x, R, P of the odometry, in the frame of `origin`."""
        attitude, odometry = self.attitude, self.odometry
        if self.origin is not None:
            return self.origin.seen_attitude(attitude), self.origin.seen(odometry)
        return (attitude.R_nb, attitude.P), (odometry.state, odometry.R_nb, odometry.P)

    def push(
        self, stamp_ns: int, table: Vectors, values: Vectors, density: Vectors
    ) -> tuple[Vector, bool, bool]:
        """Move on by one fused reading, filter by filter.

        Parameters
        ----------
        stamp_ns : int
            Its instant [ns].
        table : (4, 6) array
            See `FusedImu`.
        values, density : (K, 6) arrays
            The readings that it is made of, NaN where there is none or none to be trusted, and
            their noise [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].

        Returns
        -------
        record : (SIZE,) array
            See `FusedFrame`.
        still, resting : bool
            What the detector says.
        """
        dt = step_length(self._stamps, stamp_ns)
        rate, force = table[0, :3], table[0, 3:]
        densities = table[3, :3], table[3, 3:]
        attitude, odometry = self.attitude, self.odometry
        still, resting = self.detector.push(
            dt, rate - attitude.gyro_bias, force - odometry.accel_bias, *densities
        )
        if isinstance(odometry, FederatedOdometry):
            odometry.hear(values, density)
        for sample in self._rest.push(Sample(dt, rate, force, *densities, still, resting)):
            attitude.step(sample)
            odometry.step(sample)
            if sample.resting:
                self._rested += sample.dt
                self._stamps[RESTED] = stamp_ns
        started = attitude.started and odometry.started
        self._stamps[READY] = self._is_default and started and self.origin is None
        record, ((R, P), pose) = np.zeros(SIZE), self._told()
        write_record(record, table, R, attitude.gyro_bias, P, *pose)
        return record, still, resting
