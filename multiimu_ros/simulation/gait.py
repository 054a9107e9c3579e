"""Walking: the path of a foot with stance phases, around a loop that closes exactly.

A stride takes about 1.2 s and 1.2 m.  In its first part the foot stands flat and does not move at
all; then the heel rises, the foot swings forward with its toe down, turns its toe up, strikes and
comes flat.  The loop goes straight, turns left by 90 deg in three strides, and so on four times;
every heading has its opposite, hence the strides add up to zero.  A rough walk strikes harder and
rolls in its stances (`foot_realism`).
"""

import numpy as np

from multiimu_ros.arrays import Scalars
from multiimu_ros.simulation.foot_realism import rolling, strikes
from multiimu_ros.simulation.paths import Path, through

STRIDE_LENGTH = 1.2  # [m]
STRIDE_TIME = 1.2  # [s]
STANCE_SHARE = 0.4  # of a stride during which the foot stands
STRIDE_SPREAD = 0.02  # relative, from stride to stride: time, lift and pitch
LIFT = 0.10  # [m] the foot is raised
HEEL_OFF_PITCH = 0.9  # [rad] toe down, about +y
STRIKE_PITCH = -0.35  # [rad] toe up
STRIKE_SHAKE = 1e-4  # [m] amplitude of the vibration after the strike: some 3 m/s^2
CORNER = np.deg2rad([30.0, 60.0, 90.0])  # headings while turning left
HEEL_STRIKE = 0.88  # of the swing; the sole is flat at its end, some 90 ms later
MIN_STRIDES = 4  # fewer cannot turn back into the first heading


def strides_within(duration: float, standing: float) -> int:
    """Return how many whole strides fit after `standing` and before a last second [s], even."""
    # The slowest draw of the stride times still has to end in time.
    count = int((duration - standing - 1.0) / (STRIDE_TIME * (1 + 3 * STRIDE_SPREAD)))
    return max(count - count % 2, 0)


def duration_of(distance: float, standing: float = 4.0) -> float:
    """Return a duration [s] that lets the foot walk at least `distance` [m]."""
    strides = 2 * np.ceil(distance / STRIDE_LENGTH / 2)
    return float(standing + 1.0 + (strides + 1) * STRIDE_TIME * (1 + 3 * STRIDE_SPREAD))


def headings(strides: int) -> Scalars:
    """Return the heading of each stride [rad]: a closed loop of `strides`, an even number."""
    half = strides // 2
    corner = CORNER if half >= 2 * len(CORNER) else np.linspace(0, np.pi / 2, half // 2 + 1)[1:]
    straight = half - 2 * len(corner)
    first = straight - straight // 2
    side = np.concatenate(
        (np.zeros(first), corner, np.full(straight - first, np.pi / 2), np.pi / 2 + corner)
    )
    # Each corner ends in the heading of the next side; the last ends in the way back.
    return np.concatenate((side, np.pi + side))


def walk(
    duration: float, standing: float, rng: np.random.Generator, *, rough: bool = False
) -> Path:
    """Return the path of a foot that stands, walks around its loop, and stands again.

    Parameters
    ----------
    duration, standing : float
        Length of the recording, and of the rest at its beginning [s].
    rng : Generator
        Draws the spread from stride to stride.
    rough : bool
        Whether the foot strikes and rolls as real ones do.
    """
    path = through([0.0, duration])
    strides = strides_within(duration, standing)
    if strides < MIN_STRIDES:
        return path
    spread = 1 + STRIDE_SPREAD * np.clip(rng.standard_normal((3, strides)), -3, 3)
    times = STRIDE_TIME * spread[0]
    start = standing + np.concatenate(([0.0], np.cumsum(times)[:-1])) + STANCE_SHARE * times
    swing = (1 - STANCE_SHARE) * times
    heading = headings(strides)
    path += _advance(start, swing, heading)
    lift = np.outer(LIFT * spread[1], [0.0, 1.0, 0.0])
    path += through(_instants(start, swing, (0.0, 0.45, 0.95)), z=lift.ravel())
    pitch = np.outer(spread[2], [0.0, HEEL_OFF_PITCH, STRIKE_PITCH, 0.0])
    path += through(_instants(start, swing, (0.0, 0.35, 0.8, 1.0)), pitch=pitch.ravel())
    if not rough:
        return path + _strikes(start + 0.95 * swing, rng)
    flat = start + swing
    path += strikes(start + HEEL_STRIKE * swing, flat, heading, rng)
    stood = np.concatenate(([0.0], heading[:-1]))
    return path + rolling(np.concatenate(([standing], flat[:-1])), start, stood, rng)


def _advance(start: Scalars, swing: Scalars, heading: Scalars) -> Path:
    """Return the footholds: one step forward per swing, turning into the stride's heading."""
    step = STRIDE_LENGTH * np.column_stack((np.cos(heading), np.sin(heading)))
    footholds = np.concatenate((np.zeros((1, 2)), np.cumsum(step, axis=0)))
    footholds[-1] = 0.0  # closed, up to rounding
    yaw = np.concatenate(([0.0], heading))
    time = np.column_stack((start, start + swing)).ravel()
    both = [np.column_stack((v[:-1], v[1:])).ravel() for v in (*footholds.T, yaw)]
    return through(time, x=both[0], y=both[1], yaw=both[2])


def _instants(start: Scalars, swing: Scalars, shares: tuple[float, ...]) -> Scalars:
    """Return the instants [s] at the given shares of every swing, one swing after the other."""
    return np.asarray((start[:, np.newaxis] + swing[:, np.newaxis] * np.array(shares)).ravel())


def _strikes(strike: Scalars, rng: np.random.Generator, step: float = 0.01) -> Path:
    """Return the vibration that follows each heel strike and dies out within 60 ms."""
    decay = np.array([0.0, 1.0, -0.7, 0.4, -0.2, 0.1, 0.0])
    time = strike[:, np.newaxis] + step * np.arange(len(decay))
    strength = STRIKE_SHAKE * rng.uniform(0.5, 1.5, (3, len(strike)))
    x, y, z = (np.outer(axis, decay).ravel() for axis in strength)
    return through(time.ravel(), x=x, y=y, z=z)
