"""What a foot does that a smooth swing between still stances does not.

*Strikes.*  The heel touches down at up to 0.9 m/s forwards and hardly any speed downwards [1]_;
heel pad and sole stop it within some 10 ms, which makes shocks of 50 to 140 m/s^2, and the shoe
rings for 50 ms.  The forefoot slaps down a little later, a third as hard.

*Rolling.*  A foot in stance is never quite still: it rolls from heel to ball about its contact
with the ground, and sole and soft tissue give way and come back.  A point of the foot moves by
about 1 cm/s even at its slowest [2]_.  The IMU, above and behind the ball, moves forwards
meanwhile, so whoever takes the stance for still finds strides too short.

Everything is a `Path`: bounded, smooth, differentiated exactly, felt by each IMU at its own place.

.. [1] D. A. Winter, "Foot trajectory in human gait", Physical Therapy 72(1), 1992.
.. [2] A. Peruzzi, U. Della Croce, A. Cereatti, "Estimation of stride length in level walking using
   an inertial measurement unit attached to the foot", J. Biomechanics 44(10), 2011.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars
from multiimu_ros.simulation.paths import Path

# Of the foot before a strike, in the directions of `CHANNELS` [m/s], [rad/s]: least and most.
STRIKE_SPEED = np.array([[0.3, -0.15, -0.3, -0.5, 0.5, -0.5], [0.9, 0.15, -0.1, 0.5, 2.0, 0.5]])
STRIKE_TIME = 0.010  # [s] in which heel pad and sole stop it
APPROACH = 0.06  # [s] in which the foot gathers that speed
RING_STEP = 0.0065  # [s] half a period of the shoe's ringing, 77 Hz
RING = np.array([0.0, 0.6, -0.4, 0.25, -0.15, 0.1, 0.0])  # its peaks, of that of the strike
SLAP = 1 / 3  # strength of the forefoot's strike, of the heel's

BALL, HEIGHT = 0.08, 0.07  # [m] from the IMU on the instep forwards and down to the ball
ROLL_TIME = np.array([0.0, 0.6, 1.0])  # of a stance: flat, over the ball, heel begins to rise
ROLL_PITCH = np.deg2rad([0.0, 1.0, 3.0])
ROLL_RATE = np.array([0.0, 0.1, 0.25])  # [rad/s]: the IMU moves by 1 and 2.7 cm/s
LIFTED = 0.2  # [s] after the stance, when the swing has made up for the roll
SIDE_ROLL, PIVOT = np.deg2rad([1.0, 0.5])  # about the forward axis, about the vertical: sigmas
SINK, SHEAR = 0.0015, 0.001  # [m] by which sole and soft tissue give way, down and forwards
SPREAD = 0.3  # of all of these, from stride to stride


def strikes(heel: Scalars, flat: Scalars, heading: Scalars, rng: np.random.Generator) -> Path:
    """Return what strikes add to the path.

    Parameters
    ----------
    heel, flat : (M,) arrays
        Instants at which the heel touches the ground, and at which the sole does [s].
    heading : (M,) array
        Of each stride [rad].
    rng : Generator
        Draws how hard each is.
    """
    speed = rng.uniform(STRIKE_SPEED[0], STRIKE_SPEED[1], (len(heel), 6))
    return _blows(heel, speed, heading, rng) + _blows(flat, SLAP * speed, heading, rng)


def _blows(at: Scalars, speed: Matrix, heading: Scalars, rng: np.random.Generator) -> Path:
    """Return the last of the approach at `speed` (M, 6), its end in a strike, and the ringing."""
    times = np.concatenate([[-APPROACH, 0.0], STRIKE_TIME + RING_STEP * np.arange(len(RING))])
    value, first = np.zeros((2, len(at), len(times), 6))
    # The quintic that stops within half of speed times time brakes by 1.5 speed / time at most.
    value[:, 1], first[:, 1] = -0.5 * STRIKE_TIME * speed, speed
    # A minimum-jerk move of d in time T accelerates by 5.77 d / T^2.
    size = 1.5 * np.abs(speed) / STRIKE_TIME * RING_STEP**2 / 5.77
    signs = rng.choice([-1.0, 1.0], (len(at), 1, 6))
    value[:, 2:] = signs * RING[:, np.newaxis] * size[:, np.newaxis]
    return _in_heading(at[:, np.newaxis] + times, value, first, np.zeros_like(first), heading)


def rolling(begin: Scalars, end: Scalars, heading: Scalars, rng: np.random.Generator) -> Path:
    """Return what the foot does in its stances.

    Parameters
    ----------
    begin, end : (M,) arrays
        When the sole touches the ground, and when the heel leaves it [s].
    heading : (M,) array
        In which the foot stands [rad].
    rng : Generator
        Draws how much.
    """
    count = len(begin)
    strength = rng.uniform(1 - SPREAD, 1 + SPREAD, (3, count, 1))
    path = _heel_to_ball(begin, end, heading, strength[0])
    span = (end - begin)[:, np.newaxis]
    value = np.zeros((count, 4, 6))
    value[:, 1, 0], value[:, 1, 2] = SHEAR * strength[1, :, 0], -SINK * strength[1, :, 0]
    side, pivot = rng.standard_normal((2, count)) * [[SIDE_ROLL], [PIVOT]]
    # About contacts below the IMU, and ahead of it.
    value[:, 1, 3], value[:, 1, 1] = side, -HEIGHT * side
    value[:, 2, 5], value[:, 2, 1] = pivot, -BALL * pivot
    times = np.hstack(
        [begin[:, np.newaxis] + span * [0.0, 0.45, 0.9], end[:, np.newaxis] + LIFTED]
    )
    still = np.zeros_like(value)
    return path + _in_heading(times, value, still, still, heading)


def _heel_to_ball(begin: Scalars, end: Scalars, heading: Scalars, strength: Matrix) -> Path:
    """Return the roll about the ball: R_y(angle) moves the IMU at [-BALL, 0, HEIGHT] from it."""
    times = np.hstack([
        begin[:, np.newaxis] + (end - begin)[:, np.newaxis] * ROLL_TIME,
        end[:, np.newaxis] + LIFTED,
    ])  # fmt: skip
    angle, rate = (strength * np.append(each, 0.0) for each in (ROLL_PITCH, ROLL_RATE))
    c, s = np.cos(angle), np.sin(angle)
    value, first, second = np.zeros((3, *angle.shape, 6))
    value[..., 0], value[..., 2] = BALL * (1 - c) + HEIGHT * s, BALL * s - HEIGHT * (1 - c)
    first[..., 0], first[..., 2] = (BALL * s + HEIGHT * c) * rate, (BALL * c - HEIGHT * s) * rate
    second[..., 0] = (BALL * c - HEIGHT * s) * rate**2
    second[..., 2] = (-BALL * s - HEIGHT * c) * rate**2
    value[..., 4], first[..., 4] = angle, rate
    return _in_heading(times, value, first, second, heading)


def _in_heading(
    times: Matrix, value: Matrix, first: Matrix, second: Matrix, heading: Scalars
) -> Path:
    """Return the path of M pieces of K keyframes (M, K, 6), x being forwards in each of them."""
    c, s = np.cos(heading)[:, np.newaxis], np.sin(heading)[:, np.newaxis]
    turned = []
    for channels in (value, first, second):
        x, y = channels[..., 0].copy(), channels[..., 1].copy()
        channels[..., 0], channels[..., 1] = c * x - s * y, s * x + c * y
        turned.append(channels.reshape(-1, 6))
    return Path(times.ravel(), *turned)
