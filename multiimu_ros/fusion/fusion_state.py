"""What the fusion stage remembers between scans, and what it was told to do."""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Stamps, Vector, Vectors
from multiimu_ros.fusion.faults import guard_state
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.rigid_body import HISTORY
from multiimu_ros.fusion.three_cornered_hat import hat_state

# Columns of the tally: scans averaged into an offset, share in the last scan; then, since somebody
# emptied them, the sums of the readings without their lever arm, and the scans that they are of.
SCANS, SHARE, SUMS, COUNT = 0, 1, 2, 8
TALLY = 9
# Fields of the clock: time between scans, its running mean [s]; whether the last rate was bridged;
# fading sums of squares of the rate and of the angular acceleration; from here on the two sums of
# `saturation.learn_walk`.
INTERVAL, PERIOD, BRIDGED, TURNED, SWUNG, WALK = range(6)
# Fields of the settings: angular acceleration and jerk (3 each), then switches.
GUARD, LEARN, SETTINGS = 6, 7, 8
# Rows of `fused`: values, their variances, derivatives of the values, variances a scan before.
VALUE, VARIANCE, SLOPE, BEFORE = 0, 1, 2, 3
# The triads of a scan.  No Python integers, of each of which numba would compile a copy.
TRIADS: Stamps = np.arange(2)
RATES, FORCES = TRIADS


class FusionState(NamedTuple):
    """Arrays, changed in place."""

    fused: Vectors  # (4, 6): see VALUE
    offsets: Vectors  # (K, 6): e_i
    tally: Vectors  # (K + 1, TALLY): see SCANS; the last row is of the fused IMU
    stamps: Stamps  # (HISTORY,) of the fused rates, for their slope
    rates: Vectors  # (HISTORY, 3)
    scans: Stamps  # (1,): how many of them are valid
    clock: Vector  # (7,): see INTERVAL
    density: Vectors  # (K, 6): white noise, of the rig file or learnt
    guard: Vectors  # (K, GUARD_COLUMNS)
    hat: Vectors  # (K, HAT_COLUMNS)
    spread: Matrix  # (3, 3): covariance of the angular acceleration
    bridge: Matrix  # (7, 6): rate and angular acceleration across a saturation; their covariance


def fresh_state(model: RigModel) -> FusionState:
    """Return the state of a stage that saw nothing."""
    count = len(model.density)
    return FusionState(
        np.zeros((4, 6)),
        np.zeros((count, 6)),
        np.zeros((count + 1, TALLY)),
        np.zeros(HISTORY, np.int64),
        np.zeros((HISTORY, 3)),
        np.zeros(1, np.int64),
        np.zeros(WALK + 2),
        model.density.copy(),
        guard_state(count),
        hat_state(count),
        np.zeros((3, 3)),
        np.zeros((7, 6)),
    )
