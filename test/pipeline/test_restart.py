"""A restart in mid-walk: the chain goes on from a saved state, in the frame of before."""

import numpy as np
import pytest

from multiimu_ros.odometry.saved_state import load_state, save_state
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import row
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

pytestmark = pytest.mark.slow  # where nothing is compiled

FOOT = PipelineConfig(profile='foot')
PAUSE_S = 0.5  # a reboot: in it the foot goes on


def pushed(pipeline, samples, part):
    values = np.hstack([samples.angular_rate, samples.specific_force])[part]
    imus = np.zeros(len(values), np.int64)
    return list(pipeline.push_block(imus, samples.stamp_ns[part], values))


def test_a_restart_in_mid_walk_goes_on_where_it_was(tmp_path):
    path = trajectory('foot', 30.0, seed=4)
    board = simulate(row(1), path, 200.0, seed=4)
    rig, samples = calibrated_rig(board.rig, 5), board.raw[0]
    seconds = 1e-9 * (samples.stamp_ns - samples.stamp_ns[0])
    before, after = seconds < 16.0, seconds > 16.0 + PAUSE_S

    first = Pipeline(rig, FOOT)
    assert first.snapshot() is None
    last = pushed(first, samples, before)[-1]
    state = first.snapshot()
    assert state.stamp_ns == last.stamp_ns
    save_state(state, tmp_path / 'state.json')

    second = Pipeline(rig, FOOT)
    now_ns = int(samples.stamp_ns[after][0])
    second.restore(load_state(tmp_path / 'state.json', second.owner, now_ns))
    frames = pushed(second, samples, after)

    truth = path.at(1e-9 * (np.array([frame.stamp_ns for frame in frames]) - board.truth_ns[0]))
    # The walk starts at the origin with yaw zero, so truth and odometry share a frame.
    error = truth.position_n - np.array([frame.position_n for frame in frames])
    sigma = np.sqrt([np.diag(frame.pose_covariance)[:3] for frame in frames])
    settled = slice(400, None)  # a start in motion levels within two strides
    assert (np.abs(error[settled]) < 4.0 * sigma[settled]).all()
    # A walker's speed times the pause, and the way to the first stance; from anew it is metres.
    assert np.linalg.norm(error[-1]) < 2.0
    assert np.linalg.norm(truth.position_n[0]) > 3.0
    # The pause is told: at 1.5 m/s the rig may be 0.75 m off in each axis.
    assert sigma[0].min() > 0.7
    # Biases were learnt before, and are known at once.
    assert np.abs(frames[0].gyro_bias - last.gyro_bias).max() < 1e-3


def test_a_jump_in_time_forgets_the_frame_of_before():
    path = trajectory('foot', 12.0, seed=4)
    samples = simulate(row(1), path, 200.0, seed=4).raw[0]
    rig = row(1)
    first = Pipeline(rig, FOOT)
    pushed(first, samples, slice(0, 2000))
    second = Pipeline(rig, FOOT)
    second.restore(first.snapshot())
    pushed(second, samples, slice(1500, 2000))
    again = pushed(second, samples, slice(0, 100))  # the recording starts again
    assert second.time_jumps == 1
    assert np.linalg.norm(again[-1].position_n) < 0.1
