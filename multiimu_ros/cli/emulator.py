"""`emulator`: a virtual serial port that speaks the protocol of the firmware, without ROS."""

from collections.abc import Iterator
from contextlib import contextmanager
import os
from pathlib import Path
import select
import signal
import sys
from threading import Event
from typing import Annotated

import typer

from multiimu_ros.errors import ConfigError, MultiImuError
from multiimu_ros.rig import load_rig, save_rig
from multiimu_ros.simulation.board import EmulatedBoard
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.device import EmulatedDevice
from multiimu_ros.simulation.faults import FaultPlan
from multiimu_ros.simulation.recording import simulate, SimulatedRecording, STAGGER, Timing
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.simulation.truth import save_truth
from multiimu_ros.simulation.virtual_port import VirtualPort

STDIN = 0

app = typer.Typer(pretty_exceptions_enable=False, add_completion=False)


@app.command(
    epilog='Example: `emulator --rig config/ring8.yaml --motion hand --link /tmp/board '
    "--fault 'dead:3@10-15'`"
)
def emulator(
    rig: Annotated[Path, typer.Option(help='Rig file: which IMUs there are, and where.')],
    motion: Annotated[
        str, typer.Option(help='static, turntable, slider, hand, foot, foot_rough or calibration.')
    ] = 'hand',
    rate: Annotated[float, typer.Option(help='Scans per second [Hz].')] = 200.0,
    duration: Annotated[float, typer.Option(help='Length of the motion [s].')] = 60.0,
    link: Annotated[
        Path | None, typer.Option(help='Path that leads to the port and survives replugging.')
    ] = None,
    print_port: Annotated[
        bool, typer.Option('--print-port', help='Print the path of the port and nothing else.')
    ] = False,
    truth: Annotated[
        Path | None, typer.Option(help='Write the true motion here (numpy archive).')
    ] = None,
    calibrated: Annotated[
        Path | None,
        typer.Option('--calibrated-rig', help='Write here what a careful calibration would find.'),
    ] = None,
    seed: Annotated[int, typer.Option(help='Draws the units, their noise and the motion.')] = 0,
    skew_ppm: Annotated[float, typer.Option(help="The board's clock is fast by this.")] = 0.0,
    dropout: Annotated[float, typer.Option(help='Share of readings that fail.')] = 0.0,
    fault: Annotated[
        list[str] | None,
        typer.Option(
            help='dead:K, stuck:K, garbage:K or unplug, with @START-STOP [s]; also on stdin, '
            'without times, where heal:K and replug end them.'
        ),
    ] = None,
) -> None:
    """Carry a board of imperfect IMUs along a motion and send what it reads to a virtual port.

    The motion begins when the port is first opened, and the program ends with it, or on Ctrl-C.
    """
    with _stop_signals() as stop:
        recording = _record(rig, motion, rate, duration, seed)
        faults = FaultPlan(len(recording.raw))
        for text in fault or []:
            faults.command(text)
        if calibrated is not None:
            save_rig(calibrated_rig(recording.rig, seed), calibrated)

        def write_truth(start_ns: int) -> None:
            if truth is not None:
                save_truth(truth, recording.truth, recording.truth_ns + start_ns)

        device = EmulatedDevice(recording, faults, skew_ppm=skew_ppm, dropout=dropout, seed=seed)
        port = VirtualPort(link)
        what = f'{recording.rig.rig.name} ({len(recording.raw)} IMUs x {rate:g} Hz), {motion}'
        typer.echo(port.path if print_port else f'{what}, {duration:g} s, on {port.path}')
        board = EmulatedBoard(device, port, faults, write_truth)
        try:
            _run(board, faults, stop)
        finally:
            port.unplug()
    if not print_port:
        typer.echo(f'{board.sent_bytes} bytes sent, {port.lost_bytes} of them lost in the port.')


def _record(rig: Path, motion: str, rate: float, duration: float, seed: int) -> SimulatedRecording:
    if not rate > 0:
        msg = f'`rate` must be a positive number of scans per second, got {rate}; pass e.g. 200.'
        raise ConfigError(msg)
    board = load_rig(rig)
    # A scan has to be over before the next one begins.
    stagger = min(STAGGER, 0.8 / (rate * len(board.imus)))
    path = trajectory(motion, duration, seed, board.rig.gravity_magnitude)
    return simulate(board, path, rate, seed=seed, timing=Timing(stagger=stagger, start_ns=0))


@contextmanager
def _stop_signals() -> Iterator[Event]:
    """Give an event that SIGINT and SIGTERM set, so that they end the program like the motion."""
    stop = Event()
    before = {
        number: signal.signal(number, lambda *_: stop.set())
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _run(board: EmulatedBoard, faults: FaultPlan, stop: Event) -> None:
    listening = True
    while not (stop.is_set() or board.finished):
        board.step()
        listening = listening and _obey(STDIN, board, faults)


def _obey(file: int, board: EmulatedBoard, faults: FaultPlan) -> bool:
    """Obey the lines of faults that wait in a file, if any; say whether more may come."""
    try:
        if not select.select([file], [], [], 0.0)[0]:
            return True
        lines = os.read(file, 4096).decode(errors='replace')
    except OSError:  # it is closed
        return False
    for line in lines.splitlines():
        try:
            faults.command(line, board.now())
        except ConfigError as error:
            typer.echo(str(error), err=True)
    return bool(lines)


def main() -> None:
    """Run the emulator; an error of the user's is one sentence on stderr and exit code 1."""
    try:
        app()
    except MultiImuError as error:
        sys.stderr.write(f'{error}\n')
        raise SystemExit(1) from error
