"""Stages 1 and 3: all IMUs on the clock of the first, roughly, and after calibration finely.

Rests and moves can be found once the stamps agree to some milliseconds, which the correlation of
the raw |w| gives.  The fine fit wants rates without g-sensitivity, so it waits for the intrinsics.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import NANOSECONDS, Vectors
from multiimu_ros.calibration.cleaning import CleanTrack
from multiimu_ros.errors import CalibrationError, SyncError
from multiimu_ros.registration.correlation import Correlation, MIN_CORRELATION
from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.synchronization.delay import fit_time_map, TimeMap
from multiimu_ros.synchronization.rate_track import correlate_tracks, RateTrack

NOMINAL_LEAK = np.deg2rad(0.05) / 9.81  # [rad/s per m/s^2] of a gyroscope that was not calibrated


@dataclass(frozen=True)
class Alignment:
    """What was found of the clock of one IMU.

    Parameters
    ----------
    correlation : Correlation
        Of |w| over lags [s], relative to the recorded stamps.
    coarse : float
        Delay by the peak [s].
    fine : TimeMap or None
        What the fine fit adds to it; in seconds since the first sample of the first IMU.
    """

    correlation: Correlation
    coarse: float
    fine: TimeMap | None = None


def align_coarsely(board: Board) -> tuple[Board, tuple[Alignment | None, ...]]:
    """Bring the stamps of all IMUs onto the clock of the first, within a sample or so.

    Raises
    ------
    CalibrationError
        If an IMU does not turn with the first.
    """
    start_ns = _start(board)
    first = _track(board.tracks[0], board.tracks[0].samples.angular_rate, start_ns)
    tracks, found = [board.tracks[0]], []
    for k, track in enumerate(board.tracks[1:], start=1):
        names = board.rig.imus[k].name, board.rig.imus[0].name
        try:
            peak = correlate_tracks(first, _track(track, track.samples.angular_rate, start_ns))
        except SyncError as error:
            raise _named(names, error) from error
        if peak.correlation < MIN_CORRELATION:
            msg = (
                f'the rates of turn agree at no delay (correlation {peak.correlation:.2f}, needed '
                f'{MIN_CORRELATION}); are both on one rigid body, and was it turned?'
            )
            raise _named(names, msg)
        tracks.append(track.restamped(track.samples.stamp_ns + round(peak.offset * NANOSECONDS)))
        found.append(Alignment(peak, peak.offset))
    return Board(board.rig, tuple(tracks)), (None, *found)


def align_finely(
    board: Board, coarse: Sequence[Alignment | None]
) -> tuple[Board, tuple[Alignment | None, ...]]:
    """Fit delay and skew to the calibrated rates, and write the sum of both into the rig.

    Raises
    ------
    CalibrationError
        If the fit fails.
    """
    start_ns = _start(board)
    imus, tracks = [board.rig.imus[0]], [board.tracks[0]]
    found: list[Alignment | None] = [None]
    first = _track(tracks[0], board.calibrated(0).angular_rate, start_ns)
    for k, (imu, track) in enumerate(zip(board.rig.imus, board.tracks, strict=True)):
        rough = coarse[k]
        if rough is None:
            continue
        own = _leaking(board, k, start_ns)
        try:
            fine = fit_time_map(first, own)
        except SyncError as error:
            raise _named((imu.name, imus[0].name), error) from error
        found.append(Alignment(rough.correlation, rough.coarse, fine))
        stamps = start_ns + np.round(fine.apply(own.time) * NANOSECONDS).astype(np.int64)
        tracks.append(track.restamped(stamps))
        since = float(own.time[0] + own.time[-1]) / 2 - fine.origin
        update = {
            'time_offset': imus[0].time_offset + rough.coarse + fine.delay + fine.skew * since,
            'time_offset_sigma': float(np.hypot(fine.delay_sigma, fine.skew_sigma * since)),
        }
        imus.append(imu.model_copy(update=update))
    return Board(board.with_imus(imus).rig, tuple(tracks)), tuple(found)


def apply_offsets(board: Board) -> Board:
    """Bring the stamps onto the first one's clock by what the rig file says."""
    zero = board.rig.imus[0].time_offset
    tracks = tuple(
        track.restamped(track.samples.stamp_ns + round((imu.time_offset - zero) * NANOSECONDS))
        for imu, track in zip(board.rig.imus, board.tracks, strict=True)
    )
    return Board(board.rig, tracks)


def _start(board: Board) -> int:
    return int(board.tracks[0].samples.stamp_ns[0])


def _named(names: tuple[str, str], reason: SyncError | str) -> CalibrationError:
    return CalibrationError(f'`{names[0]}` does not fit `{names[1]}`: {reason}')


def _track(track: CleanTrack, rate: Vectors, start_ns: int) -> RateTrack:
    """Return rates (N, 3) on the clock of the first IMU, NaN where they must not be used."""
    usable = np.where(track.usable[:, np.newaxis], rate, np.nan)
    return RateTrack(track.seconds_since(start_ns), usable)


def _leaking(board: Board, k: int, start_ns: int) -> RateTrack:
    """Return the calibrated rates of one IMU, and what its g-sensitivity may have left in them."""
    samples, intrinsics = board.calibrated(k), board.rig.imus[k].intrinsics
    rates = _track(board.tracks[k], samples.angular_rate, start_ns)
    sigma = None if intrinsics is None else intrinsics.gyroscope.g_sensitivity_sigma
    known = NOMINAL_LEAK * np.ones((3, 3)) if sigma is None else np.array(sigma)
    return RateTrack(rates.time, rates.rate, samples.specific_force, known)
