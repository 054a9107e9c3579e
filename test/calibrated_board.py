"""A calibrated board for the tests of its report, and one that only rested."""

from functools import cache

import numpy as np

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.cleaning import clean
from multiimu_ros.calibration.static_intervals import StaticIntervals
from multiimu_ros.rig import parse_rig
from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.rig_calibration.calibrate import calibrate_rig, Calibration
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.errors import BMI160, draw_noise
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import calibration_path

RATE = 100.0
POSES, WAVING = 24, 24.0  # [-], [s]
DURATION = 4.0 + 7.0 * POSES + WAVING  # [s]
DELAY = 0.02  # [s] of each IMU after the one before


def bare_rig(count):
    """Return a rig that knows nothing but the names of its IMUs."""
    imus = [{'name': f'imu{k}', 'frame_id': f'imu{k}_link'} for k in range(count)]
    return parse_rig(
        {'version': 1, 'rig': {'name': 'board', 'gravity': 9.80665}, 'imus': imus}, ''
    )


@cache
def calibrated(*, drawn=True):
    """Return the calibration of three IMUs, from a rig with drawn poses or from a bare one."""
    base = ring(3)
    late = [imu.model_copy(update={'time_offset': DELAY * k}) for k, imu in enumerate(base.imus)]
    path = calibration_path(POSES, np.random.default_rng(5), waving=WAVING)
    true = base.model_copy(update={'imus': tuple(late)})
    run = simulate(true, Trajectory(path, DURATION), RATE, seed=5)
    return calibrate_rig(base if drawn else bare_rig(3), run.raw)


@cache
def rested(seconds, count=1):
    """Return a calibration that ran no stage, of IMUs that lay still."""
    rng, size = np.random.default_rng(6), round(seconds * RATE)
    stamps = 10**18 + np.arange(size) * (NANOSECONDS // round(RATE))
    tracks = []
    for _ in range(count):
        rate = draw_noise(size, RATE, BMI160.gyroscope, rng)
        force = draw_noise(size, RATE, BMI160.accelerometer, rng) + np.array([0.0, 0.0, 9.9])
        tracks.append(clean(ImuSamples(stamps, rate, force)))
    rig = bare_rig(count)
    intervals = StaticIntervals(stamps[:1], stamps[-1:])
    return Calibration(rig, rig, Board(rig, tuple(tracks)), intervals)
