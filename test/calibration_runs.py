"""Recordings for the tests of the calibration: simulated ones, and boards that are exact.

On an exact board the poses follow from the integrated turns and not the other way round, so that
no rounding of time steps stands between the truth and a fit, however few the samples.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.poses import PoseReadings, Transition
from multiimu_ros.calibration.preintegration import preintegrate
from multiimu_ros.rig_calibration.imu_state import ImuState, ImuView
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.placements import row
from multiimu_ros.simulation.recording import simulate, Timing
from multiimu_ros.simulation.trajectories import calibration_path

GRAVITY = 9.80665
REST, POSE, MOVE = 4.0, 3.0, 3.0  # [s] of a simulated recording
STAY, TURN = 4.0, 2.0  # [s] in a pose, and in a move, of an exact board
NOMINAL = (np.eye(3), np.zeros(3), np.zeros((3, 3)))


def recorded(poses=8, imus=1, rate_hz=100.0, errors=BMI160, seed=0, **timing):
    """Return the simulated recording of a rest and `poses` poses, 3 s each and 3 s apart."""
    rng = np.random.default_rng(seed)
    path = calibration_path(poses, rng, rest=REST, pose=POSE, waving=0.0)
    duration = REST + poses * (MOVE + POSE)
    return simulate(
        row(imus), Trajectory(path, duration), rate_hz, errors, seed, timing=Timing(**timing)
    )


def rests_of(recording):
    """Return where the rests of `recorded` begin and end (P, 2) [s]."""
    poses = round((recording.truth.time[-1] - REST) / (MOVE + POSE))
    begin = REST + MOVE + (MOVE + POSE) * np.arange(poses)
    return np.vstack([[0.0, REST], np.column_stack([begin, begin + POSE])])


@dataclass(frozen=True)
class ExactBoard:
    """K IMUs in P poses: what each saw, its true parameters, and the true attitudes (P, 3, 3)."""

    views: tuple[ImuView, ...]
    states: tuple[ImuState, ...]
    R_k: np.ndarray


def unit(rng, R, size=1.0):
    """Draw the parameters of an IMU like those of a BMI160, or `size` times as far off."""
    scatter = [size * x for x in (0.01, 0.005, 0.2, 0.01, 0.02, 1e-4)]
    shapes = (3, 3, 3, (3, 3), 3, (3, 3))
    scale, shear, force_bias, E, rate_bias, G = (
        s * rng.standard_normal(shape) for s, shape in zip(scatter, shapes, strict=True)
    )
    return ImuState(1.0 + scale, shear, force_bias, np.eye(3) + E, rate_bias, G, R)


def exact_board(rng, imus=1, poses=14, samples=7, *, density=(0.0, 0.0), axes=(1.0, 1.0, 1.0)):
    """Return a board whose K IMUs see exactly what their parameters say, but for white noise.

    `density` is that of rate and force; `axes` scales what the moves turn about each axis.
    """
    states = [unit(rng, np.eye(3))]
    states += [unit(rng, Rotation.random(random_state=rng).as_matrix()) for _ in range(imus - 1)]
    moves = [Transition(m, m + 1, m * samples, (m + 1) * samples) for m in range(poses - 1)]
    time, rate, force = _moves(rng, len(moves), samples, np.array(axes))
    turns, _ = preintegrate(time, rate, force, moves, NOMINAL)
    R_k = [Rotation.random(random_state=rng).as_matrix()]
    for turn in turns:
        R_k.append(R_k[-1] @ turn)
    up = GRAVITY * np.array(R_k)[:, 2]
    views = [_view(rng, state, moves, (time, rate, force), up, density) for state in states]
    return ExactBoard(tuple(views), tuple(states), np.array(R_k))


def _moves(rng, count, samples, axes):
    """Return instants (N,), rates and forces (N, 3) of swelling turns by some 2 rad each."""
    phase = np.linspace(0.0, 1.0, samples)[:, np.newaxis]
    swell = 2 * np.sin(np.pi * phase) ** 2 / TURN
    parts = []
    for m in range(count):
        angle = axes * rng.choice([-1, 1], 3) * rng.uniform(0.6, 1.6, 3)
        wobble = axes * rng.standard_normal(3) * np.sin(2 * np.pi * phase)
        force = GRAVITY * Rotation.random(random_state=rng).as_matrix()[2]
        time = REST + (STAY + TURN) * m + TURN * phase
        parts.append(np.hstack([time, swell * angle + wobble, force + 2 * np.sin(6 * phase)]))
    time, *values = np.concatenate(parts).T
    return time, np.column_stack(values[:3]), np.column_stack(values[3:])


def _view(rng, state, moves, motion, up, density):
    """Return what one IMU reads along the moves, and in the poses with `up` (P, 3) [m/s^2]."""
    time, rate, force = motion
    step = time[1] - time[0]
    raw_rate, raw_force = readings(state, rate @ state.R, force @ state.R)
    raw_rate = raw_rate + density[0] / np.sqrt(step) * rng.standard_normal(raw_rate.shape)
    still_rate, still_force = readings(state, np.zeros_like(up), up @ state.R)
    still_rate = still_rate + density[0] / np.sqrt(STAY) * rng.standard_normal(up.shape)
    still_force = still_force + density[1] / np.sqrt(STAY) * rng.standard_normal(up.shape)
    middle = REST - STAY / 2 + (STAY + TURN) * np.arange(len(up))
    said = [np.full(3, max(one, floor)) for one, floor in zip(density, (1e-6, 1e-5), strict=True)]
    poses = PoseReadings(middle, np.full(len(up), STAY), still_rate, still_force, *said)
    return ImuView(poses, tuple(moves), time, raw_rate, raw_force)


def readings(state, rate, force):
    """Return what an IMU reads, (N, 3) each, under the true `rate` and `force` (N, 3)."""
    felt = np.linalg.solve(state.E, (rate + force @ state.G.T).T).T
    return felt + state.rate_bias, np.linalg.solve(state.E_a, force.T).T + state.force_bias


def parameters(state):
    """Return the first 30 unknowns of an IMU (30,)."""
    gyroscope = [state.E.ravel(), state.rate_bias, state.G.ravel()]
    return np.concatenate([state.scale, state.shear, state.force_bias, *gyroscope])
