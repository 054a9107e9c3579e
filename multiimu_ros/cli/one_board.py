"""Which topics look like one board: IMUs on one rigid body turn at one speed, at any mounting.

Clocks may differ by some seconds, so that the speeds are compared at several delays.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from multiimu_ros.arrays import Scalars
from multiimu_ros.calibration.rests import BIN_NS, Motion

ALIKE = 0.9  # correlation; a coarse delay costs 0.03, strangers moved in time reach 0.8
DELAY = 20  # bins: 2 s
SHORT = 100  # bins: 10 s, less is no evidence
STRANGE = -1.0  # correlation of what shares less than that
STIRRED = 0.05  # of its greatest: share of bins that must move to tell anything


@dataclass
class Board:
    """Topics that look like one board.

    Parameters
    ----------
    topics : list of str
        The first one is what the others were compared with.
    correlations : dict
        Of the speed of each further topic with that of the first [-].
    """

    topics: list[str]
    correlations: dict[str, float] = field(default_factory=dict)


def group_boards(motions: Mapping[str, Motion]) -> list[Board]:
    """Group topics by how they turn, the largest group first.

    IMUs that never turn cannot be told apart; they count as one board where they overlap in time.
    """
    start_ns = min((int(m.middle_ns[0]) for m in motions.values() if len(m.middle_ns)), default=0)
    speeds = {topic: _speed(motion, start_ns) for topic, motion in motions.items()}
    boards: list[Board] = []
    for topic, speed in speeds.items():
        scores = [compare(speeds[board.topics[0]], speed) for board in boards]
        best = int(np.argmax(scores)) if scores else -1
        if scores and scores[best] >= ALIKE:
            boards[best].topics.append(topic)
            boards[best].correlations[topic] = scores[best]
        else:
            boards.append(Board([topic]))
    return sorted(boards, key=lambda board: -len(board.topics))


def _speed(motion: Motion, start_ns: int) -> Scalars:
    """Return how fast it turned at each tenth of a second since `start_ns`; NaN where unknown."""
    times = (motion.middle_ns - start_ns) / BIN_NS
    if not len(times):
        return np.zeros(0)
    bias = motion.rests.mean_rate[0] if len(motion.rests) else np.zeros(3)
    speed = np.linalg.norm(motion.mean_rate - bias, axis=1)
    speed[motion.still] = 0.0
    grid = np.arange(int(times[-1]) + 1)
    nearest = np.clip(np.searchsorted(times, grid), 0, len(times) - 1)
    before = np.maximum(nearest - 1, 0)
    known = (np.abs(times[nearest] - grid) <= 1.0) | (np.abs(times[before] - grid) <= 1.0)
    return np.where(known, np.interp(grid, times, speed), np.nan)


def compare(one: Scalars, other: Scalars) -> float:
    """Return the correlation of two speeds at the best delay; 1 if both always rest together.

    Parameters
    ----------
    one, other : (N,), (M,) arrays
        Speeds at the same instants; NaN where unknown.
    """
    size = max(len(one), len(other))
    padded = [np.pad(s, (0, size - len(s)), constant_values=np.nan) for s in (one, other)]
    best = STRANGE
    for delay in range(-DELAY, DELAY + 1):
        a = padded[0][max(delay, 0) : size + min(delay, 0)]
        b = padded[1][max(-delay, 0) : size + min(-delay, 0)]
        best = max(best, _correlation(a, b))
    return best


def _correlation(a: Scalars, b: Scalars) -> float:
    both = np.isfinite(a) & np.isfinite(b)
    if both.sum() < SHORT:
        return STRANGE
    a, b = a[both], b[both]
    moving = [bool((s > 0.0).mean() > STIRRED) for s in (a, b)]
    if not any(moving):
        return 1.0
    if not all(moving):
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


def closeness(one: Motion, other: Motion) -> float:
    """Return how alike two IMUs turned, -1 to 1; -1 where they share less than 10 s."""
    start_ns = min(one.middle_ns[:1].tolist() + other.middle_ns[:1].tolist(), default=0)
    return compare(_speed(one, start_ns), _speed(other, start_ns))


def shared_share(motions: Sequence[Motion], motion: Motion) -> float:
    """Return how much time `motion` covers, over what the longest of all covers [-]."""
    longest = max((len(other.middle_ns) for other in motions), default=0)
    return len(motion.middle_ns) / longest if longest else 1.0
