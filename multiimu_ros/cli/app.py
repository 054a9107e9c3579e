"""`multiimu`: finds the verb, runs it, and turns errors into one sentence and an exit code.

Verbs are imported when they are called, so that `multiimu --help` does not wait for numpy, numba
or rclpy; a verb whose file is not installed is not listed.
"""

from importlib import import_module
from importlib.util import find_spec
import os
import sys
from typing import Any

import typer
from typer.core import TyperGroup

from multiimu_ros.errors import MultiImuError

VERBS = {
    'demo': 'Eight emulated IMUs become one, live, with a table of what that gains.',
    'inspect': 'What a bag holds and what it suffices for; `--live` while recording.',
    'calibrate': 'One recording becomes a whole rig file: intrinsics, poses, clocks, with sigmas.',
    'register': 'Rotations, lever arms, clocks alone: from a bag, tracker, pointer or drawing.',
    'allan': 'The noise of IMUs at rest, into the rig file.',
    'fuse': 'Turn a bag of raw IMU topics into one IMU and an odometry, without ROS.',
    'emulator': 'A virtual serial port that speaks the protocol of the firmware.',
    'experiments': 'The tables and figures of the sources, rerun in simulation beside the print.',
    'bench': 'Time the filters and the nodes on this machine.',
    'doctor': 'Say why nothing arrives in a running graph.',
}
NODES = {
    'driver': 'Serial port in, `imu<k>/data_raw` out.',
    'calibration': '`imu<k>/data_raw` in, `imu<k>/data_calibrated` out.',
    'registration': '`imu<k>/data_calibrated` in, `imu<k>/data_registered` out.',
    'fusion': '`imu<k>/data_registered` in, `imu/data` and `odom` out.',
    'pipeline': 'All of these in one process.',
    'record': 'Topics into a bag.',
    'play': 'A bag onto its topics, with the original spacing.',
}
AS_GIVEN: dict[Any, Any] = {
    'ignore_unknown_options': True,
    'allow_extra_args': True,
    'help_option_names': [],
}


def _module(verb: str) -> str:
    return f'multiimu_ros.{"nodes" if verb in NODES else "cli"}.{verb}'


def _stub(verb: str) -> typer.Typer:
    """Return what the list of verbs shows; for a node, it also runs it."""
    stub = typer.Typer()

    @stub.command(verb, help={**VERBS, **NODES}[verb], context_settings=AS_GIVEN)
    def call(ctx: typer.Context) -> None:
        sys.argv = [verb, *ctx.args]  # the node's main reads them, as `ros2 run` gives them
        raise SystemExit(import_module(_module(verb)).main())

    return stub


class _LazyGroup(TyperGroup):
    """Lists verbs by name and imports the one that is called."""

    def list_commands(self, ctx: typer.Context) -> list[str]:  # type: ignore[override]  # noqa: ARG002
        return [verb for verb in (*VERBS, *NODES) if find_spec(_module(verb))]

    def get_command(self, ctx: typer.Context, name: str) -> Any:  # type: ignore[override]
        if name not in self.list_commands(ctx):
            return None
        return typer.main.get_command(_stub(name))

    def resolve_command(self, ctx: typer.Context, args: list[str]) -> Any:  # type: ignore[override]
        name, command, rest = super().resolve_command(ctx, args)
        if name in VERBS:
            command = typer.main.get_command(import_module(_module(name)).app)
        return name, command, rest


app = typer.Typer(
    cls=_LazyGroup, pretty_exceptions_enable=False, no_args_is_help=True, add_completion=False
)


@app.callback(epilog='Example: `multiimu fuse walk/ --rig ring8.yaml -o fused/`')
def _root() -> None:
    """Many cheap IMUs on one rigid body become one good IMU and an odometry."""


# Matrices are small here: threads of the linear algebra would only wait for each other, and on two
# cores make a calibration five times slower.  It looks at these once, when numpy is imported.
ONE_THREAD = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')


def main() -> None:
    """Run the command line; an error of the user's is one sentence on stderr and exit code 1."""
    for name in ONE_THREAD:
        os.environ.setdefault(name, '1')
    try:
        app()
    except MultiImuError as error:
        sys.stderr.write(f'{error}\n')
        raise SystemExit(1) from error
