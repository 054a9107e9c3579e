"""Time the package on this machine: `python -m benchmarks --help`."""

import argparse
from collections.abc import Sequence
import json
from pathlib import Path
import sys
import tempfile

from rich.console import Console
from rich.table import Table

from benchmarks import frame, live, offline, startup
from multiimu_ros.errors import MultiImuError

PARTS = ('frame', 'offline', 'live', 'startup')


def parse() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='multiimu bench', description=__doc__)
    parser.add_argument('--only', choices=PARTS, action='append', help='one part; may be repeated')
    parser.add_argument('--load', type=float, help='load test: seconds for each arrangement')
    parser.add_argument('--rate', type=float, action='append', help='scans per second, live part')
    parser.add_argument('--arrangement', choices=live.ARRANGEMENTS, action='append')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    return parser.parse_args()


def show(console: Console, title: str, rows: Sequence[dict[str, object]]) -> None:
    table = Table(title=title, title_justify='left')
    for name in rows[0]:
        table.add_column(name, justify='left' if isinstance(rows[0][name], str) else 'right')
    for row in rows:
        table.add_row(*(f'{x:.3g}' if isinstance(x, float) else str(x) for x in row.values()))
    console.print(table)


def main() -> int:
    options = parse()
    console = Console(stderr=options.json)
    console.width = max(console.width, 110)
    loaded = options.load is not None or options.rate or options.arrangement
    parts = options.only or (['live'] if loaded else PARTS)
    result = {}
    if 'frame' in parts:
        with console.status('timing fused frames'):
            result['frame'] = frame.rows()
        show(console, 'Microseconds per fused frame, medians of five', result['frame'])
    if 'offline' in parts:
        with console.status('fusing a bag of 8 x 1000 Hz'):
            result['offline'] = offline.rows()
        show(console, '`multiimu fuse` on a bag of 8 x 1000 Hz', result['offline'])
    if 'live' in parts:
        rates = options.rate or [200.0, 400.0]
        plan = [(a, rate) for a in options.arrangement or live.ARRANGEMENTS for rate in rates]
        result['live'] = []
        for arrangement, rate in plan:
            with (
                console.status(f'{arrangement} at 8 x {rate:g} Hz'),
                tempfile.TemporaryDirectory() as folder,
            ):
                result['live'].append(
                    live.run(arrangement, rate, options.load or 10.0, Path(folder))
                )
        title = 'Live: latency and one plain hop, p50 / p99 (ms); CPU (% of a core); late (ms)'
        show(console, title, [live.cells(row) for row in result['live']])
    if 'startup' in parts:
        with console.status('timing start-up'):
            result['startup'] = startup.rows()
        show(console, 'Seconds to start, medians of three', result['startup'])
    if options.json:
        print(json.dumps(result, indent=2))
    return 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except MultiImuError as error:
        sys.exit(str(error))
