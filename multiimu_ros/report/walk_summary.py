"""A walk in figures, without a truth.

A foot walks from stance to stance: a stance is a place where it stood, however often the detector
dropped out meanwhile, and a stride leads from one place to the next.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Flags, Matrix, Scalars, Stamps, Vector, Vectors
from multiimu_ros.report.walk import Walk

STEP = 0.15  # [m] feet that move on by less shift their weight
MOVING = 0.5  # [m/s] of a foot that looks still in mid-swing; the filter refuses to believe it
PAUSE = 1.0  # [s] a stance of a walk is shorter, so that longer ones belong to no stride


@dataclass(frozen=True)
class Stances:
    """Where a foot stood: first and last sample (M,) of each stance, and its place (M, 3) [m]."""

    begin: Stamps
    end: Stamps
    place: Vectors

    def __len__(self) -> int:
        return len(self.begin)


NOWHERE = Stances(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)))


def still_runs(still: Flags) -> tuple[Stamps, Stamps]:
    """Return the first and the last index (M,) of each run of flags."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], still.astype(np.int8), [0]])))
    return edges[::2], edges[1::2] - 1


def find_stances(walk: Walk) -> Stances:
    """Return the places where a foot stood, each as its last sample says."""
    begin, end = still_runs(walk.still)
    stood = np.linalg.norm(walk.velocity_n[end], axis=1) < MOVING
    found: list[tuple[int, int]] = []
    for first, last in zip(begin[stood].tolist(), end[stood].tolist(), strict=True):
        if found:
            moved = walk.position_n[last] - walk.position_n[found[-1][1]]
            if np.linalg.norm(moved) < STEP:
                found[-1] = found[-1][0], last
                continue
        found.append((first, last))
    indices = np.array(found, np.int64).reshape(-1, 2)
    return Stances(indices[:, 0], indices[:, 1], walk.position_n[indices[:, 1]])


def strides(walk: Walk, stances: Stances) -> tuple[Scalars, Scalars]:
    """Return length [m] and time [s] of each stride (M - 1,); no time where the foot paused."""
    seconds = walk.seconds
    length = np.linalg.norm(np.diff(stances.place, axis=0), axis=1)
    begin, end = seconds[stances.begin], seconds[stances.end]
    paused = end - begin > PAUSE
    time = np.where(paused[:-1] | paused[1:], np.nan, np.diff((begin + end) / 2))
    return length, time


@dataclass(frozen=True)
class Summary:
    """A walk in figures.

    Parameters
    ----------
    duration : float
        From the first to the last frame [s].
    distance : float
        A foot's from stance to stance, else along the path [m].
    from_start : (3,) array
        From the first position to the last [m].
    position_sigma : (2,) array
        Standard deviation of the last position: across its worst horizontal direction, of the
        height [m].
    still_share : float
        Of the frames [-].
    stances : int
        Places where a foot stood; 0 for what is no foot.
    stride_length, stride_time : float
        Medians [m], [s]; NaN without strides.
    gaps, longest_gap : int, float
        Outages, and the longest [s].
    """

    duration: float
    distance: float
    from_start: Vector
    position_sigma: Scalars
    still_share: float
    stances: int
    stride_length: float
    stride_time: float
    gaps: int
    longest_gap: float


def summarise(walk: Walk, *, foot: bool) -> Summary:
    """Return a walk in figures; `foot` says whether stances are those of a foot."""
    stances = find_stances(walk) if foot else NOWHERE
    length, time = strides(walk, stances)
    corners = walk.position_n
    if len(stances) > 1:
        corners = np.vstack([walk.position_n[:1], stances.place, walk.position_n[-1:]])
    return Summary(
        duration=float(walk.seconds[-1]),
        distance=float(np.linalg.norm(np.diff(corners, axis=0), axis=1).sum()),
        from_start=walk.position_n[-1] - walk.position_n[0],
        position_sigma=position_sigma(walk)[-1],
        still_share=float(walk.still.mean()),
        stances=len(stances),
        stride_length=_median(length),
        stride_time=_median(time),
        gaps=len(walk.gaps),
        longest_gap=float(walk.gaps.max(initial=0.0)),
    )


def _median(values: Scalars) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else float('nan')


def position_sigma(walk: Walk) -> Matrix:
    """Return the sigma (N, 2) of the position, horizontally at its worst and of the height [m]."""
    P = walk.position_covariance
    return np.column_stack([worst_horizontal(P), np.sqrt(np.maximum(P[:, 2, 2], 0.0))])


def worst_horizontal(P: Matrix) -> Scalars:
    """Return the largest sigma (N,) that covariances (N, 3, 3) have along a horizontal axis."""
    mean = (P[:, 0, 0] + P[:, 1, 1]) / 2
    worst = mean + np.hypot((P[:, 0, 0] - P[:, 1, 1]) / 2, P[:, 0, 1])
    return np.asarray(np.sqrt(np.maximum(worst, 0.0)))
