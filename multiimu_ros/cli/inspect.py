"""`multiimu inspect`: what a bag holds, and what is wrong with it before anything is fitted."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from multiimu_ros.arrays import NANOSECONDS, Scalars
from multiimu_ros.bags import ImuTrack, list_topics, read_imus
from multiimu_ros.bags.reader import IMU_TYPE
from multiimu_ros.cli.clipping import clipped_share, saturated
from multiimu_ros.cli.inspect_live import watch
from multiimu_ros.cli.options import AsJson, OptionsFile, print_json, print_table, split_names
from multiimu_ros.cli.recording import follow, judge_recording
from multiimu_ros.cli.verdicts import print_verdicts, waiting
from multiimu_ros.errors import ConfigError

GAP = 3.0  # periods: what the synchroniser no longer interpolates across
TURN = 40.0  # [rad/s] no gyroscope of this class reaches it: 2000 deg/s are 35 rad/s
CLOCKS_S = 3600.0  # a stamp this far from the time of recording is on another clock

# When to complain about the figures of a topic, and in which words.
COMPLAINTS: tuple[tuple[Callable[[dict[str, Any]], bool], str], ...] = (
    (lambda f: not f['count'], 'it is empty; was the driver running?'),
    (
        lambda f: f['gaps'] > 0,
        '{gaps} gaps, the longest {longest_gap_s:.3g} s; nothing fills them.',
    ),
    (lambda f: f['backward'] > 0, '{backward} stamps go back; was the clock set meanwhile?'),
    (lambda f: f['duplicate'] > 0, '{duplicate} stamps repeat; the driver sends readings twice.'),
    (lambda f: f['not_finite'] > 0, '{not_finite} readings are not finite and will be skipped.'),
    (lambda f: f['saturated_rate'] > 0, '{saturated_rate} rates end the range; turn slower.'),
    (lambda f: f['saturated_force'] > 0, '{saturated_force} forces end the range; shake less.'),
    (
        lambda f: abs(f['clock_offset_s']) > CLOCKS_S,
        'stamps are {clock_offset_s:.3g} s off the recorder; are they the clock of the board?',
    ),
    (
        lambda f: 0.5 < f['median_force'] < 1.5,
        'the median force is {median_force:.3g}: it looks like g, and must be m/s^2.',
    ),
    (
        lambda f: f['median_force'] <= 0.5,
        'the median force is {median_force:.3g} m/s^2: was gravity taken out?',
    ),
    (
        lambda f: f['median_rate'] > TURN,
        'the median rate is {median_rate:.3g}: it looks like deg/s, and must be rad/s.',
    ),
)

app = typer.Typer(add_completion=False)


@app.command(epilog='Examples: `multiimu inspect walk/ --json`; `multiimu inspect --live`')
def inspect(
    bag: Annotated[Path | None, typer.Argument(help='rosbag2 folder, .mcap or .db3 file.')] = None,
    live: Annotated[
        bool, typer.Option('--live', help='Watch a recording and say what it still lacks.')
    ] = False,
    topics: Annotated[list[str], typer.Option(help='Only these Imu topics.')] = [],  # noqa: B006
    seconds: Annotated[
        float | None, typer.Option(min=1.0, help='End `--live` after so long.')
    ] = None,
    as_json: AsJson = False,
    options: OptionsFile = None,  # noqa: ARG001 read by its callback
) -> None:
    """Say what a bag holds, what is wrong with it, and which calibrations it suffices for.

    Exit code 0 means that it was read; with `--live`, that nothing is missing any more.
    """
    if live == (bag is not None):
        got = 'both' if live else 'neither'
        msg = f'`inspect` must have either a BAG or `--live`, got {got}; pass one of them.'
        raise ConfigError(msg)
    if bag is None:
        raise SystemExit(watch(split_names(topics), seconds, as_json=as_json))
    report = preflight(bag, split_names(topics))
    if as_json:
        print_json(report)
    else:
        _print(bag, report)


def preflight(bag: Path, topics: Sequence[str] = ()) -> dict[str, Any]:
    """Return what `--json` shows of a bag; `topics` are the only Imu topics to look at."""
    present = list_topics(bag)
    wanted = [name.lstrip('/') for name in topics]
    imus = [
        topic.name
        for topic in present
        if topic.type == IMU_TYPE and (not wanted or topic.name.lstrip('/') in wanted)
    ]
    with waiting(f'Reading {bag} ...'):
        tracks = read_imus(bag, imus).tracks if imus else ()
        findings = [inspect_track(track) for track in tracks]
        motions = {track.topic: follow(track) for track in tracks}
        findings, boards = judge_recording(findings, motions)
    return {
        'topics': [{'topic': t.name, 'type': t.type, 'count': t.count} for t in present],
        'imus': findings,
        'candidates': [finding['topic'] for finding in findings if finding['looks_raw']],
        'boards': boards,
        'suffices': boards[0]['suffices'] if boards else [],
    }


def _print(bag: Path, report: Mapping[str, Any]) -> None:
    print_table(f'Topics of {bag}', report['topics'])
    print_table('IMUs', [_row(finding) for finding in report['imus']])
    print_table('How they rested and moved [s]', [_moves(finding) for finding in report['imus']])
    for finding in report['imus']:
        for complaint in finding['complaints']:
            typer.echo(f'{finding["topic"]}: {complaint}')
    for board in report['boards']:
        print_verdicts(board)
    typer.echo(
        f'To fuse or calibrate: {" ".join(report["candidates"]) or "no Imu topic looks raw"}'
    )


def inspect_track(track: ImuTrack) -> dict[str, Any]:
    """Return the figures of one Imu topic, and a sentence for everything that looks wrong."""
    samples = track.samples
    steps = np.diff(samples.stamp_ns) / NANOSECONDS
    forward = steps[steps > 0]
    period = float(np.median(forward)) if len(forward) else float('nan')
    force = np.linalg.norm(samples.specific_force, axis=1)
    finding: dict[str, Any] = {
        'topic': track.topic,
        'frame_id': track.frame_id,
        'count': len(samples),
        'rate_hz': 1 / period,
        'duration_s': float(np.ptp(samples.stamp_ns)) / NANOSECONDS if len(samples) else 0.0,
        'gaps': int((steps > GAP * period).sum()),
        'longest_gap_s': float(steps.max(initial=0.0)),
        'jitter_s': _spread(forward),
        'backward': int((steps < 0).sum()),
        'duplicate': int((steps == 0).sum()),
        'not_finite': int((~np.isfinite(force + samples.angular_rate.sum(axis=1))).sum()),
        'saturated_rate': saturated(samples.angular_rate),
        'saturated_force': saturated(samples.specific_force),
        'median_force': _median(force),
        'median_rate': _median(np.linalg.norm(samples.angular_rate, axis=1)),
        'clock_offset_s': _median((track.received_ns - samples.stamp_ns) / NANOSECONDS),
        'looks_raw': bool(len(samples)) and 'data_raw' in track.topic,
    }
    hits = max(finding['saturated_rate'], finding['saturated_force'])
    finding['saturated_share'] = clipped_share(hits, len(samples))
    finding['complaints'] = _complaints(finding)
    return finding


def _median(values: Scalars) -> float:
    finite = values[np.isfinite(values)]
    return float(np.median(finite)) if len(finite) else float('nan')


def _spread(steps: Scalars) -> float:
    return float(np.subtract(*np.percentile(steps, [84, 16])) / 2) if len(steps) else float('nan')


def _complaints(finding: dict[str, Any]) -> list[str]:
    return [text.format(**finding) for wrong, text in COMPLAINTS if wrong(finding)]


def _row(finding: dict[str, Any]) -> dict[str, Any]:
    return {
        'topic': finding['topic'],
        'count': finding['count'],
        'Hz': finding['rate_hz'],
        'time [s]': finding['duration_s'],
        'rad/s': finding['median_rate'],
        'm/s^2': finding['median_force'],
        'problems': len(finding['complaints']),
    }


def _moves(finding: dict[str, Any]) -> dict[str, Any]:
    return {
        'topic': finding['topic'],
        'first rest': finding['rest']['first_s'],
        'all': finding['rest']['total_s'],
        'poses': finding['poses']['distinct'],
        'waved': finding['waving']['time_s'],
        'clipped': f'{100 * finding["saturated_share"]:.2g} %',
        'units': f'{finding["units"]["rate"]} {finding["units"]["force"]}',
    }
