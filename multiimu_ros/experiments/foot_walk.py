"""Walks of a simulated foot: readings of the IMUs on its instep, the chain over them, its errors.

The loop of `simulation.gait` closes, so the error at its end hides stride lengths that are wrong;
the error all along the path does not.  Both are given as a part of the distance walked.  Frames
start in the truth's origin and yaw, which the chain's are by definition: nothing is aligned.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, NANOSECONDS, Scalars, Vectors
from multiimu_ros.experiments.board import DEGREE, drawn_rig, rms
from multiimu_ros.fused_frame import FusedFrame
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.rig import Range, Rig
from multiimu_ros.simulation.band_limited import read_band_limited
from multiimu_ros.simulation.calibrated import calibrated_rig, Residuals
from multiimu_ros.simulation.errors import BMI160, ImuErrors, STANDARD_GRAVITY, TriadErrors
from multiimu_ros.simulation.gait import duration_of
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.placements import foot
from multiimu_ros.simulation.recording import read_imu, STAGGER
from multiimu_ros.simulation.trajectories import REST_FIRST, trajectory

RATE_HZ = 200.0
IMUS = 3
DISTANCE = 100.0  # [m]
FULL_SCALE = 16 * STANDARD_GRAVITY  # [m/s^2] the widest of a BMI160, for strikes
# [rad/s per m/s^2] of each element, 0.09 deg/s per g along one axis: about the 0.1 deg/s per g of
# data sheets, so a calibration that did not look for it leaves that much.
G_SENSITIVITY = 0.05 * DEGREE / STANDARD_GRAVITY
SETTLED = 1.0  # [s] after the first stride begins; before that the position has no variance


def _wide(triad: TriadErrors) -> TriadErrors:
    return replace(triad, step=FULL_SCALE / 32768, limit=FULL_SCALE * 32767 / 32768)


ROUGH_BMI160 = replace(BMI160, accelerometer=_wide(BMI160.accelerometer))


@dataclass(frozen=True)
class Walk:
    """What the IMUs of a foot recorded on a walk, and what was true.

    Parameters
    ----------
    trajectory : Trajectory
        The truth.
    rig : Rig
        The calibrated rig file.
    times : (N,) array
        Instants of the scans; IMU k follows by k times 0.4 ms [s].
    raw : (N, K, 6) array
        Raw readings, rate then force.
    distance : float
        Length of the way over ground [m].
    end : float
        When the last stride is over [s].
    """

    trajectory: Trajectory
    rig: Rig
    times: Scalars
    raw: Matrix
    distance: float
    end: float


@dataclass(frozen=True)
class Track:
    """What the chain said at N instants.

    Parameters
    ----------
    times : (N,) array
        [s]
    position_n : (N, 3) array
        [m]
    R_nb : (N, 3, 3) array
        Attitude of the odometry.
    covariance : (N, 3, 3) array
        Of the position [m^2]; NaN where the scheme has none.
    """

    times: Scalars
    position_n: Vectors
    R_nb: Matrix
    covariance: Matrix


@dataclass(frozen=True)
class Score:
    """Errors of one walk.

    Parameters
    ----------
    end, path : float
        Of the position at the end, and rms along the path, of the distance walked [-].
    end_plan, path_plan : float
        The same without height.
    yaw : float
        At the end, signed [rad].
    nees : float
        Normalised square of the position error, per axis, mean over the walk [-].
    nees_at : (M,) array
        The same at M instants evenly spread over the walk.
    """

    end: float
    path: float
    end_plan: float
    path_plan: float
    yaw: float
    nees: float
    nees_at: Scalars


def make_walk(
    seed: int,
    *,
    rough: bool,
    distance: float = DISTANCE,
    standing: float = 0.0,
    count: int = IMUS,
) -> Walk:
    """Simulate a foot around its loop, and `standing` [s] more at the end of it.

    Clean: smooth swings, still stances, instantaneous samples, a careful calibration.  Rough:
    strikes and rolling of `simulation.foot_realism`, bandwidth and range of a BMI160, and a
    calibration that did not look for g-sensitivity.
    """
    path = trajectory('foot_rough' if rough else 'foot', duration_of(distance), seed)
    path = replace(path, duration=path.duration + standing)
    return carry(path, np.random.default_rng([seed, rough]), rough=rough, count=count)


def carry(path: Trajectory, rng: np.random.Generator, *, rough: bool, count: int = IMUS) -> Walk:
    """Return what newly drawn IMUs record along a path; `rough` as in `make_walk`."""
    errors = ROUGH_BMI160 if rough else BMI160
    true = drawn_rig(foot(count), [errors] * count, rng)
    left = Residuals(g_sensitivity=G_SENSITIVITY) if rough else Residuals()
    times = np.arange(round(path.duration * RATE_HZ)) / RATE_HZ
    raw = _read(true, path, times, errors, rng, rough=rough)
    rig = with_range(calibrated_rig(true, int(rng.integers(2**31)), left), errors)
    steps = np.diff(path.at(times).position_n[:, :2], axis=0)
    walked = float(np.hypot(*steps.T).sum())
    return Walk(path, rig, times, raw, walked, float(path.path.time[-2]))


def with_range(rig: Rig, errors: ImuErrors) -> Rig:
    """Return the rig file that says where the readings end, as data sheets do."""
    full_scale = Range(accelerometer=errors.accelerometer.limit, gyroscope=errors.gyroscope.limit)
    imus = tuple(imu.model_copy(update={'range': full_scale}) for imu in rig.imus)
    return rig.model_copy(update={'imus': imus})


def _read(
    true: Rig,
    path: Trajectory,
    times: Scalars,
    errors: ImuErrors,
    rng: np.random.Generator,
    *,
    rough: bool,
) -> Matrix:
    pairs = []
    for k, imu in enumerate(true.imus):
        own = times + k * STAGGER
        if rough:
            pairs.append(read_band_limited(imu, path, own, errors, rng))
        else:
            pairs.append(read_imu(imu, path.at(own), RATE_HZ, errors, rng))
    return np.stack([np.hstack(pair) for pair in pairs], axis=1)


def run_chain(walk: Walk, config: PipelineConfig | None = None) -> Track:
    """Send a walk through the whole chain, as `multiimu fuse` does."""
    return as_track(fused(walk, Pipeline(walk.rig, config or PipelineConfig(profile='foot'))))


def fused(walk: Walk, pipeline: Pipeline) -> Iterable[FusedFrame]:
    """Return what a new pipeline makes of a walk."""
    count = len(walk.rig.imus)
    instants = walk.times[:, np.newaxis] + STAGGER * np.arange(count)
    stamps = np.round(instants * NANOSECONDS).astype(np.int64).ravel()
    imus = np.tile(np.arange(count), len(walk.times))
    return pipeline.push_block(imus, stamps, walk.raw.reshape(-1, 6))


def as_track(frames: Iterable[FusedFrame]) -> Track:
    """Return the odometry of frames whose clock is that of the walk."""
    seen = list(frames)
    orientation = np.array([frame.odom_orientation for frame in seen])
    return Track(
        np.array([frame.stamp_ns for frame in seen]) / NANOSECONDS,
        np.array([frame.position_n for frame in seen]),
        Rotation.from_quat(orientation).as_matrix(),
        np.array([frame.pose_covariance[:3, :3] for frame in seen]),
    )


def score(walk: Walk, track: Track, instants: int = 8) -> Score:
    """Return the errors of a track, from the first stride to the end of the recording."""
    kept = track.times > REST_FIRST + SETTLED
    truth = walk.trajectory.at(track.times[kept])
    error = track.position_n[kept] - truth.position_n
    moving = track.times[kept] < walk.end
    length = np.linalg.norm(error, axis=1) / walk.distance
    plan = np.linalg.norm(error[:, :2], axis=1) / walk.distance
    solved = np.linalg.solve(track.covariance[kept], error[..., np.newaxis])[..., 0]
    nees = np.einsum('ni,ni->n', error, solved) / 3
    turned = track.R_nb[kept][-1] @ truth.R_nb[-1].T
    at = np.linspace(0, np.count_nonzero(moving) - 1, instants + 1).astype(int)[1:]
    return Score(
        end=float(length[-1]),
        path=float(rms(length[moving])),
        end_plan=float(plan[-1]),
        path_plan=float(rms(plan[moving])),
        yaw=float(np.arctan2(turned[1, 0], turned[0, 0])),
        nees=float(nees[moving].mean()),
        nees_at=nees[at],
    )
