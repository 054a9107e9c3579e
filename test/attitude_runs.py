"""Settings of an attitude filter in a hand, and eight IMUs there, for the tests."""

from blocks import frames_of
import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.attitude import AttitudeConfig
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

CONFIG = AttitudeConfig(
    rate_bias_sigma=np.full(3, 2e-3),
    force_bias_sigma=np.full(3, 0.03),
    rate_bias_walk=np.full(3, 4e-6),
    motion_sigma=0.5,
    motion_reach=0.1,
    still_sigma=0.03,
    still_velocity_sigma=0.005,
    still_velocity_time=0.05,
)


def attitude_error_of_eight(seed, duration, rate_hz):
    """Return the rms of inclination and yaw [deg] of eight calibrated BMI160s in a hand."""
    path = trajectory('hand', duration, seed)
    simulated = simulate(ring(), path, rate_hz, seed=seed)
    pipeline = Pipeline(calibrated_rig(simulated.rig, seed + 1000), PipelineConfig())
    frames = frames_of(pipeline, simulated.raw)
    time = 1e-9 * (np.array([frame.stamp_ns for frame in frames]) - simulated.truth_ns[0])
    answer = Rotation.from_quat(np.array([frame.orientation for frame in frames]))
    error = Rotation.from_matrix(path.at(time).R_nb) * answer.inv()
    # No rig knows its heading: that of the start is taken off.
    turn = Rotation.from_rotvec([0.0, 0.0, error[0].as_rotvec()[2]]).inv()
    x, y, z = np.rad2deg((turn * error).as_rotvec())[time > 3.0].T
    return np.sqrt(np.mean(x**2 + y**2)), np.sqrt(np.mean(z**2))
