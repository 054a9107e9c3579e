"""The named motions: what the seeds' experiments did to their boards, and a hand and a foot.

Every motion starts and ends at rest at the origin's height, stays within a few decimetres of its
place (the foot walks a closed loop), and is the same for the same name, duration and seed.
"""

from collections.abc import Callable

import numpy as np

from multiimu_ros.errors import ConfigError
from multiimu_ros.simulation.gait import walk
from multiimu_ros.simulation.motion import Motion, STANDARD_GRAVITY, Trajectory
from multiimu_ros.simulation.paths import Path, stepper_move, through

REST_FIRST = 4.0  # [s] of rest before any motion: filters initialise, biases are measured
HAND_POSITION_RMS = 0.1  # [m] per axis
HAND_ANGLE_RMS = 0.35  # [rad] per axis
POSE_TIME, MOVE_TIME = 4.0, 3.0  # [s] in one pose of a calibration, and from pose to pose


def _static(duration: float, rng: np.random.Generator) -> Path:
    """Stand still on a table that is not quite level."""
    roll, pitch = rng.uniform(-0.05, 0.05, 2)
    return through([0.0, duration], roll=[roll, roll], pitch=[pitch, pitch])


def _turntable(duration: float, _rng: np.random.Generator) -> Path:
    """Turn by 180 deg about z in 3 s, rest, turn back, rest (thesis 9.1.4.3)."""
    path = through([0.0, duration])
    for k, start in enumerate(_starts(duration, move=3.0, rest=1.0)):
        path += stepper_move(start, 3.0, yaw=-np.pi if k % 2 else np.pi)
    return path


def _slider(duration: float, _rng: np.random.Generator) -> Path:
    """Slide 0.5 m, turn 90 deg, slide back, turn back, in stepper moves (TUM 4, figure 9)."""
    path = through([0.0, duration])
    moves: tuple[dict[str, float], ...] = ({'x': 0.5}, {'yaw': np.pi / 2})
    moves += ({'x': -0.5}, {'yaw': -np.pi / 2})
    for k, start in enumerate(_starts(duration, move=1.5, rest=0.5)):
        path += stepper_move(start, 1.5, **moves[k % 4])
    return path


def _starts(duration: float, move: float, rest: float) -> np.ndarray:
    """Return the instants at which moves begin, after the first rest, all done in `duration`."""
    return np.arange(REST_FIRST, duration - move - rest / 2, move + rest)


def _hand(duration: float, rng: np.random.Generator) -> Path:
    """Wave the board about in bouts of about 8 s, laying it down anew for 2 s in between."""
    path = through([0.0, duration])
    start = REST_FIRST
    while duration - start > 4.0:
        # The last bout ends half a second before the recording does.
        stop = min(start + rng.uniform(6.0, 10.0), duration - 0.5)
        path += _bout(start, stop, rng)
        path += _lay_elsewhere(path, start, stop, rng)
        start = stop + rng.uniform(1.5, 2.5)
    return path


def _lay_elsewhere(path: Path, start: float, stop: float, rng: np.random.Generator) -> Path:
    """Return the move from the present resting pose to a new one, tilted by some 20 deg."""
    goal = rng.normal(scale=[0.15, 0.15, 0.1, 0.35, 0.35, 0.7])
    here = path.at(np.array([start]))[0][0]
    value = np.stack((np.zeros(6), goal - here))
    return Path(np.array([start, stop]), value, np.zeros((2, 6)), np.zeros((2, 6)))


def _bout(start: float, stop: float, rng: np.random.Generator, step: float = 0.02) -> Path:
    """Return a sum of sinusoids per channel that swells from rest and dies down to rest again."""
    rms = np.repeat([HAND_POSITION_RMS, HAND_ANGLE_RMS], 3)
    count = 4
    omega = 2 * np.pi * rng.uniform(0.3, [[0.8], [1.3]], (2, 3 * count)).reshape(6, count)
    phase = rng.uniform(0, 2 * np.pi, (6, count))
    time = np.linspace(0.0, stop - start, int((stop - start) / step) + 1)
    angle = omega * time[:, np.newaxis, np.newaxis] + phase  # (M, 6, count)
    scale = (rms * np.sqrt(2 / count))[:, np.newaxis]
    wave = [np.sum(scale * term, axis=2) for term in (
        np.sin(angle), omega * np.cos(angle), -(omega**2) * np.sin(angle)
    )]  # fmt: skip
    swell = _swell(time)
    value = swell[0] * wave[0]
    first = swell[1] * wave[0] + swell[0] * wave[1]
    second = swell[2] * wave[0] + 2 * swell[1] * wave[1] + swell[0] * wave[2]
    return Path(start + time, value, first, second)


def _swell(time: np.ndarray, ramp: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an envelope (M, 1) that rises in one second, falls in the last, and its slopes."""
    end = time[-1]
    envelope = through([0.0, ramp, end - ramp, end], x=[0.0, 1.0, 1.0, 0.0])
    value, first, second = envelope.at(time)
    return value[:, :1], first[:, :1], second[:, :1]


def _calibration(duration: float, rng: np.random.Generator) -> Path:
    """Rest, lay the board into pose after pose, wave it about: what a calibration asks for."""
    rest = max(REST_FIRST, 0.05 * duration)
    waving = 0.2 * duration
    poses = int((duration - rest - waving) / (POSE_TIME + MOVE_TIME))
    return calibration_path(poses, rng, rest=rest, waving=waving)


def calibration_path(
    poses: int,
    rng: np.random.Generator,
    *,
    rest: float = 10.0,
    pose: float = POSE_TIME,
    waving: float = 60.0,
) -> Path:
    """Return a rest, `poses` still poses all over the sphere, and a time of waving about.

    Parameters
    ----------
    poses : int
        How many; their "up" directions lie on a Fibonacci lattice, in random order.
    rng : Generator
        Draws order, places, and the waving.
    rest, pose, waving : float
        Length of the first rest, of each pose and of the waving [s]; moves take 3 s.
    """
    index = rng.permutation(poses)
    up_x = 1 - (2 * index + 1) / max(poses, 1)
    azimuth = np.pi * (1 + np.sqrt(5)) * index
    # With R_nb = Rz Ry Rx the third row, "up" in the sensor, is [-sp, sr cp, cr cp].
    roll = np.unwrap(np.concatenate(([0.0], azimuth)))
    pitch = np.concatenate(([0.0], np.arcsin(-up_x)))
    yaw = np.concatenate(([0.0], rng.uniform(-1.5, 1.5, poses)))
    place = np.vstack((np.zeros(3), rng.uniform(-0.15, 0.15, (poses, 3))))
    value = np.repeat(np.column_stack((place, roll, pitch, yaw)), 2, axis=0)
    begin = rest + MOVE_TIME + (pose + MOVE_TIME) * np.arange(poses)
    time = np.concatenate(([0.0, rest], np.column_stack((begin, begin + pose)).ravel()))
    path = Path(time, value, np.zeros_like(value), np.zeros_like(value))
    for start in np.arange(time[-1], time[-1] + waving - 5.0, 10.0):
        path += _bout(start + 0.5, min(start + 9.5, time[-1] + waving - 0.5), rng)
    return path


MOTIONS: dict[str, Callable[[float, np.random.Generator], Path]] = {
    'static': _static,
    'turntable': _turntable,
    'slider': _slider,
    'hand': _hand,
    'calibration': _calibration,
    'foot': lambda duration, rng: walk(duration, REST_FIRST, rng),
    'foot_rough': lambda duration, rng: walk(duration, REST_FIRST, rng, rough=True),
}


def trajectory(
    name: str, duration: float, seed: int = 0, gravity: float = STANDARD_GRAVITY
) -> Trajectory:
    """Return a named motion, to be evaluated at any instants.

    Parameters
    ----------
    name : str
        `static`, `turntable`, `slider`, `hand`, `foot`, `foot_rough` or `calibration`.
    duration : float
        Length of the recording [s]; the motion starts after 4 s and is over in time.
    seed : int
        Draws whatever the motion leaves to chance.
    gravity : float
        Local gravity [m/s^2].

    Raises
    ------
    ConfigError
        If there is no such motion, or the duration is not positive.
    """
    if name not in MOTIONS:
        msg = f'`motion` must be one of {", ".join(MOTIONS)}, got `{name}`; choose one of them.'
        raise ConfigError(msg)
    if not 0 < duration < np.inf:
        msg = f'`duration` must be a positive number of seconds, got {duration}; pass e.g. 60.'
        raise ConfigError(msg)
    path = MOTIONS[name](duration, np.random.default_rng(seed))
    return Trajectory(path, duration, gravity)


def make_motion(
    name: str, duration: float, rate_hz: float, seed: int = 0, gravity: float = STANDARD_GRAVITY
) -> Motion:
    """Return the truth of a named motion at even spacing, from 0 up to `duration` [s]."""
    count = round(duration * rate_hz)
    return trajectory(name, duration, seed, gravity).at(np.arange(count) / rate_hz)
