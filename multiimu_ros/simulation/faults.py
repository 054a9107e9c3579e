"""What may go wrong with an emulated board, when, and how a person says so.

`dead:3@10-15` silences IMU 3 from second 10 to 15 of the motion; without the times the fault
begins at once and stays.  `stuck` repeats the last reading for ever, `garbage` is a bus that
returns noise, `unplug` pulls the whole board off its port.  `heal:3` and `replug` end them.
"""

from dataclasses import dataclass
import re

import numpy as np

from multiimu_ros.errors import ConfigError

IMU_FAULTS = ('dead', 'stuck', 'garbage')
_ENDS = {'heal': IMU_FAULTS, 'replug': ('unplug',)}
_FORM = re.compile(r'(?P<kind>[a-z]+)(:(?P<imu>\d+))?(@(?P<start>[\d.]+)-(?P<stop>[\d.]+))?')


@dataclass(frozen=True)
class Fault:
    """One fault of IMU `imu` (of the board, if None) from `start` to `stop` [s]."""

    kind: str
    imu: int | None
    start: float
    stop: float


class FaultPlan:
    """The faults of one board, scheduled beforehand or switched on and off while it runs."""

    def __init__(self, imu_count: int) -> None:
        self._imu_count = imu_count
        self._faults: list[Fault] = []

    def command(self, text: str, now: float = 0.0) -> None:
        """Obey `kind[:imu][@start-stop]` at the instant `now` [s].

        Raises
        ------
        ConfigError
            If the command is none, or names an IMU that is not there.
        """
        kind, imu, start, stop = self._parse(text.strip())
        if kind in _ENDS:
            over = [f for f in self._faults if f.imu == imu and f.kind in _ENDS[kind]]
            for fault in over:
                if fault.start <= now < fault.stop:
                    self._faults.remove(fault)
        else:
            self._faults.append(Fault(kind, imu, now if start is None else start, stop))

    def _parse(self, text: str) -> tuple[str, int | None, float | None, float]:
        form = _FORM.fullmatch(text)
        kind = form['kind'] if form else ''
        needs_imu = kind in (*IMU_FAULTS, 'heal')
        known = needs_imu or kind in ('unplug', 'replug')
        if form is None or not known or needs_imu != (form['imu'] is not None):
            examples = '`dead:3@10-15`, `stuck:0`, `heal:0`, `unplug@20-22`'
            msg = f'`fault` must look like {examples}, got `{text}`; write it like one of them.'
            raise ConfigError(msg)
        imu = int(form['imu']) if needs_imu else None
        if imu is not None and imu >= self._imu_count:
            last = self._imu_count - 1
            msg = f'`fault` must name one of the IMUs 0 to {last}, got {imu}; choose another.'
            raise ConfigError(msg)
        start = None if form['start'] is None else _seconds(form['start'], text)
        stop = np.inf if form['stop'] is None else _seconds(form['stop'], text)
        return kind, imu, start, stop

    def kind_of(self, imu: int, now: float) -> str | None:
        """Return what is wrong with an IMU at the instant `now`; the latest fault wins."""
        for fault in reversed(self._faults):
            if fault.imu == imu and fault.start <= now < fault.stop:
                return fault.kind
        return None

    def unplugged(self, now: float) -> bool:
        """Say whether the board is off its port at the instant `now`."""
        return any(f.kind == 'unplug' and f.start <= now < f.stop for f in self._faults)


def _seconds(text: str, command: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        msg = f'`fault` must give its times in seconds, got `{command}`; write e.g. `@10-15.5`.'
        raise ConfigError(msg) from error
