"""A simulated board is calibrated from one recording, without ROS, and held against the truth.

python examples/calibration.py
"""

import numpy as np

from multiimu_ros.rig import parse_rig
from multiimu_ros.rig_calibration.calibrate import calibrate_rig
from multiimu_ros.rig_calibration.verdicts import judge, worst
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory


def main() -> None:
    """Print what was found of the second IMU beside what is true."""
    recording = simulate(ring(2), trajectory('calibration', 200.0), rate_hz=200.0)
    names = [{'name': imu.name, 'frame_id': imu.frame_id} for imu in recording.rig.imus]
    blank = parse_rig({'version': 1, 'rig': {'name': 'new'}, 'imus': names}, 'example')
    found = calibrate_rig(blank, recording.raw)

    true, imu = recording.rig.imus[1], found.after.imus[1]
    first = recording.rig.imus[0].extrinsics
    arm = first.R_bs.T @ (true.extrinsics.lever_arm_b - first.lever_arm_b)
    for name, is_, was, sigma, unit in (
        ('accelerometer scale', imu.intrinsics.accelerometer.scale,
         true.intrinsics.accelerometer.scale, imu.intrinsics.accelerometer.scale_sigma, '-'),
        ('gyroscope scale', imu.intrinsics.gyroscope.scale,
         true.intrinsics.gyroscope.scale, imu.intrinsics.gyroscope.scale_sigma, '-'),
        ('lever arm', imu.extrinsics.lever_arm, arm, imu.extrinsics.lever_arm_sigma, 'm'),
    ):  # fmt: skip
        value, spread, truth = (np.round(numbers, 5) for numbers in (is_, sigma, was))
        print(f'{name:20}{value} +- {spread}, truth {truth} {unit}')
    print(f'{len(found.intervals)} rests; worst verdict: {worst(judge(found))}')


if __name__ == '__main__':
    main()
