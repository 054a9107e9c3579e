"""The moving parts of a recording: calibrated readings of all IMUs at common instants."""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars
from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.synchronization.resampling import Grid, make_grid, resample, smooth, WIDTH

SMOOTHING_S = 0.02  # sigma: a hand is slower, and noise of the angular acceleration shortens arms
MOVING = 0.3  # [rad/s] below it, nothing is learnt of mounting and lever arms


@dataclass(frozen=True)
class CommonMotion:
    """Calibrated readings in the sensors' own frames.

    Parameters
    ----------
    grid : Grid
        The instants, seconds since the first sample of the first IMU.
    readings : (N, K, 6) array
        Rates and forces as resampled; NaN where unusable.
    """

    grid: Grid
    readings: Matrix

    def smoothed(self) -> Matrix:
        """Return the readings (N, K, 6), smoothed alike."""
        return smooth(self.readings, self.grid)

    def second(self) -> Scalars:
        """Return the number of the second that each instant lies in, (N,)."""
        return (self.grid.time - self.grid.start).astype(np.int64)


def common_motion(board: Board) -> CommonMotion:
    """Resample all IMUs, on one clock, at the rate of the slowest."""
    start_ns = int(board.tracks[0].samples.stamp_ns[0])
    spans = [track.seconds_since(start_ns) for track in board.tracks]
    step = max(float(np.median(np.diff(span))) for span in spans)
    begin, end = max(s[0] for s in spans), min(s[-1] for s in spans)
    grid = make_grid(begin, end, step, max(WIDTH * step, SMOOTHING_S))
    readings = np.empty((grid.count, len(spans), 6))
    for k, (track, span) in enumerate(zip(board.tracks, spans, strict=True)):
        samples = board.calibrated(k)
        values = np.hstack([samples.angular_rate, samples.specific_force])
        readings[:, k] = resample(span, values, track.usable, grid)
    return CommonMotion(grid, readings)
