"""How many times faster than real time a bag of 8 x 1000 Hz becomes an IMU and an odometry.

The whole verb: read, fuse, write.  The default first, then the filters of the sources; each on
the same bag, one after the other, so that their ratios hold on any machine.
"""

from collections import deque
from pathlib import Path
import tempfile
import time

from multiimu_ros.bags import BagWriter, ImuRecording, read_imus
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.cli.fuse import fused_frames
from multiimu_ros.cli.fused_bag import fused_bag, write_fused
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.rig import Rig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate, SimulatedRecording
from multiimu_ros.simulation.trajectories import trajectory

IMUS = 8
RATE = 1000.0  # [Hz]
SECONDS = 20.0
SHORT_S = 4.0  # of a filter that is not compiled with the rest
CASES = (
    ('default (kf, carlson)', SECONDS, {}),
    ('without guard', SECONDS, {'guard': False}),
    ('noise learnt', SECONDS, {'noise': 'learnt'}),
    ('scaat', SHORT_S, {'master': 'scaat'}),
    ('kf, centralised', SHORT_S, {'master': 'centralised'}),
    ('kf, average', SHORT_S, {'master': 'average'}),
    ('ukf, carlson', SHORT_S, {'local': 'ukf'}),
    ('afukf, carlson', SHORT_S, {'local': 'afukf'}),
)


def rows() -> list[dict[str, object]]:
    result = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recording = simulate(ring(IMUS), trajectory('hand', SECONDS), RATE)
        rig = calibrated_rig(recording.rig)
        write_bags(recording, folder)
        warm_up(rig, folder)
        for title, seconds, settings in CASES:
            bag = folder / f'{seconds:g}'
            read, fuse, both = run(rig, bag, folder, PipelineConfig(**settings))
            whole = read + both
            result.append(
                {
                    'filter': title,
                    'fusing, x real time': seconds / fuse,
                    'whole verb, x real time': seconds / whole,
                    'read [us per frame]': read / (seconds * RATE) * 1e6,
                    'fuse': fuse / (seconds * RATE) * 1e6,
                    'fuse and write': both / (seconds * RATE) * 1e6,
                }
            )
    return result


def run(rig: Rig, bag: Path, folder: Path, config: PipelineConfig) -> tuple[float, float, float]:
    """Return the seconds that reading took, fusing alone, and fusing and writing."""
    begin = time.perf_counter()
    recording: ImuRecording = read_imus(bag, [f'/imu{k}/data_raw' for k in range(IMUS)])
    read = time.perf_counter()
    out = Path(tempfile.mkdtemp(dir=folder)) / 'out'
    imus = list(range(IMUS))
    deque(fused_frames(Pipeline(rig, config), recording, imus), maxlen=0)
    fused = time.perf_counter()
    with fused_bag(out, 'mcap', 'base_link') as made:
        write_fused(made, fused_frames(Pipeline(rig, config), recording, imus))
    return read - begin, fused - read, time.perf_counter() - fused


def write_bags(recording: SimulatedRecording, folder: Path) -> None:
    for seconds in {seconds for _, seconds, _ in CASES}:
        count = round(seconds * RATE)
        with BagWriter(folder / f'{seconds:g}') as bag:
            messages = []
            for k, samples in enumerate(recording.raw):
                bag.add_topic(f'/imu{k}/data_raw', 'sensor_msgs/msg/Imu')
                part = samples.select(slice(0, count))
                rows = encode_imus(f'imu{k}_link', part)
                stamps = part.stamp_ns.tolist()
                messages += [(t, k, row) for t, row in zip(stamps, rows, strict=True)]
            for stamp_ns, k, row in sorted(messages, key=lambda message: message[:2]):
                bag.write(f'/imu{k}/data_raw', stamp_ns, row)


def warm_up(rig: Rig, folder: Path) -> None:
    """Compile what the cases call."""
    for _, _, settings in CASES:
        run(rig, folder / f'{SHORT_S:g}', folder, PipelineConfig(**settings))
