"""The recordings of the 8-IMU board of KTH as samples, bags and a rig.

Carlsson, Skog, Jalden, "Self-calibration of inertial sensor arrays", IEEE Sensors J. 21(6) 2021:
MPU-9150s, 62.5 Hz, 20 still poses and then rotation by hand. The data are not ours.
"""

import numpy as np
from realdata import data_set

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.bags import BagWriter
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.rig import parse_rig
from multiimu_ros.samples import ImuSamples

IMUS = 8
JUNK = 4  # bytes: the acknowledgement of the last command
PACKET = np.dtype(
    [
        ('sync', 'u1'),
        ('seq', '>u2'),
        ('payload', 'u1'),
        ('ticks', '>u4'),
        ('counts', '>i2', (IMUS, 2, 3)),  # accelerometer, gyroscope
        ('sum', '>u2'),
    ]
)
START_NS = 1_600_000_000 * NANOSECONDS  # the recordings carry no date
FORCE = 9.80665 / 2048  # [m/s^2 per count], data sheet: 2048 LSB/g
RATE = np.deg2rad(1 / 16.4)  # [rad/s per count], data sheet: 16.4 LSB/(deg/s)
# IMUs 2, 4, 6, 8 are soldered to the other side: R_bs = [0 -1 0; -1 0 0; 0 0 -1].
FLIPPED = [np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]
# 0.2 deg/s and 33 mm/s^2 of one sample at rest, over sqrt(62.5 Hz)
TYPICAL = {'gyroscope': [4.4e-4] * 3, 'accelerometer': [4.2e-3] * 3}


def load(name):
    """Return one ImuSamples per IMU, raw at nominal scale, in each sensor's own frame."""
    content = (data_set('kth_mimu_array') / f'{name}.bin').read_bytes()[JUNK:]
    packets = np.frombuffer(content[: len(content) // PACKET.itemsize * PACKET.itemsize], PACKET)
    assert (packets['sync'] == 0xAA).all()
    assert (np.diff(packets['seq']) == 1).all()  # uint16: the wrap is 1 too
    steps = np.diff(packets['ticks'])  # uint32: the wrap is a step too
    ticks = np.concatenate([[0], np.cumsum(steps, dtype=np.int64)])
    stamp_ns = START_NS + ticks * 125 // 8  # 64 MHz
    counts = packets['counts'].astype(np.float64)
    return [
        ImuSamples(stamp_ns, RATE * counts[:, k, 1], FORCE * counts[:, k, 0]) for k in range(IMUS)
    ]


def rig(samples=None):
    """Return the board as drawn: mounting and positions; noise of a typical IMU, or as measured.

    `samples`, one ImuSamples per IMU, measure it over the first 10 s, when the board rests.
    """
    lines = (data_set('kth_mimu_array') / 'IMU_positions.csv').read_text().splitlines()[1:]
    positions = np.array([[float(x) for x in line.split(',')[1:]] for line in lines]).T
    imus = [
        {
            'name': f'imu{k}',
            'frame_id': f'imu{k}_link',
            'model': 'MPU-9150',
            'noise': {'noise_density': TYPICAL if samples is None else _at_rest(samples[k])},
            'extrinsics': {
                'rotation': [float(x) for x in FLIPPED] if k % 2 else [0.0, 0.0, 0.0, 1.0],
                'lever_arm': [float(x) for x in position],
            },
        }
        for k, position in enumerate(positions)
    ]
    head = {'name': 'mimu4444', 'gravity': 9.8184}  # Stockholm
    return parse_rig({'version': 1, 'rig': head, 'imus': imus}, 'kth')


def _at_rest(samples):
    rest = samples.select(samples.stamp_ns < samples.stamp_ns[0] + 10 * NANOSECONDS)
    root = np.sqrt(rest.rate_hz)
    return {
        'gyroscope': (rest.angular_rate.std(axis=0) / root).tolist(),
        'accelerometer': (rest.specific_force.std(axis=0) / root).tolist(),
    }


def write_bag(name, path, *, seconds=None):
    """Write the first `seconds` of a recording as a bag; return the number of scans."""
    samples = load(name)
    if seconds is not None:
        early = samples[0].stamp_ns < START_NS + round(seconds * NANOSECONDS)
        samples = [track.select(early) for track in samples]
    rows = [encode_imus(f'imu{k}_link', track) for k, track in enumerate(samples)]
    with BagWriter(path) as bag:
        for k in range(IMUS):
            bag.add_topic(f'/imu{k}/data_raw', 'sensor_msgs/msg/Imu')
        for stamp_ns, scan in zip(
            samples[0].stamp_ns.tolist(), zip(*rows, strict=True), strict=True
        ):
            for k, data in enumerate(scan):
                bag.write(f'/imu{k}/data_raw', stamp_ns, data)
    return len(samples[0])


def still_blocks(samples, seconds=2.0):
    """Return the starts and the length [samples] of the still blocks of `seconds`.

    A block is still where no axis' rate varies by more than 0.35 deg/s rms: these gyroscopes have
    0.2 deg/s of noise at 62.5 Hz, and the slowest turn by hand has some ten times that.
    """
    length = round(seconds * samples.rate_hz)
    blocks = len(samples) // length
    rate = samples.angular_rate[: blocks * length].reshape(blocks, length, 3)
    return np.flatnonzero((rate.std(axis=1) < np.deg2rad(0.35)).all(axis=1)) * length, length


def rest_noise(vectors, starts, length):
    """Return the standard deviation per axis about the means of the still blocks, (3,)."""
    blocks = np.stack([vectors[start : start + length] for start in starts])
    return np.sqrt(blocks.var(axis=1).mean(axis=0))


def noise_gain(singles, fused, starts, length):
    """Return how much quieter `fused` (N, 3) is than the median of `singles`, mean over axes."""
    noises = np.array([rest_noise(single, starts, length) for single in singles])
    return np.mean(np.median(noises, axis=0) / rest_noise(fused, starts, length))
