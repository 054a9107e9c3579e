"""Eight simulated IMUs through the whole chain, sample by sample, without ROS or files.

What a node does with messages, these lines do with numbers.  The first run also compiles the
kernels and leaves them in numba's cache, which is why `make install` ends with it.
"""

import numpy as np

from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory


def main() -> None:
    """Wave a ring of eight about for ten seconds; say how well the chain followed."""
    recording = simulate(ring(8), trajectory('hand', duration=10.0), rate_hz=200.0)
    pipeline = Pipeline(calibrated_rig(recording.rig), PipelineConfig(input='raw', profile='hand'))

    frames = []
    for scan in range(len(recording.truth_ns)):
        for imu, samples in enumerate(recording.raw):
            values = np.concatenate([samples.angular_rate[scan], samples.specific_force[scan]])
            frames += pipeline.push(imu, int(samples.stamp_ns[scan]), values)

    fused = np.array([frame.angular_rate for frame in frames])
    truth = recording.truth.angular_rate_b[: len(fused)]
    error = np.rad2deg(np.sqrt(np.mean((fused - truth) ** 2)))
    print(f'{len(frames)} frames; rms error of the fused rate {error:.3f} deg/s')


if __name__ == '__main__':
    main()
