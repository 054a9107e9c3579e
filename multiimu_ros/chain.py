"""Scans of K IMUs to records of the fused IMU and the odometry, many in one compiled call."""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Flags, Matrix, Scalars, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fused_frame import SIZE
from multiimu_ros.fusion.benefit import measure
from multiimu_ros.fusion.fuse_scan import fuse
from multiimu_ros.fusion.fusion_state import FusionState
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.navigation import navigate, Navigation, READY

GAIN_MEMORY = 1000  # scans that the mean gain of interpolation looks back
FUSED, STILL, RESTING = range(3)  # columns of the flags


class Block(NamedTuple):
    """Scans, and what becomes of them."""

    stamp_ns: Stamps  # (M,)
    scans: Matrix  # (M, K, 8): values, share and noise gain of each IMU
    records: Vectors  # (M, SIZE): see `FusedFrame`
    weights: Vectors  # (M, K)
    flags: Flags  # (M, 3): see FUSED

    def after(self, first: int) -> 'Block':
        """Return all but the first ones."""
        return Block(
            self.stamp_ns[first:], self.scans[first:], self.records[first:],
            self.weights[first:], self.flags[first:],
        )  # fmt: skip


def fresh_block(stamp_ns: Stamps, scans: Matrix) -> Block:
    """Return a block of which nothing is known yet."""
    count = len(stamp_ns)
    records, weights = np.zeros((count, SIZE)), np.zeros(scans.shape[:2])
    return Block(stamp_ns, scans, records, weights, np.zeros((count, 3), np.bool_))


@compiled
def note_rest(
    meter: Vectors,
    mean_gain: Scalars,
    values: Vectors,
    noise_gain: Scalars,
    fused: Vector,
    resting: bool,
) -> None:
    """Keep what a rest tells about the noise.

    Parameters
    ----------
    meter : (K + 1, BENEFIT_COLUMNS) array
        See `benefit.measure`.
    mean_gain : (K,) array
        Running mean of the noise gain [-].
    values, noise_gain : (K, 6), (K,) arrays
        Those of the scan.
    fused : (6,) array
        The fused value.
    resting : bool
        Whether the rig rests.
    """
    measure(meter, values, fused, resting)
    if resting:
        mean_gain += (noise_gain - mean_gain) / GAIN_MEMORY


@compiled
def run_scans(
    density: Vectors,
    bias_variance: Vectors,
    scale_variance: Matrix,
    lever_arms_b: Vectors,
    response_variance: Matrix,
    floor: Vectors,
    delay_variance: Scalars,
    to_sensor: Matrix,
    limits: Vectors,
    R_bs: Matrix,
    fused: Vectors,
    offsets: Vectors,
    tally: Vectors,
    rate_stamps: Stamps,
    rates: Vectors,
    rate_scans: Stamps,
    clock: Vector,
    learnt: Vectors,
    guard: Vectors,
    hat: Vectors,
    spread: Matrix,
    bridge: Matrix,
    settings: Vector,
    samples: Matrix,
    steps: Vector,
    detector: Vector,
    detector_settings: Vector,
    ring: Matrix,
    rest: Vector,
    ready: Matrix,
    R: Matrix,
    bias: Vector,
    P: Matrix,
    memory: Vector,
    attitude_settings: Vector,
    x: Vector,
    R_odom: Matrix,
    P_odom: Matrix,
    odom_memory: Vector,
    odom_settings: Vector,
    rested: Vector,
    nav_stamps: Stamps,
    meter: Vectors,
    mean_gain: Scalars,
    due_ns: int,
    table: Vectors,
    stamp_ns: Stamps,
    scans: Matrix,
    records: Vectors,
    weights: Vectors,
    flags: Flags,
) -> int:
    """Take scans until all are in or something is due; return how many were taken.

    While the filters are not `READY`, the first fused scan is the last one, and not navigated.

    The parameters are the arrays of `RigModel`, `FusionState`, the settings of the fusion and the
    arrays of `Navigation`, then:

    Parameters
    ----------
    meter, mean_gain : arrays
        See `note_rest`.
    due_ns : int
        The first scan from here on is the last one.
    table : (4, 6) array
        Filled with the last fused reading; see `FusedImu`.
    stamp_ns, scans, records, weights, flags : arrays
        See `Block`; a scan in which no IMU could be trusted is not FUSED.
    """
    model = RigModel(
        density, bias_variance, scale_variance, lever_arms_b, response_variance, floor,
        delay_variance, to_sensor, limits, R_bs,
    )  # fmt: skip
    state = FusionState(
        fused, offsets, tally, rate_stamps, rates, rate_scans, clock, learnt, guard, hat,
        spread, bridge,
    )  # fmt: skip
    nav = Navigation(
        samples, steps, detector, detector_settings, ring, rest, ready, R, bias, P, memory,
        attitude_settings, x, R_odom, P_odom, odom_memory, odom_settings, rested,
        nav_stamps,
    )  # fmt: skip
    for n in range(len(stamp_ns)):
        values = scans[n, :, :6].copy()
        share, noise_gain = scans[n, :, 6].copy(), scans[n, :, 7].copy()
        table[:], weights[n] = fuse(model, state, settings, stamp_ns[n], values, share, noise_gain)
        if np.isfinite(np.sum(table[:2])):
            flags[n, FUSED] = True
            if nav.stamps[READY] == 0:
                return n + 1
            still, resting = navigate(nav, stamp_ns[n], table, records[n])
            flags[n, STILL], flags[n, RESTING] = still, resting
            note_rest(meter, mean_gain, values, noise_gain, table[0], resting)
        if stamp_ns[n] >= due_ns:
            return n + 1
    return len(stamp_ns)
