"""Odometry from K IMUs: an error-state filter for each of them, and a master that joins them.

Every local filter integrates its own IMU at its own lever arm and states position, velocity and
attitude of the base, and the biases of its IMU.  The locals are not independent: they start from
one prior, the same foot that is not quite still tells them that it is, and the same motion hides
from all of them between two samples.  What is common must not count K times [1]_: local i takes it
at its variance over b_i, sum b_i = 1, and what is its own (noise, biases) as it is.  The local
filters here carry P_i times b_i, all of it, which is the uncertainty of the master.  Then

    x = sum b_i x_i,    P = sum b_i (b_i P_i)

counts nothing twice, and with like IMUs it is the filter on one virtual IMU.  What a filter for
each IMU buys is isolation: the master never tells the locals anything, so that whoever
contradicts the others takes all that it did wrong along when it leaves.  It comes back as a copy
of the master and is watched before it counts.  docs/derivations/federated_odometry.md.

.. [1] N. A. Carlson, "Federated square root filter for decentralized parallel processes", IEEE
   Trans. Aerosp. Electron. Syst. 26(3), 1990.
"""

from collections import deque

import numpy as np

from multiimu_ros.arrays import as_vector, as_vectors, Scalars, Vector, Vectors
from multiimu_ros.odometry.error_fields import LEARNT
from multiimu_ros.odometry.error_state import ErrorStateConfig, ErrorStateFilter
from multiimu_ros.odometry.error_updates import align
from multiimu_ros.odometry.federated_kernels import (
    fuse,
    MEMBER,
    NOMINAL,
    OUT,
    PROBATION,
    PROBATION_S,
    scan_step,
    SHARE,
    share_out,
    STATUS,
    TRACK,
)
from multiimu_ros.odometry.rest import Sample

NONE = np.zeros(3)  # the locals do not look at the fused reading


class FederatedOdometry(ErrorStateFilter):
    """Position, velocity, attitude and mean biases of a rig, from K local filters.

    Parameters
    ----------
    config : ErrorStateConfig
        The motion; its bias sigmas and walks are not used.
    lever_arms_b : (K, 3) array
        Sensor origins from the base [m].
    bias_sigma, bias_walk : (K, 6) arrays
        What the calibration leaves of each IMU's biases [rad/s], [m/s^2], and their random walks.
    density : (K, 6) array
        White noise, rate then force, from which the shares are [rad/s/sqrt(Hz)],
        [m/s^2/sqrt(Hz)].
    """

    def __init__(
        self,
        config: ErrorStateConfig,
        lever_arms_b: Vectors,
        bias_sigma: Vectors,
        bias_walk: Vectors,
        density: Vectors,
    ) -> None:
        super().__init__(config)
        self._arms = np.ascontiguousarray(as_vectors(lever_arms_b, 'lever_arms_b'))
        count = len(self._arms)
        self._sigma = _rows(bias_sigma, count, 'bias_sigma')
        self._walks = _rows(bias_walk, count, 'bias_walk')
        self._start = np.zeros((count, 6))
        self._start_P = self._sigma**2
        self._track = np.zeros((count, TRACK))
        self._track[:, NOMINAL] = _shares(_rows(density, count, 'density'))
        self._track[:, PROBATION] = PROBATION_S
        self._locals = (
            np.zeros((count, 15)),
            np.tile(np.eye(3), (count, 1, 1)),
            np.zeros((count, 15, 15)),
        )
        self._memories = np.zeros((count, len(self._memory)))
        self._each = np.tile(self._settings, (count, 1))
        self._offsets = np.zeros((count, 9))
        self._heard: deque[tuple[Vectors, Vectors]] = deque()

    @property
    def shares(self) -> Scalars:
        """Share (K,) of each IMU in the odometry, 0 for those left out [-]."""
        return self._track[:, SHARE].copy()

    @property
    def local_biases(self) -> Vectors:
        """Gyro and accel bias (K, 6) that each local filter states [rad/s], [m/s^2]."""
        return self._locals[0][:, 9:].copy()

    def restore_each(self, bias: Vectors, sigma: Vectors) -> None:
        """Start from a saved bias (K, 6) of each IMU and its standard deviation, independent."""
        self._start[:] = _rows(bias, len(self._arms), 'bias')
        self._start_P[:] = np.square(_rows(sigma, len(self._arms), 'sigma'))
        x, _, P = self._locals
        for k, share in enumerate(self._track[:, SHARE]):
            x[k, 9:], P[k, 9:, :], P[k, :, 9:] = self._start[k], 0.0, 0.0
            P[k, 9:, 9:] = share * np.diag(self._start_P[k])
        self._gather()

    def restore_biases(
        self, gyro_bias: Vector, gyro_sigma: Vector, accel_bias: Vector, accel_sigma: Vector
    ) -> None:
        """Start from saved mean biases (3,), as good as each IMU's own; see `restore_each`."""
        bias = np.concatenate((as_vector(gyro_bias, 'gyro_bias'), accel_bias))
        sigma = np.concatenate((as_vector(gyro_sigma, 'gyro_sigma'), accel_sigma))
        count = len(self._arms)
        share = self._track[:, NOMINAL, np.newaxis]
        self.restore_each(np.tile(bias, (count, 1)), np.sqrt(sigma**2 / share + self._sigma**2))

    def reset_motion(self) -> None:
        """Put the origin here and forget the velocity, after a jump in time; keep the rest."""
        super().reset_motion()
        self._heard.clear()
        x, _, P = self._locals
        x[:, :6] = self._offsets[:, :6] = 0.0
        P[:, :6, :] = P[:, :, :6] = 0.0
        P[:, 3:6, 3:6] = np.eye(3) * self._config.motion_velocity_sigma**2

    def align(self, specific_force: Vector, force_sigma: float, velocity_sigma: float) -> None:
        """Set roll and pitch of all locals from one force at the base, yaw and velocity to zero.

        Parameters
        ----------
        specific_force : (3,) array
            Reading, or the mean over a still start [m/s^2].
        force_sigma : float
            Its noise and the rig's acceleration, apart from the bias [m/s^2].
        velocity_sigma : float
            How still the rig is [m/s].
        """
        force = as_vector(specific_force, 'specific_force')
        self._level(np.tile(force, (len(self._arms), 1)), force_sigma, velocity_sigma)

    def _level(self, force: Vectors, force_sigma: float, velocity_sigma: float) -> None:
        """Make a member of every IMU whose force (K, 3) is known, levelled by it."""
        x, R, P = self._locals
        self._track[:, STATUS] = np.where(np.isfinite(force.sum(axis=1)), MEMBER, OUT)
        share_out(self._track, self._locals[2], self._each, self._walks)
        for k in np.flatnonzero(self._track[:, STATUS] == MEMBER):
            x[k, 9:], P[k] = self._start[k], 0.0
            P[k, 9:, 9:] = self._track[k, SHARE] * np.diag(self._start_P[k])
            variance = np.full(3, force_sigma**2)
            align(x[k], R[k], P[k], force[k], variance, self._config.gravity)
            P[k, 3:6, 3:6] += np.eye(3) * velocity_sigma**2
            self._R[:] = R[k]
        self._offsets[:] = 0.0
        self._gather()
        self._aligned = True

    def _gather(self) -> None:
        fuse(*self._locals, self._track, self._offsets, self._x, self._R, self._P)

    def hear(self, values: Vectors, density: Vectors) -> None:
        """Keep the readings behind the sample that is given to `step` next, but for those kept.

        Parameters
        ----------
        values : (K, 6) array
            Readings of a scan in the base frame, each at its lever arm, NaN where an IMU is
            missing or not to be trusted [rad/s], [m/s^2].
        density : (K, 6) array
            Their white noise [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
        """
        self._heard.append((values.copy(), density.copy()))

    def step(self, sample: Sample) -> None:
        """Take the oldest readings kept, with the time and the flags of their `sample`."""
        values, density = self._heard.popleft()
        if not self._aligned:
            config = self._config
            self._level(values[:, 3:], config.motion_sigma, config.motion_velocity_sigma)
        if not self._started:
            self._memories[:] = 0.0
            self._memories[:, :6] = np.nan_to_num(values)
            self._started = True
            return
        # How much a swing adds is of the foot: what one IMU alone has learnt is its own fault.
        learnt = np.sort(self._memories[self._track[:, STATUS] == MEMBER, LEARNT])
        if len(learnt):
            self._memories[:, LEARNT] = learnt[(len(learnt) - 1) // 2]
        scan_step(
            *self._locals, self._memories, self._each, self._track, self._offsets, self._x,
            self._R, self._P, self._arms, self._walks, self._start, self._start_P,
            sample.dt, values, density, sample.still, sample.resting,
        )  # fmt: skip

    def push_scan(
        self, dt: float, values: Vectors, density: Vectors, *, still: bool, resting: bool
    ) -> None:
        """Move on by one scan, as `hear` has it; rest is learnt from late."""
        self.hear(values, density)
        self.push(Sample(dt, NONE, NONE, NONE, NONE, still, resting))


def _rows(values: Vectors, count: int, name: str) -> Vectors:
    """Return `values` as a (K, 6) array of floats."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (count, 6):
        msg = f'`{name}` must be ({count}, 6), a row for each lever arm, got {array.shape}.'
        raise ValueError(msg)
    return array


def _shares(density: Vectors) -> Scalars:
    """Return the shares (K,): the mean of what rates and forces are known by (2)."""
    information = np.stack((density[:, :3] ** -2.0, density[:, 3:] ** -2.0)).sum(axis=2)
    return np.asarray((information / information.sum(axis=1, keepdims=True)).mean(axis=0))
