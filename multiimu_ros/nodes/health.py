"""What fusion thinks of its IMUs, on `fusion/health`, for programs to act on.

A diagnostic_msgs/DiagnosticArray, five times a second and at once when an IMU leaves the fused
set or returns to it; nothing while nobody subscribes.  Its stamp is that of the last fused
measurement, and 0 before the first.  The first status is the array's, the others are the IMUs' in
the order of the rig; each is named after its IMU, and `hardware_id` is the rig's name.

    array              level OK; WARN without some IMU or where IMUs contradict each other;
                       STALE without all
    imus [-]           of the rig
    imus_in_use [-]    of them
    without            names of the others, a blank between them; left out where all are in use
    angular_rate_fused_noise [rad/s]    standard deviation per sample and axis, as rests show it
    angular_rate_best_single [rad/s]    of the quietest IMU
    angular_rate_ideal [rad/s]          1 / sqrt(sum 1 / R), were the noises independent
    angular_rate_gain [-]               best single / fused
    specific_force_... [m/s^2], [-]     the same four of the force

    imu<k>             level OK while nothing is wrong, WARN where somebody may want to know (on
                       probation, disabled, ambiguous), ERROR at a fault, STALE before the first
                       message
    state              ok, suspect, excluded, readmitted, ambiguous, absent, invalid, stuck,
                       probation or disabled
    reason             of that state, as `angular rate: bias`; left out where there is none
    chi_square [-]     the largest statistic of the guard now: suspect above 20, excluded above 40
    since [s]          how long the state has lasted
    exclusions [-]     how often the guard has left it out
    weight [-]         share of the fused rate

What is not known (the noise before the first rest, chi-squared without a second IMU) is left out.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.node import Node

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.fused_frame import FusedFrame
from multiimu_ros.fusion.benefit import Benefit
from multiimu_ros.nodes.diagnostics import OK, STALE, Status, WARN
from multiimu_ros.nodes.inputs import ImuInput
from multiimu_ros.nodes.outputs import Output
from multiimu_ros.nodes.statuses import contradiction, imu_state, imu_words, in_use
from multiimu_ros.pipeline import ImuHealth, Pipeline

TRIADS = (('angular_rate', 'rad/s'), ('specific_force', 'm/s^2'))
GUARDED = ('excluded', 'readmitted', 'ambiguous')  # the guard says why
REASONS = {
    'absent': 'no reading comes',
    'invalid': 'readings are not finite',
    'stuck': 'readings do not change',
    'probation': 'it came back a moment ago',
    'disabled': 'by hand',
}


class HealthReport:
    """The statuses of `fusion/health`.

    Parameters
    ----------
    pipeline : Pipeline
        Knows what the guard thinks, and the noise.
    streams : sequence of ImuInput
        Know what arrived.

    Attributes
    ----------
    states : list of str
        State of each IMU, as of the last statuses.
    used : list of bool
        Whether it should have a part in the fused value.
    """

    def __init__(self, pipeline: Pipeline, streams: Sequence[ImuInput]) -> None:
        self._pipeline, self._streams = pipeline, streams
        self.states = [''] * len(streams)
        self.used = [False] * len(streams)
        self._begun_ns = [0] * len(streams)

    def statuses(self, stamp_ns: int) -> list[Status]:
        """Return the statuses as of the last fused measurement [ns]; 0 if there was none."""
        health = self._pipeline.health()
        judged = [imu_state(*pair) for pair in zip(health, self._streams, strict=True)]
        for k, (state, _) in enumerate(judged):
            if state != self.states[k] or not 0 < self._begun_ns[k] <= stamp_ns:
                self.states[k], self._begun_ns[k] = state, stamp_ns
        self.used = [in_use(*state) for state in judged]
        ages = [self._age_s(begun_ns, stamp_ns) for begun_ns in self._begun_ns]
        rows = zip(health, self._streams, judged, ages, strict=True)
        imus = [_imu_status(*row) for row in rows]
        return [self._array_status(health, judged), *imus]

    @staticmethod
    def _age_s(begun_ns: int, stamp_ns: int) -> float:
        return (stamp_ns - begun_ns) / NANOSECONDS if begun_ns else float('nan')

    def _array_status(
        self, health: Sequence[ImuHealth], judged: Sequence[tuple[str, bytes]]
    ) -> Status:
        pairs = list(zip(health, judged, strict=True))
        missing = {imu.name: _reason(imu, state[0]) for imu, state in pairs if not in_use(*state)}
        disputed = [imu.name for imu, (state, _) in pairs if state == 'ambiguous']
        count, used = len(health), len(health) - len(missing)
        compared = any(isfinite(imu.fault.chi_square) for imu in health)
        level, message = OK, f'{used} of {count} IMUs agree'
        if not used:
            level, message = STALE, 'no IMU is usable'
        elif missing:
            reasons = '; '.join(f'{name}: {reason}' for name, reason in missing.items())
            level, message = WARN, f'without {reasons}'
        elif disputed:
            level, message = WARN, contradiction(disputed)
        elif not compared:
            message = f'{used} of {count} IMUs are in use, and not compared'
        figures: dict[str, object] = {'imus [-]': count, 'imus_in_use [-]': used}
        if missing:
            figures['without'] = ' '.join(missing)
        return Status('array', level, message, figures | dict(_gains(self._pipeline.benefit())))


def _gains(benefit: Benefit) -> Iterator[tuple[str, float]]:
    for k, (triad, unit) in enumerate(TRIADS):
        yield f'{triad}_fused_noise [{unit}]', float(benefit.fused_noise[k])
        yield f'{triad}_best_single [{unit}]', float(benefit.best_single[k])
        yield f'{triad}_ideal [{unit}]', float(benefit.ideal[k])
        yield f'{triad}_gain [-]', float(benefit.best_single[k] / benefit.fused_noise[k])


def _reason(imu: ImuHealth, state: str) -> str:
    return imu.fault.reason if state in GUARDED else REASONS.get(state, '')


def _imu_status(
    imu: ImuHealth, stream: ImuInput, judged: tuple[str, bytes], since_s: float
) -> Status:
    state, level = judged
    if state in ('excluded', 'readmitted'):
        since_s = imu.fault.since_s
    elif state == 'absent':  # where all are, no stamp goes on
        since_s = max(stream.silent_s(), since_s)  # in this order: the latter may be NaN
    figures: dict[str, object] = {
        'state': state,
        'reason': _reason(imu, state),
        'chi_square [-]': imu.fault.chi_square,
        'since [s]': since_s,
        'exclusions [-]': imu.fault.exclusions,
        'weight [-]': imu.weight,
    }
    return Status(imu.name, level, imu_words(imu, stream, state), figures)


class HealthOutput:
    """Publish `fusion/health`.

    Parameters
    ----------
    node : Node
        In whose namespace.
    rig_name : str
        Of the rig.
    report : HealthReport
        What to publish.
    """

    def __init__(self, node: Node, rig_name: str, report: HealthReport) -> None:
        self._rig_name, self._report = rig_name, report
        self._output = Output(node, DiagnosticArray, 'fusion/health')
        self._stamp_ns = 0

    def note(self, frame: FusedFrame) -> None:
        """Take a fused frame; publish if its weights go with a change of states."""
        self._stamp_ns = frame.stamp_ns
        if not self._output.wanted or (frame.weights > 0.0).tolist() == self._report.used:
            return
        before = list(self._report.states)
        statuses = self._report.statuses(self._stamp_ns)
        if self._report.states != before:  # one missing reading is no news
            self._publish(statuses)

    def look(self) -> None:
        """Publish, if somebody wants it; called five times a second."""
        statuses = self._report.statuses(self._stamp_ns)
        if self._output.wanted:
            self._publish(statuses)

    def _publish(self, statuses: Sequence[Status]) -> None:
        msg = DiagnosticArray()
        msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(self._stamp_ns, NANOSECONDS)
        msg.status = [
            DiagnosticStatus(
                level=status.level,
                name=status.component,
                message=status.message,
                hardware_id=self._rig_name,
                values=list(_values(status.figures)),
            )
            for status in statuses
        ]
        self._output.send(msg)


def _values(figures: Mapping[str, object]) -> Iterator[KeyValue]:
    """Yield what is known."""
    for key, value in figures.items():
        if value == '' or (isinstance(value, float) and not isfinite(value)):
            continue
        yield KeyValue(key=key, value=f'{value:.6g}' if isinstance(value, float) else str(value))
