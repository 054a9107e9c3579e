"""The recordings of `broad`: one IMU moved by hand, its orientation seen by cameras [1]_.

The IMU's data sheet is not known, so it is taken for what a rig file without calibration means;
only its accelerometer is taken for one that the maker calibrated, to 10 mg.

.. [1] D. Laidig, M. Caruso, A. Cereatti, T. Seel, "BROAD - a benchmark for robust inertial
   orientation estimation", Data 6(7), 2021.
"""

from dataclasses import dataclass, replace

import h5py
import numpy as np
from realdata import data_set
from scipy.spatial.transform import Rotation, Slerp
import vqf

from multiimu_ros.odometry.profiles import odometry_configs, PROFILES
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.odometry.zero_velocity import StillnessDetector
from multiimu_ros.rig import NOMINAL_BIAS_SIGMA, NOMINAL_NOISE, NOMINAL_SCALE_SIGMA
from multiimu_ros.synchronization.delay import fit_time_map
from multiimu_ros.synchronization.rate_track import RateTrack

TRIALS = ('02', '12', '18')
RATE_HZ = 2000.0 / 7.0
DENSITIES = tuple(
    np.array(getattr(NOMINAL_NOISE.noise_density, kind)) for kind in ('gyroscope', 'accelerometer')
)
DETECTOR, ATTITUDE, _ = odometry_configs(
    PROFILES['hand'],
    gravity=9.80665,
    rate_bias_sigma=np.array(NOMINAL_BIAS_SIGMA.gyroscope),
    force_bias_sigma=np.full(3, 0.1),
    rate_bias_walk=np.array(NOMINAL_NOISE.bias_random_walk.gyroscope),
    force_bias_walk=np.array(NOMINAL_NOISE.bias_random_walk.accelerometer),
    rate_scale_sigma=NOMINAL_SCALE_SIGMA.gyroscope[0],
)


@dataclass(frozen=True)
class Trial:
    """One recording: rates and forces (N, 3), true attitude, and where it counts (N,)."""

    angular_rate: np.ndarray
    specific_force: np.ndarray
    truth: Rotation  # identity where the cameras lost sight
    counts: np.ndarray

    @property
    def time(self):
        return np.arange(len(self.counts)) / RATE_HZ


@dataclass(frozen=True)
class Score:
    """Errors of one filter on one trial."""

    inclination: float  # rmse [deg]
    heading: float  # rmse after removing a constant offset [deg]
    drift: float  # slope of the heading error [deg/min]

    def __str__(self):
        errors = f'inclination {self.inclination:.3f}, heading {self.heading:.2f} deg rmse'
        return f'{errors}, {self.drift:+.2f} deg/min'


def load(number):
    """Return the trial of that number, on the clock of the data set."""
    (path,) = data_set('broad').glob(f'{number}_*.hdf5')
    with h5py.File(path) as file:
        assert np.isclose(file.attrs['sampling_rate'], RATE_HZ)
        w_first = file['opt_quat'][:]
        seen = np.isfinite(w_first).all(axis=1)
        w_first[~seen] = [1.0, 0.0, 0.0, 0.0]
        return Trial(
            file['imu_gyr'][:],
            file['imu_acc'][:],
            Rotation.from_quat(w_first[:, [1, 2, 3, 0]]),
            file['movement'][:].astype(bool) & seen,
        )


def delay(trial):
    """Return by how much the IMU's samples are younger in the file than they are [s].

    The rates tell, without any filter: those of the gyroscope against those of the cameras.
    """
    turned = (trial.truth[:-2].inv() * trial.truth[2:]).as_rotvec() * (RATE_HZ / 2.0)
    known = trial.counts[:-2] & trial.counts[1:-1] & trial.counts[2:]
    cameras = RateTrack(trial.time[1:-1], np.where(known[:, np.newaxis], turned, np.nan))
    return -fit_time_map(cameras, RateTrack(trial.time, trial.angular_rate)).delay


def synchronised(trial):
    """Return the trial with the truth of the instants at which the IMU sampled."""
    late = delay(trial)
    then = np.clip(trial.time - late, 0.0, trial.time[-1])
    reach = int(np.ceil(late * RATE_HZ))
    seen = np.convolve(trial.counts, np.ones(reach + 1), 'full')[: len(then)] > reach + 0.5
    return replace(trial, truth=Slerp(trial.time, trial.truth)(then), counts=seen)


def score(trial, estimate):
    """Compare an estimate (N,) of the attitude with the truth, as [1]_ does.

    The error is a rotation in the earth's frame: first about the vertical (heading), then about
    a level axis (inclination).
    """
    _, _, z, w = (estimate * trial.truth.inv()).as_quat()[trial.counts].T
    inclination = 2.0 * np.arccos(np.minimum(1.0, np.hypot(w, z)))
    heading = np.unwrap(2.0 * np.arctan2(z, w))
    drift, _ = np.polyfit(trial.time[trial.counts] / 60.0, heading, 1)
    rmse = np.sqrt(np.mean(inclination**2)), np.std(heading)
    return Score(*np.rad2deg((*rmse, drift)).tolist())


def estimate(trial, kind):
    """Return the attitudes (N,) that a filter of `kind` finds."""
    detector, attitude = StillnessDetector(DETECTOR), kind(ATTITUDE)
    answers, dt = np.empty((len(trial.counts), 3, 3)), 1.0 / RATE_HZ
    for k, (w, f) in enumerate(zip(trial.angular_rate, trial.specific_force, strict=True)):
        flags = detector.push(dt, w - attitude.gyro_bias, f, *DENSITIES)
        attitude.push(Sample(dt, w, f, *DENSITIES, *flags))
        answers[k] = attitude.R_nb
    return Rotation.from_matrix(answers)


def reference(trial):
    """Return the attitudes (N,) that VQF finds with its defaults and no magnetometer."""
    readings = map(np.ascontiguousarray, (trial.angular_rate, trial.specific_force))
    w_first = vqf.VQF(1.0 / RATE_HZ).updateBatch(*readings)['quat6D']
    return Rotation.from_quat(w_first[:, [1, 2, 3, 0]])
