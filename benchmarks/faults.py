"""What the guard makes of every fault, and what it costs where there is none.

Run: python -m benchmarks.faults [--kth exp_4] [--seeds 3] [--hours 0.5] [--json]

`error` is the rms error of the faulty triad while the fault lasts, over that of the same readings
without the IMU, and from two seconds after its end on, over that of readings without a fault.
"""

import argparse
import json
from pathlib import Path
import sys

import numpy as np
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))

from fault_trials import (
    baseline,
    Case,
    errors,
    faults,
    Outcome,
    outcome,
    run,
    simulated,
    TRIADS,
    Window,
)
import kth

from multiimu_ros.rig_calibration.calibrate import calibrate_rig

COUNTS = (3, 8)
LEAD, LASTS = 30.0, 10.0  # [s] of a real recording before a fault, and of the fault
LONG = 300.0  # [s] of one recording without faults


def row(outcomes: list[Outcome]) -> dict[str, float]:
    """Return the figures of one fault over its trials."""
    delays = np.array([each.delay for each in outcomes])
    sums = np.sum([each[2:] for each in outcomes], axis=0)
    with np.errstate(divide='ignore', invalid='ignore'):  # a real recording has no error after
        during, after = np.sqrt(sums[0] / sums[1]), np.sqrt(sums[2] / sums[3])
    return {
        'delay_ms': float(1e3 * np.median(delays)),
        'longest_ms': float(1e3 * delays.max()),
        'missed': int(np.isinf(delays).sum()),
        'wrong': sum(each.wrong for each in outcomes),
        'error': float(during),
        'after': float(after),
    }


def fault_rows(cases: dict[str, list[Case]]) -> list[dict[str, object]]:
    """Return one row for each board, triad and fault."""
    result: list[dict[str, object]] = []
    for name, trials in cases.items():
        bases = [baseline(case) for case in trials]
        for triad, triad_name in enumerate(TRIADS):
            for fault in faults(triad):
                outcomes = [
                    outcome(case, fault, triad, seed, *base)
                    for seed, (case, base) in enumerate(zip(trials, bases, strict=True))
                ]
                head = {'board': name, 'triad': triad_name, 'fault': fault.name}
                result.append(head | {'gross': fault.gross} | row(outcomes))
    return result


def quiet_rows(
    hours: float, motions: tuple[str, ...] = ('hand', 'foot')
) -> list[dict[str, object]]:
    """Return false alarms and the cost of the guard without faults."""
    result: list[dict[str, object]] = []
    for count in COUNTS:
        for motion in motions:
            raised, squares, trials = 0, np.zeros((2, 2)), max(1, round(hours * 3600 / LONG))
            for seed in range(trials):
                case = simulated(count, 100 + seed, LONG, motion)
                for guard in (True, False):
                    done = run(case, case.raw, guard=guard)
                    raised += sum(done.exclusions) if guard else 0
                    error = errors(case, done, done)
                    squares[int(guard)] += (error**2).reshape(-1, 2, 3).mean(axis=(0, 2))
            cost = np.sqrt(squares[1] / squares[0]) - 1.0
            result.append(
                {
                    'board': f'{count} IMUs',
                    'motion': motion,
                    'hours': trials * LONG / 3600,
                    'alarms_per_hour': raised / (trials * LONG / 3600),
                    'cost_rate': float(cost[0]),
                    'cost_force': float(cost[1]),
                }
            )
    return result


def kth_cases(name: str) -> dict[str, list[Case]]:
    """Return parts of a real recording, calibrated on the whole; their truth is not known.

    Still poses with quick turns between, and the wildest waving, at 62.5 Hz and +-2000 deg/s.
    """
    samples = kth.load(name)
    rig = calibrate_rig(kth.rig(samples), samples).after
    cases = {}
    for part, start in (('poses', 150.0), ('waving', 550.0)):
        seconds = (samples[0].stamp_ns - samples[0].stamp_ns[0]) * 1e-9
        kept = (seconds >= start - LEAD) & (seconds < start + 2.0 * LASTS)
        window = Window(LEAD, LEAD + LASTS, LEAD + 2.0 * LASTS)
        cases[f'{name}, {part}'] = [Case(rig, [s.select(kept) for s in samples], window, None)]
    cases[name] = [Case(rig, samples, Window(0.0, 0.0, 0.0), None)]
    return cases


def show(console: Console, title: str, rows: list[dict[str, object]]) -> None:
    """Print rows as a table."""
    table = Table(title=title, title_justify='left')
    for name, value in rows[0].items():
        table.add_column(name, justify='left' if isinstance(value, str) else 'right')
    for each in rows:
        table.add_row(*(f'{x:.3g}' if isinstance(x, float) else str(x) for x in each.values()))
    console.print(table)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--kth', help='recording of a real board, as exp_4, instead')
    parser.add_argument('--seeds', type=int, default=3, help='recordings for each board')
    parser.add_argument('--hours', type=float, default=0.5, help='without faults, each; 0: none')
    parser.add_argument('--json', action='store_true', help='print the result as JSON')
    options = parser.parse_args()
    console = Console(stderr=options.json)
    console.width = max(console.width, 110)
    if options.kth:
        cases = kth_cases(options.kth)
        (whole,) = cases.pop(options.kth)
    else:
        cases = {
            f'{n} IMUs': [simulated(n, seed) for seed in range(options.seeds)] for n in COUNTS
        }
    result = {'faults': fault_rows(cases)}
    show(console, 'Faults of one IMU', result['faults'])
    if options.kth:
        done = run(whole, whole.raw)
        hours = float(done.times[-1]) / 3600
        result['quiet'] = [{'board': options.kth, 'alarms_per_hour': sum(done.exclusions) / hours}]
        show(console, 'No fault', result['quiet'])
    elif options.hours > 0:
        result['quiet'] = quiet_rows(options.hours)
        show(console, 'No fault', result['quiet'])
    if options.json:
        print(json.dumps(result, indent=2))


if __name__ == '__main__':
    main()
