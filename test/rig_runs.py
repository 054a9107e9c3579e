"""Full simulated calibrations, shared by the tests of the stages: each costs some seconds."""

from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.static_intervals import StaticIntervals
from multiimu_ros.rig import parse_rig
from multiimu_ros.rig_calibration.calibrate import calibrate_rig
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import calibration_path

IMUS = 3
RATE = 200.0
LATE = 0.002  # [s] of each IMU's clock behind the one before
MISPLACED = 0.001  # [m] of each IMU from where it was drawn
TILTED = 0.02  # [rad] likewise


def bare_rig(count=IMUS):
    """Return a rig that knows nothing but names and gravity."""
    imus = [{'name': f'imu{k}', 'frame_id': f'imu{k}_link'} for k in range(count)]
    head = {'name': 'board', 'gravity': 9.80665}
    return parse_rig({'version': 1, 'rig': head, 'imus': imus}, 'test')


@cache
def recorded(seed, poses=60, waving=60.0):
    """Return a recording of three BMI160s soldered on somewhat askew."""
    rng = np.random.default_rng(seed)
    imus = []
    for k, imu in enumerate(ring(IMUS).imus):
        R = Rotation.from_rotvec(TILTED * rng.standard_normal(3))
        arm = imu.extrinsics.lever_arm_b + MISPLACED * rng.standard_normal(3)
        pose = {'rotation': tuple(R.as_quat()), 'lever_arm': tuple(arm)}
        update = {'extrinsics': imu.extrinsics.model_copy(update=pose), 'time_offset': LATE * k}
        imus.append(imu.model_copy(update=update))
    rig = ring(IMUS).model_copy(update={'imus': tuple(imus)})
    path = calibration_path(poses, rng, waving=waving)
    return simulate(rig, Trajectory(path, 10.0 + 7.0 * poses + waving), RATE, seed=seed)


@cache
def calibrated(seed, *, drawn=False):
    """Return the calibration of a recording, from a bare rig or from the drawn poses."""
    rig = bare_rig()
    if drawn:
        poses = [imu.extrinsics for imu in ring(IMUS).imus]
        rig = rig.model_copy(
            update={
                'imus': tuple(
                    imu.model_copy(update={'extrinsics': pose})
                    for imu, pose in zip(rig.imus, poses, strict=True)
                )
            }
        )
    return calibrate_rig(rig, recorded(seed).raw)


def true_mountings(seed):
    """Return the true rotations into, and arms in, the first IMU's frame: (K, 3, 3), (K, 3)."""
    poses = [imu.extrinsics for imu in recorded(seed).rig.imus]
    first = poses[0].R_bs.T
    arms = np.array([pose.lever_arm_b for pose in poses])
    return np.array([first @ pose.R_bs for pose in poses]), (arms - arms[0]) @ first.T


def turn_between(R, S):
    """Return the rotation vector (3,) of R' S [rad]."""
    return Rotation.from_matrix(R.T @ S).as_rotvec()


def scaled(samples, *, rate=1.0, force=1.0):
    """Return samples in another unit."""
    return ImuSamples(
        samples.stamp_ns, rate * samples.angular_rate, force * samples.specific_force
    )


def rests_of(board, *spans):
    """Return intervals [s] since the first sample of the first IMU."""
    start = board.tracks[0].samples.stamp_ns[0]
    begin, end = (
        start + np.round(1e9 * np.array(t)).astype(np.int64) for t in zip(*spans, strict=True)
    )
    return StaticIntervals(begin, end)
