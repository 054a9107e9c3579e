"""A simulated walk of three IMUs on a foot, as a bag and a rig file."""

import numpy as np

from multiimu_ros.bags import BagWriter
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.rig import save_rig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import row
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

IMUS = 3


def write_walk(folder, seconds, rate_hz, seed=2):
    """Write `bag` and `rig.yaml` into a folder; return how many scans the bag holds."""
    board = simulate(row(IMUS), trajectory('foot', seconds, seed), rate_hz, seed=seed)
    save_rig(calibrated_rig(board.rig, seed), folder / 'rig.yaml')
    messages = []
    for k, samples in enumerate(board.raw):
        rows = encode_imus(f'imu{k}_link', samples)
        messages += zip(samples.stamp_ns.tolist(), [k] * len(samples), rows, strict=True)
    with BagWriter(folder / 'bag') as bag:
        for k in range(IMUS):
            bag.add_topic(f'/imu{k}/data_raw', 'sensor_msgs/msg/Imu')
        for stamp_ns, k, row_ in sorted(messages, key=lambda message: message[:2]):
            bag.write(f'/imu{k}/data_raw', stamp_ns, row_)
    return int(np.min([len(samples) for samples in board.raw]))
