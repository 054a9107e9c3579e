"""Two dozen simulated calibrations against the Cramer-Rao bound, and against their own sigmas.

The bound is computed here from a forward model of its own: means of the
accelerometer and the gyroscope in 61 rests, and the turns between them, under the covariance that
the simulated noise has (white, flicker and random walk; within the turns the white part alone,
which can only lower the bound).  No estimator without bias does better.
"""

import dataclasses
import functools

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.poses import Transition
from multiimu_ros.calibration.preintegration import preintegrate
from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.rig import parse_rig
from multiimu_ros.rig_calibration.calibrate import calibrate_rig
from multiimu_ros.rig_calibration.measurements import UPPER
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.motion import STANDARD_GRAVITY, Trajectory
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import calibration_path

pytestmark = [pytest.mark.slow, pytest.mark.long]
SEEDS, POSES, REST_S, POSE_S, MOVE_S, RATE = 24, 60, 10.0, 4.0, 3.0, 200.0
DURATION = REST_S + POSES * (POSE_S + MOVE_S) + 1.0
GROUPS = {
    'accelerometer scale': np.arange(0, 3),
    'accelerometer shear': np.arange(3, 6),
    'accelerometer bias': np.arange(6, 9),
    'gyroscope scale': np.array([9, 13, 17]),
    'gyroscope misalignment': np.array([10, 11, 12, 14, 15, 16]),
    'gyroscope bias': np.arange(18, 21),
    'gyroscope g-sensitivity': np.arange(21, 30),
}
BLANK = {'version': 1, 'rig': {'name': 'one'}, 'imus': [{'name': 'imu0', 'frame_id': 'a'}]}


def record(seed, errors=BMI160):
    """Return a simulated recording without waving: rests and turns of one IMU."""
    path = calibration_path(POSES, np.random.default_rng(seed), rest=REST_S, pose=POSE_S, waving=0)
    rig = parse_rig(BLANK, 'test')
    return simulate(rig, Trajectory(path, DURATION), RATE, errors, seed)


def parameters(intrinsics):
    """Return the thirty parameters in the order of the fit: M S of the gyroscope as one matrix."""
    a, g = intrinsics.accelerometer, intrinsics.gyroscope
    E = np.array(g.misalignment) * g.scale
    shear = np.array(a.misalignment)[UPPER]
    return np.concatenate([a.scale, shear, a.bias, E.ravel(), g.bias, np.ravel(g.g_sensitivity)])


def rests():
    """Return first and last sample of every rest, as the motion schedules them."""
    begin = np.r_[0.0, REST_S + MOVE_S + (POSE_S + MOVE_S) * np.arange(POSES)]
    end = np.r_[REST_S, begin[1:] + POSE_S]
    return np.ceil(begin * RATE).astype(int), np.floor(end * RATE).astype(int)


def drift_covariance(errors, count):
    """Return the covariance (P, P) of the rests' mean noise: white, flicker and random walk.

    Over all rests together the mean of the drift counts as bias, and is taken out.
    """
    first, last = rests()
    averages = np.zeros((len(first), count))
    for row, begin, end in zip(averages, first, last, strict=True):
        row[begin:end] = 1 / (end - begin)
    spectrum = np.fft.rfft(averages, axis=1)[:, 1:]
    frequency = np.arange(1, spectrum.shape[1] + 1) / count
    flicker = 2 / count * ((spectrum / (2 * np.pi * frequency)) @ spectrum.conj().T).real
    sums = np.cumsum(averages[:, ::-1], axis=1)[:, ::-1]  # what a step of the walk adds
    drift = errors.bias_instability**2 * flicker
    drift += errors.bias_random_walk**2 / RATE * (sums @ sums.T)
    centre = np.eye(len(first)) - 1 / len(first)
    white = errors.noise_density**2 * RATE + errors.step**2 / 12
    return centre @ drift @ centre.T + np.diag(white / (last - first))


@functools.cache
def rest_covariances():
    """Return the covariance of the rests' means, gyroscope and accelerometer."""
    count = round(DURATION * RATE)
    return [drift_covariance(e, count) for e in (BMI160.accelerometer, BMI160.gyroscope)]


def bound(recording):
    """Return the Cramer-Rao bound (30,) of the parameters of one recording."""
    time, truth = recording.truth.time, recording.truth
    theta = parameters(recording.rig.imus[0].intrinsics)
    first, last = rests()
    moves = [
        Transition(k, k + 1, end - 1, begin + 1)
        for k, (end, begin) in enumerate(zip(last[:-1], first[1:], strict=True))
    ]
    E, G = theta[9:18].reshape(3, 3), theta[21:30].reshape(3, 3)
    force, R_nb = truth.specific_force_b, truth.R_nb[first]
    raw = np.linalg.solve(E, (truth.angular_rate_b + force @ G.T).T).T + theta[18:21]
    turns, by_gyroscope = preintegrate(time, raw, force, moves, (E, theta[18:21], G))

    def forward(theta, tilts):
        M = np.eye(3)
        M[UPPER] = theta[3:6]
        E, G = theta[9:18].reshape(3, 3), theta[21:30].reshape(3, 3)
        attitudes = Rotation.from_matrix(R_nb) * Rotation.from_rotvec(tilts.reshape(-1, 3))
        felt = attitudes.inv().apply([0.0, 0.0, STANDARD_GRAVITY])
        accelerometer = theta[6:9] + np.linalg.solve(M * theta[:3], felt.T).T
        gyroscope = theta[18:21] + np.linalg.solve(E, G @ felt.T).T
        between = attitudes[:-1].inv() * attitudes[1:]
        gap = (Rotation.from_matrix(turns).inv() * between).as_rotvec()
        return np.concatenate([accelerometer.ravel(), gyroscope.ravel(), gap.ravel()])

    x = np.concatenate([theta, np.zeros(3 * len(first))])
    J = np.empty((len(forward(x[:30], x[30:])), len(x)))
    for k in range(len(x)):
        step = np.zeros(len(x))
        step[k] = 1e-6
        up, down = x + step, x - step
        J[:, k] = (forward(up[:30], up[30:]) - forward(down[:30], down[30:])) / 2e-6
    size = 3 * len(first)
    J[2 * size :, 9:30] -= by_gyroscope.reshape(-1, 21)  # what the gyroscope integrates to
    length = (first[1:] - last[:-1] + 1) / RATE
    walked = np.diag(np.repeat(BMI160.gyroscope.noise_density**2 * length, 3))
    blocks = [np.kron(rest, np.eye(3)) for rest in rest_covariances()]
    information = J.T @ np.linalg.solve(block_diag(*blocks, walked), J)
    scale = np.sqrt(np.diag(information))
    # Yaw is free: the pseudo-inverse leaves it out, and nothing else depends on it.
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-12, hermitian=True)
    return (np.sqrt(np.diag(inverse)) / scale)[:30]


def trials():
    """Return errors, sigmas and bounds (24, 30); the bias is the drift's mean over the rests."""
    rows = []
    for seed in range(SEEDS):
        recording = record(seed)
        found = calibrate_rig(parse_rig(BLANK, 'test'), recording.raw, stages=['intrinsics'])
        truth = parameters(recording.rig.imus[0].intrinsics)
        drift = mean_drift(seed)
        truth[6:9] += drift[3:]
        truth[18:21] += drift[:3]
        error = parameters(found.after.imus[0].intrinsics) - truth
        sigma = np.sqrt(np.diag(found.intrinsics[0].covariance)[:30])
        rows.append((error, sigma, bound(recording)))
    return [np.array(column) for column in zip(*rows, strict=True)]


def mean_drift(seed):
    """Return how far the mean bias over the rests is from the unit's own, rate and force (6,)."""
    noiseless = {'noise_density': 0.0, 'step': 0.0}
    # The same seed draws the same unit and the same drift, whatever is multiplied by zero.
    recording = record(
        seed,
        dataclasses.replace(
            BMI160,
            gyroscope=dataclasses.replace(BMI160.gyroscope, **noiseless),
            accelerometer=dataclasses.replace(BMI160.accelerometer, **noiseless),
        ),
    )
    raw, truth = recording.raw[0], recording.truth
    A, c = affine(recording.rig.imus[0].intrinsics)
    felt = np.hstack([truth.angular_rate_b, truth.specific_force_b])
    drift = np.hstack([raw.angular_rate, raw.specific_force]) - (felt - c) @ np.linalg.inv(A).T
    rows = [drift[begin:end].mean(axis=0) for begin, end in zip(*rests(), strict=True)]
    return np.mean(rows, axis=0)


def test_errors_are_near_the_bound_and_their_sigmas_are_honest():
    errors, sigmas, bounds = trials()
    ratios = {
        group: float(np.sqrt(np.mean(np.square(errors[:, columns] / bounds[:, columns]))))
        for group, columns in GROUPS.items()
    }
    assert max(ratios.values()) <= 1.15, ratios
    inside = np.mean(np.abs(errors) < 1.96 * sigmas)
    assert 0.92 <= inside <= 0.98
