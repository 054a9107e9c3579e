"""Two recordings of a real 8-IMU board, at real speed through the separate nodes.

Run: python benchmarks/kth_live.py [exp_3 exp_4 ...] [--seconds S]

Prints one line of JSON per recording: scans fused, noise gain over the median single IMU, drift
at rest, and the largest difference from `multiimu fuse`.
"""

import argparse
import json
from pathlib import Path
import sys
import tempfile

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

import kth
from live_chain import fuse, numbers, replay

from multiimu_ros.registration.transform import register
from multiimu_ros.rig import save_rig

DOMAIN = 54


def figures(name, seconds, folder):
    """Run one recording live and offline; return what the closing note quotes."""
    samples = kth.load(name)
    rig = kth.rig(samples)
    rig_file, bag = folder / 'rig.yaml', folder / name
    save_rig(rig, rig_file)
    scans = kth.write_bag(name, bag, seconds=seconds)
    fuse(bag, rig_file, folder / 'fused')
    # After the fusion of the bag: it has filled the cache of compiled kernels.
    replay(bag, rig_file, folder / 'live', domain=DOMAIN, seconds=scans / 62.5)
    difference = {}
    for topic in ('/imu/data', '/odom'):
        (stamps, live), (expected, offline) = (
            numbers(folder / where, topic) for where in ('live', 'fused')
        )
        assert np.array_equal(stamps, expected), f'{topic}: {len(stamps)} != {len(expected)}'
        difference[topic] = float(np.abs(live - offline).max())
    _, fused = numbers(folder / 'live', '/imu/data')
    _, odometry = numbers(folder / 'live', '/odom')
    mounted = [register(track, imu) for track, imu in zip(samples, rig.imus, strict=True)]
    blocks = kth.still_blocks(mounted[0].select(slice(0, scans)))
    rates, forces = ([getattr(m, f) for m in mounted] for f in ('angular_rate', 'specific_force'))
    return {
        'recording': name,
        'scans': scans,
        'lost': scans - len(fused),
        'gain_rate': kth.noise_gain(rates, fused[:, 13:16], *blocks),
        'gain_force': kth.noise_gain(forces, fused[:, 25:28], *blocks),
        'drift_10_s_m': float(np.linalg.norm(odometry[625, :3] - odometry[0, :3])),
        'live_minus_fuse': difference,
    }


def main():
    """Run the recordings named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('names', nargs='*', default=['exp_3', 'exp_4'])
    parser.add_argument('--seconds', type=float, help='only the beginning')
    arguments = parser.parse_args()
    for name in arguments.names:
        with tempfile.TemporaryDirectory() as folder:
            print(json.dumps(figures(name, arguments.seconds, Path(folder))), flush=True)


if __name__ == '__main__':
    main()
