"""`multiimu inspect --live`: says, while somebody records, which poses and axes are missing."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module
import math
import sys
import time
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from multiimu_ros.bags import ImuTrack
from multiimu_ros.calibration.pose_tracker import PoseTracker
from multiimu_ros.calibration.rests import Motion
from multiimu_ros.cli.clipping import ImuClipping
from multiimu_ros.cli.one_board import ALIKE, closeness
from multiimu_ros.cli.options import print_json
from multiimu_ros.cli.preflight import examine_motion, Figures, judge, judge_board, Verdict, YES
from multiimu_ros.cli.recording import unlike
from multiimu_ros.cli.verdicts import shortened, STYLES
from multiimu_ros.errors import ConfigError

LATER = ('Allan',)  # takes an hour of rest, in a recording of its own
ROUND = 4  # looks, four a second, within which each IMU is examined anew
PLAIN_S = 1.0  # between two lines where stdout is no terminal
FIRST = 'let it lie still for some seconds'


class LiveImu:
    """One IMU of the board that is being recorded."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.tracker = PoseTracker()
        self.clipping = ImuClipping()
        self.motion: Motion = self.tracker.view()
        self.figures: Figures = examine_motion(self.motion)

    def examine(self) -> None:
        """Learn what its samples so far suffice for."""
        self.figures = examine_motion(self.motion)

    def row(self) -> dict[str, Any]:
        """Return what the table shows of it."""
        rest, poses = self.figures['rest'], self.figures['poses']
        return {
            'topic': self.topic,
            'Hz': self.motion.rate_hz,
            'now': 'still' if self.motion.resting else 'moving',
            'rest [s]': rest['total_s'],
            'poses': poses['distinct'],
            'waved [s]': self.figures['waving']['time_s'],
        }


class LiveBoard:
    """All topics that are watched, and what they still lack as one board."""

    def __init__(self) -> None:
        self.imus: dict[str, LiveImu] = {}
        self.silences: list[str] = []
        self.strangers: list[str] = []
        self._looks = 0

    def hear(self, track: ImuTrack) -> None:
        """Take the newest samples of a topic."""
        imu = self.imus.setdefault(track.topic, LiveImu(track.topic))
        imu.tracker.push(track.samples)
        imu.clipping.push(track.samples)

    def look(self, silences: Sequence[str]) -> bool:
        """Bring everything up to date; say whether nothing is missing any more."""
        self.silences = list(silences)
        for k, imu in enumerate(self.imus.values()):
            imu.motion = imu.tracker.view()
            if k % ROUND == self._looks % ROUND:
                imu.examine()
        self._looks += 1
        verdicts = self.verdicts()
        if self._looks % ROUND == 0 or self._complete(verdicts):
            self.strangers = self._find_strangers(verdicts)
        return self._complete(verdicts)

    def finish(self) -> None:
        """Examine every IMU once more, at the end."""
        for imu in self.imus.values():
            imu.examine()
        self.strangers = self._find_strangers(self.verdicts())

    @property
    def complete(self) -> bool:
        """Whether nothing is missing any more."""
        return self._complete(self.verdicts())

    def _complete(self, verdicts: Sequence[Verdict]) -> bool:
        enough = bool(verdicts) and all(verdict.answer == YES for verdict in verdicts)
        return enough and not self.silences and not self.strangers and not self.wrong_units()

    def verdicts(self) -> list[Verdict]:
        """Return what the recording so far suffices for, on the IMU that lacks most."""
        judged = {
            topic: [
                verdict
                for verdict in judge(imu.figures, len(self.imus) - 1, imu.clipping.share)
                if verdict.task not in LATER
            ]
            for topic, imu in self.imus.items()
        }
        return judge_board(judged)

    def _find_strangers(self, verdicts: Sequence[Verdict]) -> list[str]:
        """Return a sentence for each IMU that does not move as the first one, once it can tell."""
        answers = {verdict.task: verdict.answer for verdict in verdicts}
        if answers.get('lever arms') != YES:
            return []
        first, *others = self.imus.values()
        scores = {imu.topic: closeness(first.motion, imu.motion) for imu in others}
        return [
            f'`{topic}`: {unlike(first.topic, score)}'
            for topic, score in scores.items()
            if score < ALIKE
        ]

    def wrong_units(self) -> list[str]:
        """Return a sentence for each IMU whose units are not SI."""
        return [
            f'`{imu.topic}`: {complaint}'
            for imu in self.imus.values()
            for complaint in imu.figures['units']['complaints']
        ]

    def missing(self) -> list[str]:
        """Return what to do next, the first first."""
        todo = [text for verdict in self.verdicts() for text in shortened(verdict.instead)]
        if not any(len(imu.motion.rests) for imu in self.imus.values()):
            todo = [FIRST, *todo] if self.imus else []
        told = [*self.silences, *self.wrong_units(), *self.strangers, *todo]
        return list(dict.fromkeys(told))

    def report(self) -> dict[str, Any]:
        """Return everything, for machines."""
        return {
            'complete': self.complete,
            'imus': [imu.row() | imu.figures for imu in self.imus.values()],
            'suffices': [verdict._asdict() for verdict in self.verdicts()],
            'missing': self.missing(),
        }


class TerminalView:
    """Redraws a table and the list of what is missing."""

    def __init__(self, board: LiveBoard, live: Live) -> None:
        self._board, self._live = board, live
        self.hear = board.hear

    def look(self, silences: Sequence[str]) -> bool:
        """Bring the board up to date and draw it."""
        done = self._board.look(silences)
        self._live.update(draw(self._board), refresh=True)
        return done


class PlainView:
    """Prints a line when something has changed, at most one a second."""

    def __init__(self, board: LiveBoard, *, silent: bool) -> None:
        self._board, self._silent = board, silent
        self._said, self._when = '', -math.inf
        self.hear = board.hear

    def look(self, silences: Sequence[str]) -> bool:
        """Bring the board up to date and say what is new."""
        done = self._board.look(silences)
        line = '' if self._silent else summary(self._board)
        if line != self._said and time.monotonic() > self._when + PLAIN_S:
            self._said, self._when = line, time.monotonic()
            sys.stdout.write(f'{line}\n')
            sys.stdout.flush()
        return done


def summary(board: LiveBoard) -> str:
    """Return one line: how many poses, and the first thing that is missing."""
    poses = min((imu.figures['poses']['distinct'] for imu in board.imus.values()), default=0)
    missing = board.missing()
    next_ = missing[0] if missing else 'nothing is missing' if board.imus else 'waiting for topics'
    more = f' (and {len(missing) - 1} more)' if len(missing) > 1 else ''
    return f'{len(board.imus)} IMUs, {poses} poses; {next_}{more}'


def draw(board: LiveBoard) -> RenderableType:
    """Return the table of IMUs, the verdicts, and what is missing."""
    rows = [imu.row() for imu in board.imus.values()]
    table = Table()
    for name in rows[0] if rows else ():
        table.add_column(Text(name), justify='left' if name in ('topic', 'now') else 'right')
    for row in rows:
        table.add_row(*map(Text, _cells(row)))
    answers = Text('  ').join(
        Text(verdict.task, STYLES[verdict.answer]) for verdict in board.verdicts()
    )
    missing = [Text.assemble(('- ', 'bold'), text) for text in board.missing()]
    heading = 'Still missing:' if missing else 'Nothing is missing.' if rows else 'Listening ...'
    parts: list[RenderableType] = [table, answers] if rows else []
    return Group(*parts, Text(heading, 'bold'), *missing)


def _cells(row: Mapping[str, Any]) -> Iterator[str]:
    for value in row.values():
        yield f'{value:.1f}' if isinstance(value, float) else str(value)


@contextmanager
def _view(board: LiveBoard, *, as_json: bool) -> Iterator[TerminalView | PlainView]:
    console = Console()
    if as_json or not console.is_terminal:
        yield PlainView(board, silent=as_json)
        return
    with Live(console=console, auto_refresh=False) as live:
        yield TerminalView(board, live)
        live.update(draw(board), refresh=True)


def watch(topics: Sequence[str], seconds: float | None, *, as_json: bool = False) -> int:
    """Watch a recording until nothing is missing, time is over, or Ctrl-C.

    Parameters
    ----------
    topics : sequence of str
        What to watch; without any, every Imu topic named `data_raw`.
    seconds : float or None
        When to end at the latest [s].
    as_json : bool
        Print one report at the end, and nothing before.

    Returns
    -------
    int
        Exit code: 0 when nothing is missing, else 1.
    """
    try:
        listener: Any = import_module('multiimu_ros.nodes.inspect')
    except ModuleNotFoundError as error:
        msg = (
            f'`inspect --live` must have ROS 2, but `{error.name}` is missing; '
            'source its setup file.'
        )
        raise ConfigError(msg) from error
    board = LiveBoard()
    with _view(board, as_json=as_json) as view:
        failed = listener.listen(view, topics, seconds)
        board.finish()
    if failed:  # the reason was told
        return 1
    if as_json:
        print_json(board.report())
    elif isinstance(view, PlainView):
        ending = [f'still missing: {text}' for text in board.missing() or ['any Imu topic']]
        sys.stdout.write('\n'.join(['complete'] if board.complete else ending) + '\n')
    return 0 if board.complete else 1
