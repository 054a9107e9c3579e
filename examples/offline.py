"""Eight simulated IMUs become one, without ROS: simulate, fuse, hold against the truth.

python examples/offline.py
"""

from multiimu_ros.report.comparison import rerun, score
from multiimu_ros.report.truth import as_truth
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory


def main() -> None:
    """Print the errors of the best IMU, the plain mean and the array."""
    recording = simulate(ring(8), trajectory('hand', 20.0), rate_hz=200.0)
    rig = calibrated_rig(recording.rig)
    tracks = dict(rerun(rig, recording.raw, 'hand'))
    truth = as_truth(recording.truth, recording.truth_ns)
    for row in score(rig, recording.raw, tracks, truth).rows:
        best, mean, fused = (row.quantity.per_si * x for x in (row.best, row.mean, row.fused))
        name, unit = row.quantity.name, row.quantity.unit
        print(f'{name:15} best IMU {best:6.1f}  mean {mean:6.1f}  array {fused:6.1f} {unit}')


if __name__ == '__main__':
    main()
