"""`multiimu bench`: time the filters and the nodes on this machine."""

import os
from pathlib import Path
import subprocess
import sys

import typer

import multiimu_ros
from multiimu_ros.errors import ConfigError

AS_GIVEN = {'ignore_unknown_options': True, 'allow_extra_args': True, 'help_option_names': []}

app = typer.Typer(add_completion=False)


@app.command(context_settings=AS_GIVEN)
def bench(ctx: typer.Context) -> None:
    """Run the checkout's benchmarks with the arguments as given; they are not installed."""
    root = Path(multiimu_ros.__file__).parent.parent
    if not (root / 'benchmarks' / '__main__.py').exists():
        msg = f'`bench` must run in a checkout, but `{root}` has no benchmarks/; clone it.'
        raise ConfigError(msg)
    environment = os.environ | {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    command = [sys.executable, '-m', 'benchmarks', *ctx.args]
    raise SystemExit(subprocess.run(command, cwd=root, env=environment, check=False).returncode)
