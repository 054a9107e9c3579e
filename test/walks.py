"""Real feet: recordings with what is known of where they went, and the data sets' own metrics.

What is told of each sensor is the same for all its recordings: the larger of its data sheet's
noise and the noise of its calmest half seconds, and biases as its data sheet leaves them.
"""

from dataclasses import dataclass, field

import numpy as np
from realdata import data_set
from scipy.io import loadmat

from multiimu_ros.odometry.attitude import AttitudeFilter
from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.profiles import FOOT, odometry_configs
from multiimu_ros.odometry.rest import RestBuffer, Sample
from multiimu_ros.odometry.zero_velocity import StillnessDetector

Z_DOWN = np.array([1.0, -1.0, -1.0])  # turns a frame whose z axis points down about x
# The Vicon positions of pyshoe are in x and y of such a frame, but their z points up: feet that
# rise read positive.
Y_FLIPPED = np.array([1.0, -1.0, 1.0])
PYSHOE_TRIALS = 14
SHOE_LABELS = 'zv_shoe_opt'


@dataclass(frozen=True)
class Sensor:
    """Noise densities, biases that the calibration leaves, their walks; rate, force: (3,) each."""

    rate_density: np.ndarray
    force_density: np.ndarray
    rig: tuple[np.ndarray, ...]


def sensor(rate_density, force_density, rate_bias, force_bias):
    """Return a sensor with the same figures on all axes."""
    # Random walks within a few minutes, as in-run instabilities of 20 deg/h and 0.1 mg suggest.
    figures = (rate_bias, force_bias, 1e-5, 1e-4)
    rig = tuple(np.full(3, figure) for figure in figures)
    return Sensor(np.full(3, rate_density), np.full(3, force_density), rig)


# MicroStrain GX3-25: 0.03 deg/s/sqrt(Hz), 80 ug/sqrt(Hz) printed, 1.5e-3 found; 0.25 deg/s when
# switched on; 2 mg printed, but |f| at rest differs from g by up to 10 mg between trials.
GX3 = sensor(5.5e-4, 1.5e-3, 5e-3, 0.1)
# 3DM-GX5-25: 0.005 deg/s/sqrt(Hz), 25 ug/sqrt(Hz) printed, 8e-4 found; 0.04 deg/s, 2 mg.
GX5 = sensor(1e-4, 8e-4, 1e-3, 0.03)
# x-io NGIMU: no noise printed; found. A consumer chip, calibrated in the factory.
NGIMU = sensor(1e-4, 1.2e-3, 5e-3, 0.1)


@dataclass(frozen=True)
class Recording:
    """One walk: stamps (N,) [s], rate (N, 3) [rad/s] and force (N, 3) [m/s^2] with z up.

    `truth` is what the data set has: positions (N, 3) of Vicon, footprints (M, 2), or None for a
    loop; `instants` (M,) are the samples at which the foot stood on the footprints.
    """

    name: str
    sensor: Sensor
    time: np.ndarray
    rate: np.ndarray
    force: np.ndarray
    truth: np.ndarray | None = None
    instants: np.ndarray | None = None
    labels: np.ndarray | None = None  # (N,) still, by SHOE with a threshold that knew the truth
    gravity: float = 9.80665


def pyshoe_vicon():
    """Return the 14 trials with Vicon positions."""
    recordings = []
    for path in sorted(data_set('pyshoe_vicon').glob('*.mat')):
        trial = loadmat(path)
        force, rate = trial['imu'][:, :3] * Z_DOWN, trial['imu'][:, 3:] * Z_DOWN
        still = trial[SHOE_LABELS].ravel().astype(bool)
        stamps, truth = trial['ts'].ravel(), trial['gt'] * Y_FLIPPED
        recordings.append(
            Recording(path.stem, GX3, stamps, rate, force, truth=truth, labels=still)
        )
    assert len(recordings) == PYSHOE_TRIALS
    return recordings


def gaitdriven(number):
    """Return walk 31 or 32, with footprints in a frame whose z axis points up as well."""
    stem = f'SensorConnectData_{number}'
    folder = data_set('gaitdriven')
    rows = np.loadtxt(folder / f'{stem}.csv', delimiter=',', skiprows=1)
    prints = np.loadtxt(
        folder / f'{stem}_strideIndex_timestamp_gcpX_gcpY.csv', delimiter=',', skiprows=1
    )
    force, rate = 9.80665 * rows[:, 1:4] * Z_DOWN, rows[:, 4:7] * Z_DOWN
    # Their stamps tell which samples: the first column is off by one in the last row.
    instants = np.abs(rows[:, :1] - prints[:, 1]).argmin(axis=0)
    footprints = prints[:, 2:] * Z_DOWN[:2]
    return Recording(stem, GX5, rows[:, 0], rate, force, truth=footprints, instants=instants)


def xio_gait():
    """Return the short walk, a closed loop, without its duplicated rows."""
    rows = np.genfromtxt(data_set('xio_gait') / 'short_walk.csv', delimiter=',', skip_header=1)
    rows = rows[np.diff(rows[:, 0], prepend=-np.inf) > 0]
    return Recording(
        'short_walk', NGIMU, rows[:, 0], np.deg2rad(rows[:, 1:4]), 9.80665 * rows[:, 4:7]
    )


@dataclass
class Walk:
    """What detector and filter said at each sample, causally."""

    flags: np.ndarray  # (N, 2) still, resting
    position: np.ndarray  # (N, 3)
    covariance: np.ndarray  # (N, 15, 15)
    odometry: ErrorStateFilter = field(repr=False)


def walk(recording, profile=FOOT, labels=None, configs=None):
    """Run detector, rest buffer and filters over a recording, as `Pipeline` does.

    Parameters
    ----------
    recording : Recording
        The walk.
    profile : Profile
        How the rig moves.
    labels : (N,) array, optional
        Still or not, in place of what the detector says; then nothing counts as rest.
    configs : tuple, optional
        Configs of detector, attitude and odometry, in place of those of the profile.
    """
    known = recording.sensor
    configs = configs or odometry_configs(profile, recording.gravity, *known.rig)
    detector, attitude = StillnessDetector(configs[0]), AttitudeFilter(configs[1])
    odometry, rest = ErrorStateFilter(configs[2]), RestBuffer(configs[1].resting_lag)
    n, densities = len(recording.time), (known.rate_density, known.force_density)
    steps = np.diff(recording.time)
    steps = np.concatenate(([np.median(steps)], steps))
    out = Walk(np.zeros((n, 2), bool), np.zeros((n, 3)), np.zeros((n, 15, 15)), odometry)
    for k, (dt, w, f) in enumerate(zip(steps, recording.rate, recording.force, strict=True)):
        if labels is not None:
            out.flags[k, 0] = labels[k]
        else:
            biases = attitude.gyro_bias, odometry.accel_bias
            out.flags[k] = detector.push(dt, w - biases[0], f - biases[1], *densities)
        still, resting = map(bool, out.flags[k])
        for sample in rest.push(Sample(dt, w, f, *densities, still, resting)):
            attitude.step(sample)
            odometry.step(sample)
        out.position[k], out.covariance[k] = odometry.position_n, odometry.P
    return out


def as_complex(points):
    """Return horizontal points (N, 2 or 3) as complex numbers, in which a yaw is a factor."""
    return points[:, 0] + 1j * points[:, 1]


def vicon_turn(recording, position):
    """Return the yaw that the data set's metric aligns by, as a unit complex number."""
    truth = recording.truth - recording.truth[0]
    first = np.flatnonzero(np.hypot(*truth.T[:2]) >= 0.8)[0]
    turn = as_complex(truth)[first] / as_complex(position - position[0])[first]
    return turn / abs(turn)


def vicon_error(recording, position):
    """Return the metric of pyshoe_vicon [m], horizontal.

    Yaw aligned at the first sample 0.8 m away; time mean of sqrt(mean over x, y of error^2).
    """
    track = as_complex(position - position[0]) * vicon_turn(recording, position)
    path = as_complex(recording.truth - recording.truth[0])
    return np.mean(np.abs(track - path)) / np.sqrt(2)


def footprint_error(recording, position):
    """Return the metric of gaitdriven [m]: mean distance to all footprints, horizontal.

    Its publishers turn the path such that the third footprint lies in the measured direction
    from the first one, at which the origin is; heading at the start is not known otherwise.
    """
    steps, path = as_complex(position)[recording.instants], as_complex(recording.truth)
    steps, path = steps - steps[0], path - path[0]
    turn = path[3] / steps[3]
    return np.mean(np.abs(steps * turn / abs(turn) - path))


def end_error(position):
    """Return how far from its start a closed loop ends [m], height included."""
    return np.linalg.norm(position[-1] - position[0])
