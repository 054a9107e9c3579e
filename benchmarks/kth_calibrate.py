"""Calibrations of a real 8-IMU board: how long they take, and what they are worth.

Run: OPENBLAS_NUM_THREADS=1 python benchmarks/kth_calibrate.py [exp_3 exp_4 exp_1 exp_6] [--joint]

Prints one line of JSON per recording.  `residual` is |f| - g at rest, rms per IMU, with the bias
that the file states and with the drift that the fit found taken out; `spread` is the distance of
the IMUs from their mean.  With more than one recording, the first rig is applied to the others.
"""

import argparse
import json
from pathlib import Path
import sys
import time

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

import kth

from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.rig_calibration.calibrate import calibrate_rig, rest_rms, spread
from multiimu_ros.samples import ImuSamples

DELAY, SKEW = 1e-3, 50e-6  # of the k-th IMU: k times this delay, and each this skew


def figures(name, joint):
    """Calibrate one recording; return the calibration and what the closing note quotes."""
    samples, drawn = kth.load(name), kth.rig()
    begin = time.perf_counter()
    found = calibrate_rig(drawn, samples, joint=joint)
    seconds = time.perf_counter() - begin
    rests = found.intervals.duration_s
    models = [fit.fit.accelerometer for fit in found.intrinsics]
    arms = np.array([imu.extrinsics.lever_arm for imu in found.after.imus])
    off = arms - np.array([imu.extrinsics.lever_arm for imu in drawn.imus])
    return found, {
        'recording': name,
        'seconds': seconds,
        'rests': len(found.intervals),
        'residual_mm_s2': [1e3 * rest_rms(f.residual_after, rests) for f in found.intrinsics],
        'residual_without_drift_mm_s2': [
            1e3 * rest_rms(model.residual - model.drift, rests) for model in models
        ],
        'spread_mm_s2': [1e3 * found.spread_before, 1e3 * found.spread_after],
        'lever_arms_rms_mm': 1e3 * float(np.sqrt(np.mean((off - off.mean(axis=0)) ** 2))),
        'delays_us': [1e6 * imu.time_offset for imu in found.after.imus],
        'injected_delay_error_us': injected(samples, drawn),
    }


def injected(samples, drawn):
    """Return the largest error [us], over the whole recording, of delays and skews put in."""
    late = []
    for k, track in enumerate(samples):
        seconds = (track.stamp_ns - track.stamp_ns[0]) * 1e-9
        moved = track.stamp_ns + np.round(1e9 * (k * DELAY + (k > 0) * SKEW * seconds))
        late.append(ImuSamples(moved.astype(int), track.angular_rate, track.specific_force))
    found = calibrate_rig(drawn, late, stages=['time', 'intrinsics'])
    # After the time stage the tracks are on the clock of the first: the errors are what is left.
    gaps = [
        np.abs(track.samples.stamp_ns - samples[0].stamp_ns).max() for track in found.board.tracks
    ]
    return [float(gap) * 1e-3 for gap in gaps]


def repeated(first, other):
    """Return how a rig does on another recording, and how far the rotations are apart [deg]."""
    apart = [
        np.rad2deg((Rotation.from_matrix(a.R).inv() * Rotation.from_matrix(b.R)).magnitude())
        for a, b in zip(first.mountings, other.mountings, strict=True)
    ]
    board = Board(first.after, other.board.tracks)
    return {
        'rotations_apart_deg': max(apart),
        'spread_with_first_rig_mm_s2': 1e3 * spread(board, other.intervals),
    }


def main():
    """Calibrate the recordings named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('names', nargs='*', default=['exp_3', 'exp_4', 'exp_1', 'exp_6'])
    parser.add_argument('--joint', action='store_true')
    arguments = parser.parse_args()
    first = None
    for name in arguments.names:
        found, line = figures(name, arguments.joint)
        if first is not None:
            line |= repeated(first, found)
        first = first or found
        rounded = {
            key: np.round(value, 3).tolist() if not isinstance(value, str) else value
            for key, value in line.items()
        }
        print(json.dumps(rounded), flush=True)


if __name__ == '__main__':
    main()
