"""What is wrong with a recording itself: samples that are missing, useless, or in degrees."""

from collections.abc import Mapping

import numpy as np

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.cleaning import CleanTrack
from multiimu_ros.samples import ImuSamples

MISSING, SATURATED, UNSOUND = 'missing samples', 'saturated samples', 'unsound samples'
WINDOW_S = 0.5  # over which a slow turn tilts gravity and a noise does not
TILT = 0.1  # [rad] in a window: more than noise, and a turn rather than a knock
DEGREES = (20.0, 120.0)  # rates in deg/s say 57 times what gravity turns; a spin adds to it


def fault_shares(track: CleanTrack, begin_ns: int, end_ns: int) -> Mapping[str, float]:
    """Return which shares of one IMU's samples are of no use, those that are not zero [%].

    Parameters
    ----------
    track : CleanTrack
        Its samples.
    begin_ns, end_ns : int
        The whole recording, of all IMUs: one that fell silent half-way lacks a half [ns].
    """
    count = len(track.samples)
    useless = track.not_finite + track.backward
    shares = {
        MISSING: _missing(track, begin_ns, end_ns),
        SATURATED: track.saturated / max(count, 1),
        UNSOUND: useless / max(count + useless, 1),
    }
    return {name: 100 * share for name, share in shares.items() if share > 0.0}


def _missing(track: CleanTrack, begin_ns: int, end_ns: int) -> float:
    """Return the share of the samples that never came, be it in holes or one by one [-].

    Jitter of the stamps makes some steps two periods and as many others none, which cancels.
    What was dropped as unsound did come.
    """
    stamps = track.samples.stamp_ns
    if len(stamps) < 2:
        return 0.0
    period = float(np.median(np.diff(stamps)))
    steps = np.diff(np.concatenate([[begin_ns], stamps, [end_ns]]))
    expected = 1.0 + float(np.round(steps / period).sum())
    came = len(stamps) + track.not_finite + track.backward
    return max(0.0, 1.0 - came / expected)


def looks_like_degrees(samples: ImuSamples) -> bool:
    """Say whether the rates turn by some 57 times what gravity turns by.

    Of half a second in which gravity tilts, gyroscopes in rad/s say as much or somewhat more.
    """
    stamps = samples.stamp_ns
    if len(stamps) < 2:
        return False
    number = (stamps - stamps[0]) // round(WINDOW_S * NANOSECONDS)
    _, first, count = np.unique(number, return_index=True, return_counts=True)
    means = [
        np.add.reduceat(values, first, axis=0) / count[:, np.newaxis]
        for values in (samples.angular_rate, samples.specific_force)
    ]
    up = means[1] / np.linalg.norm(means[1], axis=1, keepdims=True)
    tilt = np.arccos(np.clip(np.sum(up[1:] * up[:-1], axis=1), -1.0, 1.0))
    turn = WINDOW_S * np.linalg.norm(means[0][1:] + means[0][:-1], axis=1) / 2
    tilting = tilt > TILT
    if not tilting.any():
        return False
    return bool(DEGREES[0] < float(np.median(turn[tilting] / tilt[tilting])) < DEGREES[1])
