"""The fusion node's lines on /diagnostics: what `fusion/health` says, in words for people."""

from collections.abc import Iterator, Mapping, Sequence
import math
import time

from multiimu_ros.fusion.benefit import Benefit
from multiimu_ros.fusion.drift import Gap
from multiimu_ros.nodes.diagnostics import ERROR, OK, STALE, Status, WARN
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.pipeline import ImuHealth, Pipeline

NOISES = (('noise of rate', 'mdeg/s', 1e3 * math.degrees(1.0)), ('noise of force', 'mm/s^2', 1e3))
SILENT_S = 0.5  # the pipeline knows an IMU is absent from the others; this is for when all are
# All else is an error.  A suspect may be an accident of noise; it is as good as any until it is
# excluded, and to warn of it would cry wolf several times a minute.
LEVELS = {
    'ok': OK,
    'suspect': OK,
    'readmitted': OK,
    'probation': WARN,
    'disabled': WARN,
    'ambiguous': WARN,
}
# What may drift, as people say it: of one, of two that cannot be told apart; unit, factor.
QUANTITIES = {
    'rate': ('its rate is off by', 'their rates differ by', 'deg/s', math.degrees(1.0)),
    'force': ('its force is off by', 'their forces differ by', 'm/s^2', 1.0),
    'turn': ('its rate in a turn is off by', 'their rates in a turn differ by', '%', 100.0),
}


def imu_state(imu: ImuHealth, stream: ImuInput) -> tuple[str, bytes]:
    """Return the state of one IMU in a word, and its level.

    The word is that of the guard for an IMU that is heard and trusted ('ok', 'suspect',
    'readmitted', 'excluded', 'ambiguous'), else what its stream is ('absent', 'invalid', 'stuck',
    'probation', 'disabled').
    """
    state = imu.state
    if state != 'disabled' and stream.silent_s() > SILENT_S:
        state = 'absent'
    if not stream.received:
        return 'absent', STALE
    if state == 'ok':
        state = imu.fault.state
    return state, LEVELS.get(state, ERROR)


def in_use(state: str, level: bytes) -> bool:
    """Say whether fusion makes use of an IMU in this state."""
    return level == OK or state == 'ambiguous'


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
        states = [imu_state(*pair) for pair in zip(health, self._streams, strict=True)]
        rows = zip(health, self._streams, states, strict=True)
        imus = [_imu_status(imu, stream, state, names) for imu, stream, state in rows]
        return [self._fusion_status(dict(zip(names, states, strict=True)), not_finite), *imus]

    def _fusion_status(self, states: Mapping[str, tuple[str, bytes]], not_finite: int) -> Status:
        now, frames = time.monotonic(), self._pipeline.frames
        then, frames_then = self._before
        self._before = (now, frames)
        faulty = [name for name, state in states.items() if not in_use(*state)]
        disputed = [name for name, (state, _) in states.items() if state == 'ambiguous']
        level, message = OK, 'ok'
        if len(faulty) == len(states):
            level, message = STALE, 'no IMU is usable'
        elif faulty:
            level, message = WARN, f'without {", ".join(faulty)}'
        elif disputed:
            level, message = WARN, contradiction(disputed)
        figures = {
            'fused rate [Hz]': (frames - frames_then) / (now - then),
            'frames': frames,
            'empty scans': self._pipeline.empty_scans,
            'time jumps': self._pipeline.time_jumps,
            'not finite': not_finite,
            **_benefit_figures(self._pipeline.benefit()),
        }
        return Status('fusion', level, message, figures)


def contradiction(names: Sequence[str]) -> str:
    """Say which IMUs contradict each other."""
    *most, last = names
    who = f'{", ".join(most)} and {last} contradict' if most else f'{last} contradicts the others'
    return f'{who}{" each other" if most else ""}, and no majority says which is wrong'


def _benefit_figures(benefit: Benefit) -> dict[str, float]:
    """Return what rests have shown of the noise; per sample and axis."""
    figures = {}
    for k, (name, unit, factor) in enumerate(NOISES):
        for kind, noise in benefit._asdict().items():
            figures[f'{name}, {kind.replace("_", " ")} [{unit}]'] = factor * float(noise[k])
    return figures


def imu_words(imu: ImuHealth, stream: ImuInput, state: str) -> str:
    """Say in words what is the matter with an IMU in this state."""
    reason = imu.fault.reason
    if not stream.received:
        return f'nothing came yet on {stream.topic}'
    return {
        'suspect': 'ok',  # it may be an accident; the chi-squared is among the figures
        'excluded': f'excluded, for the others contradict its {reason}',
        'readmitted': f'ok; readmitted, for the others no longer contradict its {reason}',
        'ambiguous': f'the IMUs contradict each other ({reason}), and no majority agrees',
    }.get(state, state)


def _imu_status(
    imu: ImuHealth, stream: ImuInput, judged: tuple[str, bytes], names: Sequence[str]
) -> Status:
    state, level = judged
    words = imu_words(imu, stream, state)
    # One that drifts is still better than none.
    if level == OK and (advice := _advice(imu, names)):
        level, words = WARN, advice
    figures = {
        'rate [Hz]': imu.rate_hz,
        'weight': imu.weight,
        'received': stream.received,
        'malformed': stream.malformed,
        'publishers': stream.publishers,
        'rejected': imu.rejected,
        'gaps': imu.gaps,
        'exclusions': imu.fault.exclusions,
        'chi-square beside the others': imu.fault.chi_square,
    }
    return Status(imu.name, level, words, figures | dict(_drift_figures(imu)))


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
