"""Short simulated recordings for the tests of the report, and tracks made up by hand."""

from functools import cache

import numpy as np

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.report.comparison import rerun, score
from multiimu_ros.report.tracks import Track
from multiimu_ros.report.truth import as_truth, Truth
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

RATE = 200.0
IMUS = 3


@cache
def recording(seconds=12.0):
    """Return three IMUs waved about: the recording, its calibrated rig and the truth."""
    run = simulate(ring(IMUS), trajectory('hand', seconds, 3), RATE, seed=3)
    return run, calibrated_rig(run.rig, 3), as_truth(run.truth, run.truth_ns)


@cache
def comparison():
    """Return the array, its IMUs and their mean against the truth."""
    run, rig, truth = recording()
    return score(rig, run.raw, dict(rerun(rig, run.raw, 'hand')), truth)


def still_truth(count=600):
    """Return `count` instants at rest at the origin, level."""
    zeros = np.zeros((count, 3))
    stamps = np.arange(count) * (NANOSECONDS // 200)
    eyes = np.broadcast_to(np.eye(3), (count, 3, 3))
    return Truth(stamps, zeros, eyes, zeros, zeros + np.array([0, 0, 9.81]), np.ones(count, bool))


def track_like(truth, **changes):
    """Return the track of an estimator that knows the truth, but for `changes`."""
    count = len(truth.stamp_ns)
    right = {
        'stamp_ns': truth.stamp_ns,
        'angular_rate': truth.angular_rate,
        'specific_force': truth.specific_force,
        'R_nb': truth.R_nb,
        'attitude_sigma_n': np.full((count, 3), 1e-3),
        'position_n': truth.position_n,
        'odom_R_nb': truth.R_nb,
        'still': truth.still,
        'weights': np.full((count, IMUS), 1 / IMUS),
    }
    return Track(**{**right, **changes})
