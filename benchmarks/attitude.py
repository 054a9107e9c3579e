"""Attitude of an IMU in a hand against cameras: ours, VQF, and the schemes of the sources.

Run: python -m benchmarks.attitude

Prints the errors on three trials of `broad`, by the instants at which the IMU sampled and by the
clock of the file, which the gyroscope lags by 4 ms.
"""

from pathlib import Path
import sys

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

import broad

from multiimu_ros.odometry.attitude import AttitudeFilter
from multiimu_ros.odometry.madgwick import MadgwickAttitude
from multiimu_ros.odometry.rk4_attitude import Rk4Attitude


def main() -> None:
    """Score all filters on all trials."""
    for number in broad.TRIALS:
        recorded = broad.load(number)
        trial = broad.synchronised(recorded)
        print(f'trial {number}: IMU late by {1e3 * broad.delay(recorded):.2f} ms')
        answers = {'VQF': broad.reference(trial)} | {
            kind.__name__: broad.estimate(trial, kind)
            for kind in (AttitudeFilter, MadgwickAttitude, Rk4Attitude)
        }
        for name, attitude in answers.items():
            print(f'  {name:16} {broad.score(trial, attitude)}')
            print(f'  {"":16} {broad.score(recorded, attitude)} by the clock of the file')


if __name__ == '__main__':
    main()
