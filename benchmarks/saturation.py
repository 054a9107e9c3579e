"""Gyroscopes of a real 8-IMU board clipped where they were not, and bridged by its accelerometers.

Run: OPENBLAS_NUM_THREADS=1 python -m benchmarks.saturation [exp_3 exp_4] [--limit 500] [--drawn]

The recordings of KTH turn the board by hand at up to 2000 deg/s.  Each gyroscope axis is clipped
at `--limit`, so that its own reading is the truth: the weighted mean of the eight.  Gaps in which
one of them reached its real limit do not count.  Prints one line of JSON per recording and limit:
rms error [rad/s] of the directions that nobody measured, bridged, by integrating the array's
angular acceleration alone, and held at the last value; then the normalised error squared, of the
whole rate (nees) and of those directions.
"""

import argparse
import json
from pathlib import Path
import sys
from typing import NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

import kth

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fusion.array_acceleration import array_acceleration
from multiimu_ros.fusion.rig_model import lever_arm_variance, rig_model
from multiimu_ros.fusion.saturation import bridge_rate, learn_walk, saturated, start_bridge
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig_calibration.calibrate import calibrate_rig

REAL_LIMIT = np.deg2rad(1998.0)
LASTING = 0.2  # [s] an error of scale or lever arm keeps its sign, in a turn of 5 rad/s or more
ACCELERATION_SIGMA = np.full(3, 1000.0)  # [rad/s^2] the board in a hand
FORCE_LIMIT = 32767 * kth.FORCE
STAMP_SIGMA = 1e-3 / np.sqrt(12.0)  # [s] each sensor samples by its own clock of 1 kHz
UNKNOWN = np.full(3, np.inf)


class Array(NamedTuple):
    """A recording, raw, and the rig that goes with it."""

    seconds: np.ndarray  # (N,)
    raw: np.ndarray  # (N, K, 6)
    A: np.ndarray  # (K, 6, 6), c (K, 6): raw to base frame
    c: np.ndarray
    model: object
    arm_variance: np.ndarray  # (K, 3)

    @property
    def to_sensor(self):
        """Return [A | c] (K, 6, 7) from the base frame back to raw readings."""
        back = np.linalg.inv(self.A)
        offset = -np.einsum('krc,kc->kr', back, self.c)
        return np.concatenate([back, offset[:, :, None]], axis=2)

    def in_base(self, raw):
        """Return (..., K, 6) calibrated readings in the base frame."""
        return np.einsum('krc,...kc->...kr', self.A, raw) + self.c


def load(name, drawn):
    """Return a recording with its rig, calibrated on itself or as drawn."""
    samples = kth.load(name)
    rig = kth.rig(samples)
    if not drawn:
        rig = calibrate_rig(rig, samples).after
    maps = [affine(imu.intrinsics) for imu in rig.imus]
    turns = [mounting(imu)[0] for imu in rig.imus]
    raw = [np.hstack([track.angular_rate, track.specific_force]) for track in samples]
    return Array(
        (samples[0].stamp_ns - samples[0].stamp_ns[0]) * 1e-9,
        np.stack(raw, axis=1),
        np.stack([turn @ A for turn, (A, _) in zip(turns, maps, strict=True)]),
        np.stack([turn @ c for turn, (_, c) in zip(turns, maps, strict=True)]),
        rig_model(rig),
        lever_arm_variance(rig),
    )


def variances(array, values, before, rate, dt):
    """Return R (K, 6) of one scan, where what lasts counts for as long as it lasts."""
    model = array.model
    motion = np.concatenate([rate, values[:, 3:].mean(axis=0)]) ** 2
    lasting = model.bias_variance + model.scale_variance @ motion
    lasting[:, 3:] += (rate @ rate) ** 2 * array.arm_variance
    stamps = (STAMP_SIGMA / dt * (values - before)) ** 2
    return model.density**2 / dt + stamps + lasting * max(LASTING / dt, 1.0)


def bridge(array, limit):
    """Return the gaps that clipping makes: lists of rows of one scan each."""
    clipped = array.raw.copy()
    clipped[:, :, :3] = np.clip(clipped[:, :, :3], -limit, limit)
    readings, truths = array.in_base(clipped), array.in_base(array.raw)
    over = (np.abs(array.raw[:, :, :3]) >= 0.998 * REAL_LIMIT).any(axis=(1, 2))
    limits = np.full(array.raw.shape[1:], np.inf)
    limits[:, :3], limits[:, 3:] = limit, FORCE_LIMIT
    at_limit, to_sensor = np.zeros(limits.shape), array.to_sensor
    arms, gaps, bridging = array.model.lever_arms_b, [], False
    rate, walk, last, fresh = np.zeros(3), np.zeros(2), np.zeros(6), False
    for n in range(1, len(readings)):
        z, dt = readings[n], array.seconds[n] - array.seconds[n - 1]
        R = variances(array, z, readings[n - 1], rate, dt)
        weights = 1.0 / R[:, :3] / (1.0 / R[:, :3]).sum(axis=0)
        saturated(z, to_sensor, limits, at_limit)
        R[at_limit[:, 3:].any(axis=1), 3:] = np.inf
        found = at_limit[:, :3].any()
        if not found and not bridging:
            rate, variance = (weights * z[:, :3]).sum(axis=0), 1.0 / (1.0 / R[:, :3]).sum(axis=0)
            a, P_a = array_acceleration(z[:, 3:], R[:, 3:], arms, rate, np.zeros(3), UNKNOWN)
            now = np.concatenate([rate, a])
            if fresh:
                noise = 2.0 * variance + 0.5 * dt**2 * np.diag(P_a)
                learn_walk(walk, last, now, noise, dt)
            last, fresh = now, True
            continue
        fresh = False
        if not bridging:
            x, P = start_bridge(rate, variance, a, P_a)
            bridging, held, alone, slope, rows = True, rate, rate, a, []
        told = (z[:, :3], R[:, :3], at_limit, to_sensor, z[:, 3:], R[:, 3:], arms)
        before = slope
        x, P = bridge_rate(x, P, dt, ACCELERATION_SIGMA, walk, *told)
        rate = x[:3]
        slope, _ = array_acceleration(
            z[:, 3:], R[:, 3:], arms, alone + dt * before, np.zeros(3), UNKNOWN
        )
        truth = (weights * truths[n, :, :3]).sum(axis=0)
        blind = at_limit[:, :3].all(axis=0)  # mounted along the base axes, more or less
        alone = np.where(blind, alone + 0.5 * dt * (before + slope), rate)
        rows.append((dt, over[n], truth, x[:3], P[:3, :3], blind, held, alone))
        if not found:
            gaps.append(rows)
            bridging, variance, a, P_a = False, np.diag(P)[:3], x[3:], P[3:, 3:]
    return gaps


def figures(gaps):
    """Return what is known of gaps in which no gyroscope reached its real limit."""
    sound = [gap for gap in gaps if not any(row[1] for row in gap)]
    rows = [row for gap in sound for row in gap[:-1]]  # the last has its gyroscopes back
    truth, found = np.array([row[2] for row in rows]), np.array([row[3] for row in rows])
    P, blind = np.array([row[4] for row in rows]), np.array([row[5] for row in rows])
    error = found - truth
    bridged = np.abs(error[blind])
    squares = bridged**2 / np.einsum('nii->ni', P)[blind]
    others = [np.array([row[k] for row in rows])[blind] - truth[blind] for k in (7, 6)]
    return {
        'gaps': len(sound),
        'longest_s': max(sum(row[0] for row in gap) for gap in sound),
        'rate_rms': np.sqrt(np.mean(truth[blind] ** 2)),
        'bridged_rms': np.sqrt(np.mean(bridged**2)),
        'bridged_quantiles_50_90_99': np.quantile(bridged, [0.5, 0.9, 0.99]),
        'integrated_rms': np.sqrt(np.mean(others[0] ** 2)),
        'held_rms': np.sqrt(np.mean(others[1] ** 2)),
        'sigma': np.median(np.sqrt(np.einsum('nii->ni', P)[blind])),
        'nees': np.einsum('ni,nij,nj->n', error, np.linalg.inv(P), error).mean() / 3.0,
        'normalised_square_mean_median': [squares.mean(), np.median(squares)],
    }


def main():
    """Clip and bridge the recordings named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('names', nargs='*', default=['exp_3', 'exp_4'])
    parser.add_argument('--limit', type=float, action='append', help='[deg/s]; may be repeated')
    parser.add_argument('--drawn', action='store_true', help='the rig as drawn, not calibrated')
    options = parser.parse_args()
    for name in options.names:
        array = load(name, options.drawn)
        for limit in options.limit or [250.0, 500.0, 1000.0]:
            line = figures(bridge(array, np.deg2rad(limit)))
            rounded = {key: np.round(value, 3).tolist() for key, value in line.items()}
            print(json.dumps({'recording': name, 'limit': limit} | rounded), flush=True)


if __name__ == '__main__':
    main()
