"""The fusion node's lines on /diagnostics."""

from collections.abc import Sequence
import time

from multiimu_ros.nodes.diagnostics import ERROR, OK, STALE, Status, WARN
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.pipeline import ImuHealth, Pipeline

SILENT_S = 0.5  # the pipeline knows an IMU is absent from the others; this is for when all are
LEVELS = {'ok': OK, 'probation': WARN, 'disabled': WARN}  # all else is an error


class FusionReport:
    """One status of the fusion, one of each IMU.

    Parameters
    ----------
    pipeline : Pipeline
        Knows states, weights and counters.
    streams : sequence of ImuInput
        Know what arrived.
    """

    def __init__(self, pipeline: Pipeline, streams: Sequence[ImuInput]) -> None:
        self._pipeline = pipeline
        self._streams = streams
        self._before = (time.monotonic(), 0)

    def statuses(self, not_finite: int) -> list[Status]:
        """Return the statuses of now.

        Parameters
        ----------
        not_finite : int
            Frames that were not published.
        """
        health = self._pipeline.health()
        pairs = zip(health, self._streams, strict=True)
        imus = [_imu_status(imu, stream) for imu, stream in pairs]
        return [self._fusion_status(imus, not_finite), *imus]

    def _fusion_status(self, imus: Sequence[Status], not_finite: int) -> Status:
        now, frames = time.monotonic(), self._pipeline.frames
        then, frames_then = self._before
        self._before = (now, frames)
        faulty = [status.component for status in imus if status.level != OK]
        level, message = OK, 'ok'
        if len(faulty) == len(imus):
            level, message = STALE, 'no IMU is usable'
        elif faulty:
            level, message = WARN, f'without {", ".join(faulty)}'
        figures = {
            'fused rate [Hz]': (frames - frames_then) / (now - then),
            'frames': frames,
            'empty scans': self._pipeline.empty_scans,
            'time jumps': self._pipeline.time_jumps,
            'not finite': not_finite,
        }
        return Status('fusion', level, message, figures)


def _imu_status(imu: ImuHealth, stream: ImuInput) -> Status:
    state = imu.state
    if state in ('ok', 'probation') and stream.silent_s() > SILENT_S:
        state = 'absent'
    level = LEVELS.get(state, ERROR)
    if not stream.received:
        level, state = STALE, f'nothing came yet on {stream.topic}'
    figures = {
        'rate [Hz]': imu.rate_hz,
        'weight': imu.weight,
        'received': stream.received,
        'malformed': stream.malformed,
        'rejected': imu.rejected,
        'gaps': imu.gaps,
    }
    return Status(imu.name, level, state, figures)
