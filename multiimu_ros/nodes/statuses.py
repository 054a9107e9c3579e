"""The fusion node's lines on /diagnostics."""

from collections.abc import Iterator, Sequence
import math
import time

from multiimu_ros.fusion.benefit import Benefit
from multiimu_ros.fusion.drift import Gap
from multiimu_ros.nodes.diagnostics import ERROR, OK, STALE, Status, WARN
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.pipeline import ImuHealth, Pipeline

NOISES = (('noise of rate', 'mdeg/s', 1e3 * math.degrees(1.0)), ('noise of force', 'mm/s^2', 1e3))
SILENT_S = 0.5  # the pipeline knows an IMU is absent from the others; this is for when all are
LEVELS = {'ok': OK, 'probation': WARN, 'disabled': WARN, 'ambiguous': WARN}  # all else is an error
# What may drift, as people say it: of one, of two that cannot be told apart; unit, factor.
QUANTITIES = {
    'rate': ('its rate is off by', 'their rates differ by', 'deg/s', math.degrees(1.0)),
    'force': ('its force is off by', 'their forces differ by', 'm/s^2', 1.0),
    'turn': ('its rate in a turn is off by', 'their rates in a turn differ by', '%', 100.0),
}


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
        names = [imu.name for imu in health]
        pairs = zip(health, self._streams, strict=True)
        imus = [_imu_status(imu, stream, names) for imu, stream in pairs]
        return [self._fusion_status(imus, not_finite), *(status for status, _ in imus)]

    def _fusion_status(self, imus: Sequence[tuple[Status, bool]], not_finite: int) -> Status:
        now, frames = time.monotonic(), self._pipeline.frames
        then, frames_then = self._before
        self._before = (now, frames)
        faulty = [status.component for status, usable in imus if not usable]
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
            **_benefit_figures(self._pipeline.benefit()),
        }
        return Status('fusion', level, message, figures)


def _benefit_figures(benefit: Benefit) -> dict[str, float]:
    """Return what rests have shown of the noise; per sample and axis."""
    figures = {}
    for k, (name, unit, factor) in enumerate(NOISES):
        for kind, noise in benefit._asdict().items():
            figures[f'{name}, {kind.replace("_", " ")} [{unit}]'] = factor * float(noise[k])
    return figures


def _imu_status(imu: ImuHealth, stream: ImuInput, names: Sequence[str]) -> tuple[Status, bool]:
    """Return the status of one IMU, and whether fusion makes use of it."""
    state = imu.state
    if state in ('ok', 'probation') and stream.silent_s() > SILENT_S:
        state = 'absent'
    level = LEVELS.get(state, ERROR)
    if state == 'excluded':
        state = f'excluded, for the others contradict its {imu.fault.reason}'
    elif state == 'ambiguous':
        state = f'the IMUs contradict each other ({imu.fault.reason}), and no majority agrees'
    if not stream.received:
        level, state = STALE, f'nothing came yet on {stream.topic}'
    usable = level == OK or imu.state == 'ambiguous'
    if level == OK and (
        advice := _advice(imu, names)
    ):  # one that drifts is still better than none
        level, state = WARN, advice
    figures = {
        'rate [Hz]': imu.rate_hz,
        'weight': imu.weight,
        'received': stream.received,
        'malformed': stream.malformed,
        'rejected': imu.rejected,
        'gaps': imu.gaps,
        'exclusions': imu.fault.exclusions,
        'chi-square beside the others': imu.fault.chi_square,
    }
    return Status(imu.name, level, state, figures | dict(_drift_figures(imu))), usable


def _drift_figures(imu: ImuHealth) -> Iterator[tuple[str, float]]:
    for name, (*_, unit, factor) in QUANTITIES.items():
        gap: Gap = getattr(imu.disagreement, name)
        yield f'{name} beside the others [{unit}]', factor * gap.value
        yield f'{name} beside the others, sigma [{unit}]', factor * gap.sigma


def _advice(imu: ImuHealth, names: Sequence[str]) -> str:
    """Say which IMUs to calibrate anew, and why; nothing if they agree."""
    reasons, suspects = [], {imu.name}
    for name, (alone, together, unit, factor) in QUANTITIES.items():
        gap: Gap = getattr(imu.disagreement, name)
        if gap.raised:
            suspects |= {names[k] for k in gap.rivals}
            how = together if gap.rivals else alone
            size = f'{factor * gap.value:.2g} {unit}'
            reasons.append(f'{how} {size}, {gap.value / gap.sigma:.0f} sigma')
    if not reasons:
        return ''
    advice = f'recalibrate {" and ".join(sorted(suspects))}: {"; ".join(reasons)}'
    return advice if len(suspects) == 1 else f'{advice}; of two nobody can say which is wrong'
