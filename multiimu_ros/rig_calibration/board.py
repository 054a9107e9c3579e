"""What the stages of a calibration share: the recording, cleaned, and the rig as known so far."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Vectors
from multiimu_ros.calibration.cleaning import clean, CleanTrack, LEAST_SAMPLES
from multiimu_ros.calibration.sensor_model import calibrate
from multiimu_ros.calibration.static_intervals import StaticIntervals
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig import Imu, Rig
from multiimu_ros.samples import ImuSamples

LIKE_G = (0.5, 2.0)  # median |force| of an accelerometer in g
TURN = 60.0  # [rad/s] 3400 deg/s: beyond any gyroscope of this class
LIKE_RAW = 100.0  # [m/s^2] median: counts, or milli-g


@dataclass(frozen=True)
class Board:
    """A recording of K IMUs and the rig that describes them.

    Parameters
    ----------
    rig : Rig
        What is known so far; the stages return boards that know more.
    tracks : tuple of K CleanTrack
        Raw readings; after the time stage on the clock of the first.
    """

    rig: Rig
    tracks: tuple[CleanTrack, ...]

    @property
    def gravity(self) -> float:
        """Local gravity [m/s^2]."""
        return self.rig.rig.gravity_magnitude

    def with_imus(self, imus: Sequence[Imu]) -> 'Board':
        """Return the board with other knowledge of its IMUs."""
        return Board(self.rig.model_copy(update={'imus': tuple(imus)}), self.tracks)

    def calibrated(self, imu: int) -> ImuSamples:
        """Return the samples of one IMU with its intrinsics applied."""
        return calibrate(self.tracks[imu].samples, self.rig.imus[imu].intrinsics)


def take_board(rig: Rig, samples: Sequence[ImuSamples]) -> Board:
    """Clean a recording and refuse what is no recording of IMUs in SI.

    Raises
    ------
    CalibrationError
        If an IMU has hardly any samples, or its units are wrong.
    """
    tracks = tuple(clean(track) for track in samples)
    for imu, track in zip(rig.imus, tracks, strict=True):
        if len(track.samples) < LEAST_SAMPLES:
            msg = (
                f'`{imu.name}` must have at least {LEAST_SAMPLES} sound samples, got '
                f'{len(track.samples)}; look at its driver, or leave it out with `--topics`.'
            )
            raise CalibrationError(msg)
        refuse_units(imu.name, track.samples)
    return Board(rig, tracks)


def refuse_units(name: str, samples: ImuSamples) -> None:
    """Refuse readings that are not in m/s^2 and rad/s.

    Raises
    ------
    CalibrationError
        Says what the readings look like.
    """
    force = float(np.median(np.linalg.norm(samples.specific_force, axis=1)))
    rate = float(np.quantile(np.linalg.norm(samples.angular_rate, axis=1), 0.99))
    if force <= LIKE_G[0]:
        msg = (
            f'`{name}` reads a force of {force:.3g} m/s^2: gravity was taken out, and must stay '
            f'in; publish what the accelerometer feels, and record again.'
        )
        raise CalibrationError(msg)
    if force < LIKE_G[1]:
        msg = f'`{name}` reads a force of {force:.3g}: that is g, and must be m/s^2; '
    elif force > LIKE_RAW:
        msg = f'`{name}` reads a force of {force:.0f}: counts or milli-g, and must be m/s^2; '
    elif rate > TURN:
        msg = f'`{name}` reads rates up to {rate:.0f}: deg/s or counts, and must be rad/s; '
    else:
        return
    msg += 'convert it in the driver and record again.'
    raise CalibrationError(msg)


def pose_means(samples: ImuSamples, intervals: StaticIntervals) -> Vectors:
    """Return the mean specific force (P, 3) of each rest; NaN where nothing was heard [m/s^2]."""
    first = np.searchsorted(samples.stamp_ns, intervals.begin_ns, side='left')
    last = np.searchsorted(samples.stamp_ns, intervals.end_ns, side='right')
    means = np.full((len(intervals), 3), np.nan)
    for k, (begin, end) in enumerate(zip(first, last, strict=True)):
        if end > begin:
            means[k] = samples.specific_force[begin:end].mean(axis=0)
    return means
