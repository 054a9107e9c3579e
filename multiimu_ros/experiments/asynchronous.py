"""SCAAT (thesis 8.1) against the decentralised path, on streams that keep no common time.

The decentralised path brings all IMUs to one instant, which means to wait for their next samples
and to interpolate.  SCAAT takes each sample at its own stamp and coasts in between.  So they are
held against the truth twice: at the instant of the scan, which is past when the scan is due, and
at the moment when it is due, where the decentralised path has nothing newer than that scan.
"""

from collections.abc import Sequence

import numpy as np

from multiimu_ros.arrays import Scalars
from multiimu_ros.experiments.board import DEGREE, Progress, rms
from multiimu_ros.experiments.stream_cases import (
    BEGIN,
    CASES,
    compare,
    Compared,
    DURATION,
    LATEST,
    make_streams,
    RATE_HZ,
    RUNS,
    SCAAT,
    SYNCHRONISED,
)
from multiimu_ros.report.experiment_figures import Line, Panel, Picture
from multiimu_ros.report.experiment_page import Cell, Result, Table


def run(
    seed: int,
    progress: Progress,
    *,
    runs: int = RUNS,
    duration: float = DURATION,
    cases: Sequence[str] = tuple(CASES),
) -> Result:
    """Compare both paths in the named cases, over `runs` boards."""
    found: dict[str, list[Compared]] = {name: [] for name in cases}
    for k in range(runs):
        for n, name in enumerate(cases):
            found[name].append(compare(make_streams(CASES[name], 1000 * seed + k, duration)))
            progress((k + (n + 1) / len(cases)) / runs)
    return _result(found, seed, duration)


def _mean(found: list[Compared], where: str, path: str) -> Scalars:
    """Return the errors (2,) of a path, rms over the runs, in [mdeg/s], [mm/s^2]."""
    return 1e3 * rms(np.array([vars(one)[where][path] for one in found]), axis=0) / [DEGREE, 1.0]


def _ratios(found: dict[str, list[Compared]], where: str) -> dict[str, Scalars]:
    return {
        name: _mean(each, where, SCAAT) / _mean(each, where, SYNCHRONISED)
        for name, each in found.items()
    }


def _result(found: dict[str, list[Compared]], seed: int, duration: float) -> Result:
    runs = len(next(iter(found.values())))
    return Result(
        name='asynchronous',
        title='One measurement at a time, or all at one instant?',
        source='SCAAT, thesis 8.1.1.1, (8.1) to (8.13); no printed numbers.',
        question='Is SCAAT better than resampling and the decentralised filter where IMUs keep no '
        'common time?',
        answer=_answer(found),
        setting=(
            f'{runs} newly drawn rings of eight BMI160 (r = 8 cm), {RATE_HZ:g} Hz, '
            f'{duration - BEGIN:.1f} s of a hand in motion, calibrated by the simulated '
            'calibration. Synchronised: interpolation to one instant, then the federated filter. '
            'SCAAT: each sample at its stamp. At the scan: against the truth at the stamp of the '
            'scan, which is due when the last IMU has been heard after it. Now: against the '
            'truth at that moment. Errors are rms without their mean.'
        ),
        seed=seed,
        tables=tuple(_table(found, where) for where in ('at_scan', 'now')),
        pictures=(_picture(found),),
        differs=_differs(found),
    )


def _answer(found: dict[str, list[Compared]]) -> str:
    scan, now = _ratios(found, 'at_scan'), _ratios(found, 'now')
    wins = [name for name, ratio in scan.items() if ratio.max() < 1]
    better = [name for name, ratio in now.items() if ratio.max() < 1]
    rates = [float(ratio[0]) for ratio in scan.values()]
    live = [float(ratio[0]) for ratio in now.values()]
    return (
        f'At the scan SCAAT errs {min(rates):.2f} to {max(rates):.2f} times as much in rate as '
        f'the synchronised path, and wins in {len(wins)} of {len(scan)} cases '
        f'({", ".join(wins) or "none"}); asked for the present moment it errs '
        f'{min(live):.2f} to {max(live):.2f} times as much, and wins in {len(better)} of '
        f'{len(now)}: it does not wait for the last IMU.'
    )


def _table(found: dict[str, list[Compared]], where: str) -> Table:
    rows: list[dict[str, Cell]] = []
    for name, each in found.items():
        row: dict[str, Cell] = {'streams': name}
        ours, scaat = (_mean(each, where, path) for path in (SYNCHRONISED, SCAAT))
        for k, quantity in enumerate(('rate', 'force')):
            row[f'{quantity}, sync.'] = float(ours[k])
            row[f'{quantity}, SCAAT'] = float(scaat[k])
            if where == 'at_scan':
                row[f'{quantity}, ratio'] = float(scaat[k] / ours[k])
        if where == 'now':
            row['latest mean'] = float(_mean(each, where, LATEST)[0])
            row['age [ms]'] = 1e3 * float(np.mean([one.age for one in each]))
        rows.append(row)
    when = 'At the stamp of the scan' if where == 'at_scan' else 'At the moment the scan is due'
    return Table(title=f'{when} [mdeg/s], [mm/s²]', rows=tuple(rows))


def _picture(found: dict[str, list[Compared]]) -> Picture:
    place = np.arange(len(found), dtype=np.float64)
    panels = []
    for where, when in (('at_scan', 'at the scan'), ('now', 'now')):
        for k, quantity in enumerate(('rate [mdeg/s]', 'force [mm/s²]')):
            lines = [
                Line(label=path, x=place, y=np.array([_mean(e, where, path)[k]
                     for e in found.values()]), role=role, dots=True, joined=False)
                for path, role in ((SYNCHRONISED, 'array'), (SCAAT, 'single'))
            ]  # fmt: skip
            panels.append(
                Panel(title=f'{quantity}, {when}', x_label='', y_label='', lines=tuple(lines),
                      log_y=True, x_names=tuple(found))
            )  # fmt: skip
    return Picture(
        title='Both paths, case by case',
        caption='Upper row: at the instant that the scan is of. Lower row: at the moment it is '
        'due, some milliseconds later; the motion of these is what the synchronised path misses.',
        panels=tuple(panels),
    )


def _differs(found: dict[str, list[Compared]]) -> tuple[str, ...]:
    everyone = [one for each in found.values() for one in each]
    staggered = found['staggered 0.4 ms']
    late = _mean(staggered, 'now', SYNCHRONISED)[0] / _mean(staggered, 'at_scan', SYNCHRONISED)[0]
    times = {path: 1e6 * np.median([one.times[path] for one in everyone])
             for path in (SYNCHRONISED, SCAAT)}  # fmt: skip
    told, guessed = (found[name] for name in ('jitter 0.5 ms, told', 'false stamps 0.5 ms'))
    harm = [
        _mean(guessed, 'at_scan', path)[0] / _mean(told, 'at_scan', path)[0]
        for path in (SYNCHRONISED, SCAAT)
    ]
    return (
        (
            'The thesis prints SCAAT for the pose of a tracked target and measures nothing with '
            'it. Here the state is that of the virtual IMU: rate, angular acceleration, force and '
            'jerk; (8.12) and (8.13), which fold an attitude back, have no part.'
        ),
        (
            'Where all samples are of one instant SCAAT is the better of both at the scan, for '
            'it has a memory of some milliseconds and the synchronised path trusts each scan '
            'alone. Where they are staggered it extrapolates what the other interpolates.'
        ),
        (
            f'Asked for the present, the synchronised path errs {late:.0f} times as much as at '
            'its scan: by what a hand turns in the milliseconds that it waits. Its frame carries '
            'the stamp of the scan: who uses the stamp loses nothing, who ignores it does.'
        ),
        (
            'Jitter of the sampling costs nothing where the stamps tell of it. Jitter of the '
            f'stamps alone makes the rate {harm[0]:.1f} times (synchronised) and {harm[1]:.1f} '
            'times (SCAAT) worse: no fusion mends wrong stamps.'
        ),
        (
            f'A sample costs {times[SYNCHRONISED]:.1f} µs on the synchronised path and '
            f'{times[SCAAT]:.1f} µs in SCAAT on this machine, calls from Python included.'
        ),
    )
