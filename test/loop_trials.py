"""Foot loops over many seeds: how far off the chain is, and whether it knows.

Run `python -m benchmarks.loops` for the table; the promises are in test/pipeline/test_loops.py.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.experiments.board import rms
from multiimu_ros.experiments.foot_walk import fused, make_walk, run_chain, Score, score, Track
from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.pipeline import Pipeline, PipelineConfig

# What is known of the clean foot and not of feet: it stands like a rock, and its swings leave
# nothing that the rig file does not tell of.
LIKE_A_ROCK = {
    'zero_velocity_sigma': 0.001,  # the detector still lets the first and last of a stance in
    'rate_scale_sigma': 0.0,
    'force_scale_sigma': 0.0,
    'learning_strides': 0.0,
}


class Summary(NamedTuple):
    """What many walks have in common.

    Parameters
    ----------
    end, path : float
        Error at the end and along the path, rms over the seeds, of the distance [-].
    end_median, path_median, end_plan, path_plan : float
        Their medians; the same as the first two without height.
    yaw : float
        Rms at the end [rad].
    nees : float
        Of the position, per axis, mean over time and seeds [-].
    nees_at : (M,) array
        Mean over the seeds at instants evenly spread over the walk.
    """

    end: float
    path: float
    end_median: float
    path_median: float
    end_plan: float
    path_plan: float
    yaw: float
    nees: float
    nees_at: np.ndarray


def trial(seed: int, *, rough: bool, config: PipelineConfig | None = None) -> Score:
    """Walk one loop of 100 m through the chain."""
    walk = make_walk(seed, rough=rough)
    return score(walk, run_chain(walk, config))


def informed_trial(seed: int) -> Score:
    """Walk a clean loop, with the odometry told what foot that is."""
    walk = make_walk(seed, rough=False)
    pipeline = Pipeline(walk.rig, PipelineConfig(profile='foot'))
    frames = list(fused(walk, pipeline))
    times = np.array([frame.stamp_ns for frame in frames]) / NANOSECONDS
    odometry = ErrorStateFilter(replace(pipeline.odometry_config, **LIKE_A_ROCK))
    position, R_nb, P = np.empty((len(times), 3)), *np.empty((2, len(times), 3, 3))
    for k, frame in enumerate(frames):
        readings = np.split(np.concatenate((frame.reading, frame.density)), 4)
        dt = times[k] - times[k - 1] if k else 1.0
        odometry.push(Sample(dt, *readings, frame.still, frame.resting))
        position[k], R_nb[k], P[k] = odometry.position_n, odometry.R_nb, odometry.P[:3, :3]
    return score(walk, Track(times, position, R_nb, P))


def summary(scores: Sequence[Score]) -> Summary:
    """Return what the scores have in common."""

    def column(name):
        return np.array([getattr(one, name) for one in scores])

    return Summary(
        end=float(rms(column('end'))),
        path=float(rms(column('path'))),
        end_median=float(np.median(column('end'))),
        path_median=float(np.median(column('path'))),
        end_plan=float(rms(column('end_plan'))),
        path_plan=float(rms(column('path_plan'))),
        yaw=float(rms(column('yaw'))),
        nees=float(column('nees').mean()),
        nees_at=column('nees_at').mean(axis=0),
    )


def moved_while_standing(seed: int, *, rough: bool, seconds: float = 60.0) -> float:
    """Return how far the position moves from a second after a walk to its end [m]."""
    walk = make_walk(seed, rough=rough, distance=20.0, standing=seconds)
    track = run_chain(walk)
    # The rest is noticed after a second without motion, and learnt from 0.25 s late.
    standing = track.position_n[track.times > walk.end + 2.0]
    return float(np.linalg.norm(standing - standing[0], axis=1).max())
