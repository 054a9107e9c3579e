"""What a board's counters mean, as lines of /diagnostics."""

from collections import Counter
from typing import Any

from multiimu_ros.nodes.diagnostics import ERROR, OK, Status, WARN
from multiimu_ros.transport.serial_port import SerialTransport
from multiimu_ros.wire.board import Board
from multiimu_ros.wire.packets import MODELS, PROTOCOL

WINDOW_S = 0.9
SILENT_S = 0.5  # a fault must be named within a second
SLOW = 0.9  # of the announced rate


class RateMeter:
    """Samples per second of each IMU, over the last window; NaN before the first."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()
        self._rates: dict[int, float] = {}
        self._heard: dict[int, float] = {}
        self._since: float | None = None
        self._begin = self._now = 0.0

    def note(self, imu: int, now_s: float) -> None:
        """Count one sample."""
        self._counts[imu] += 1
        self._heard[imu] = now_s

    def look(self, now_s: float) -> None:
        """Begin a new window at `now_s` if the present one is over."""
        if self._since is None:
            self._begin = self._since = now_s
        self._now = now_s
        elapsed = now_s - self._since
        if elapsed >= WINDOW_S:
            known = self._rates.keys() | self._counts.keys()
            self._rates = {imu: self._counts[imu] / elapsed for imu in known}
            self._counts.clear()
            self._since = now_s

    def silent(self, imu: int) -> bool:
        """Say whether an IMU has said nothing for `SILENT_S`, as of the last look."""
        return self._now - self._heard.get(imu, self._begin) > SILENT_S

    def rate_hz(self, imu: int) -> float:
        """Return the rate of one IMU [Hz]."""
        return self._rates.get(imu, float('nan'))


def board_status(board: Board, transport: SerialTransport) -> Status:
    """Judge the connection as a whole."""
    decoder, clock = board.decoder, board.clock
    figures: dict[str, Any] = {
        'connections': transport.connections,
        'last error': transport.last_error,
        'bytes': transport.bytes,
        'frames': decoder.frames,
        'lost scans': decoder.lost,
        'crc errors': decoder.crc_errors,
        'cobs errors': decoder.cobs_errors,
        'unknown packets': decoder.unknown,
        'held back scans': board.held_back,
        'clock skew [ppm]': clock.skew_ppm,
        'jitter [us]': clock.jitter_us,
        'clock epochs': clock.epochs,
    }
    if board.status:
        figures['board overruns'] = board.status.overruns
        figures['board bus recoveries'] = board.status.recoveries
    level, message = _judge(board, transport)
    return Status('board', level, message, figures)


def _judge(board: Board, transport: SerialTransport) -> tuple[bytes, str]:
    if not transport.connected:
        return (
            ERROR,
            f'disconnected: {transport.last_error}' if transport.last_error else 'opening',
        )
    if board.foreign_protocol is not None:
        return ERROR, (
            f'the board speaks protocol {board.foreign_protocol}, this driver {PROTOCOL}: '
            'update the older of the two'
        )
    if board.hello is None:
        return WARN, 'connected, waiting for the HELLO of the board: is the baud rate right?'
    return OK, 'connected'


def imu_statuses(board: Board, rates: RateMeter, *, connected: bool) -> list[Status]:
    """Judge each IMU that the board announced."""
    if board.hello is None:
        return []
    return [
        _imu_status(board, info.imu, MODELS.get(info.model, 'unknown'), rates, connected)
        for info in board.hello.imus
    ]


def _imu_status(board: Board, imu: int, model: str, rates: RateMeter, connected: bool) -> Status:
    assert board.hello
    rate, announced = rates.rate_hz(imu), board.hello.rate_hz
    figures: dict[str, Any] = {'model': model, 'rate [Hz]': rate, 'announced rate [Hz]': announced}
    if board.status and imu in board.status.imus:
        failures, celsius = board.status.imus[imu]
        figures |= {'failed reads': failures, 'temperature [C]': celsius}
    level, message = OK, 'ok'
    if not connected or rates.silent(imu):
        level, message = ERROR, 'silent'
    elif rate < SLOW * announced:
        level, message = WARN, 'slower than announced'
    return Status(f'imu{imu}', level, message, figures)
