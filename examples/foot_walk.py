"""A walk with an IMU on the foot: from the numbers of a logger to a path and its report.

    python examples/foot_walk.py short_walk.csv   # columns: s, x y z in deg/s, x y z in g
    python examples/foot_walk.py                  # nothing recorded yet? Simulate a walk.

Both leave in `foot_walk/` a bag that any ROS tool plays, the rig file that says what is known of
the IMU, and `fuse.html` with the pictures.  From here on the terminal does the same:

    cd foot_walk; multiimu fuse bag --rig rig.yaml --profile foot -o fused --report .
"""

import argparse
from pathlib import Path
import shutil

import numpy as np

from multiimu_ros.bags import BagWriter, read_imus
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.report.walk import as_walk, Walk
from multiimu_ros.report.walk_page import WalkFacts, write_walk_page
from multiimu_ros.report.walk_summary import summarise
from multiimu_ros.rig import load_rig, parse_rig, Rig, save_rig
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

G = 9.80665  # [m/s^2] what a data sheet calls g
TOPIC = '/imu0/data_raw'
SECOND = 1_000_000_000  # [ns]


def describe(model: str, gyroscope: float, accelerometer: float) -> Rig:
    """Return a rig of one IMU with that noise density [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].

    Its scale and axes are taken as the factory left them, its biases as good to a third of a
    degree a second and to a hundredth of g: the filter finds the rest while the foot stands.
    `multiimu allan` and `multiimu calibrate` would tell more.
    """
    noise = {'gyroscope': [gyroscope] * 3, 'accelerometer': [accelerometer] * 3}
    intrinsics = {
        'gyroscope': {'bias_sigma': [5e-3] * 3},
        'accelerometer': {'bias_sigma': [0.1] * 3},
    }
    imu = {
        'name': 'imu0',
        'frame_id': 'imu0_link',
        'model': model,
        'noise': {'noise_density': noise},
        'intrinsics': intrinsics,
    }
    return parse_rig(
        {'version': 1, 'rig': {'name': 'foot', 'gravity': G}, 'imus': [imu]}, 'this example'
    )


def read_walk(path: Path) -> ImuSamples:
    """Return the walk of a logger's CSV file in SI units, each instant once."""
    rows = np.genfromtxt(path, delimiter=',', skip_header=1)
    # This logger writes some rows twice; a sample with the stamp of another one tells nothing.
    rows = rows[np.diff(rows[:, 0], prepend=-np.inf) > 0]
    stamps = SECOND + np.round(SECOND * rows[:, 0]).astype(np.int64)
    return ImuSamples(stamps, np.deg2rad(rows[:, 1:4]), G * rows[:, 4:7])


def simulated_walk(rig: Rig) -> ImuSamples:
    """Return what the IMU of `rig` would read on a foot that walks around a square."""
    return simulate(rig, trajectory('foot', 40.0, seed=3), rate_hz=200.0, seed=3).raw[0]


def write_bag(path: Path, samples: ImuSamples) -> None:
    """Write the samples as a rosbag2 folder with one topic of sensor_msgs/Imu."""
    shutil.rmtree(path, ignore_errors=True)  # of an earlier run
    with BagWriter(path) as bag:
        bag.add_topic(TOPIC, 'sensor_msgs/msg/Imu')
        messages = encode_imus('imu0_link', samples)
        for stamp_ns, message in zip(samples.stamp_ns.tolist(), messages, strict=True):
            bag.write(TOPIC, stamp_ns, message)


def navigate(bag: Path, rig: Path) -> tuple[Walk, Pipeline]:
    """Return where the foot went, as `multiimu fuse` finds it."""
    pipeline = Pipeline(load_rig(rig), PipelineConfig(profile='foot'))
    samples = read_imus(bag, [TOPIC]).tracks[0].samples
    values = np.hstack([samples.angular_rate, samples.specific_force])
    imu0 = np.zeros(len(samples), np.int64)
    return as_walk(pipeline.push_block(imu0, samples.stamp_ns, values)), pipeline


def main() -> None:
    """Write bag, rig file and report; say in three lines how the walk went."""
    parser = argparse.ArgumentParser(description=__doc__.partition('\n')[0])
    parser.add_argument('csv', type=Path, nargs='?', help='recording; without it, a simulation')
    parser.add_argument('-o', '--output', type=Path, default=Path('foot_walk'), help='folder')
    options = parser.parse_args()
    folder = options.output
    folder.mkdir(parents=True, exist_ok=True)

    if options.csv:  # an NGIMU; its maker prints no noise, so this is what its rests show
        rig, walked = describe('NGIMU', gyroscope=1e-4, accelerometer=1.2e-3), options.csv.stem
        samples = read_walk(options.csv)
    else:  # as the data sheet of the BMI160 says
        rig, walked = describe('BMI160', gyroscope=1.2e-4, accelerometer=1.8e-3), 'simulated'
        samples = simulated_walk(rig)
    save_rig(rig, folder / 'rig.yaml')
    write_bag(folder / 'bag', samples)

    walk, pipeline = navigate(folder / 'bag', folder / 'rig.yaml')
    about = WalkFacts(recording=walked, rig='foot', profile='foot', imus=pipeline.health())
    page = write_walk_page(folder, walk, about)

    summary = summarise(walk, foot=True)
    apart, sigma = np.linalg.norm(summary.from_start), np.linalg.norm(summary.position_sigma)
    print(f'walked    {summary.distance:.1f} m in {summary.stances} stances ({walked})')
    print(f'end error {apart:.2f} m, if the walk ended where it began; sigma {sigma:.2f} m')
    print(f'pictures  {page}')


if __name__ == '__main__':
    main()
