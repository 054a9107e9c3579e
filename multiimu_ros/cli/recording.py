"""The preflight of a whole recording: IMU by IMU how it moved, then board by board."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from multiimu_ros.bags import ImuTrack
from multiimu_ros.calibration.pose_tracker import PoseTracker
from multiimu_ros.calibration.rests import Motion
from multiimu_ros.cli.one_board import (
    Board,
    closeness,
    group_boards,
    shared_share,
    STRANGE,
)
from multiimu_ros.cli.preflight import examine_motion, Figures, judge, judge_board

HALF = 0.9  # of the time that the others cover: less was not left out by chance


def follow(track: ImuTrack) -> Motion:
    """Return how one IMU rested and moved."""
    tracker = PoseTracker()
    tracker.push(track.samples)
    return tracker.view()


def judge_recording(
    findings: Sequence[Figures], motions: Mapping[str, Motion]
) -> tuple[list[Figures], list[dict[str, Any]]]:
    """Say what each IMU's recording, and each board's, suffices for.

    Parameters
    ----------
    findings : sequence of mapping
        As of `inspect_track`.
    motions : mapping
        How each topic moved.

    Returns
    -------
    list of mapping
        The findings, with what the motion tells, and complaints about it.
    list of mapping
        The boards, the largest first: their topics, and what they suffice for.
    """
    raw = [f['topic'] for f in findings if f['looks_raw']] or list(motions)
    groups = group_boards({topic: motions[topic] for topic in raw})
    companions = {topic: len(group.topics) - 1 for group in groups for topic in group.topics}
    told = []
    for finding in findings:
        topic = finding['topic']
        moved = examine_motion(motions[topic])
        complaints = [
            *finding['complaints'],
            *_new_complaints(finding, moved['units']['complaints']),
            *(_about_others(topic, groups, motions) if topic in companions else ()),
        ]
        verdicts = judge(moved, companions.get(topic, 0), finding['saturated_share'])
        told.append(finding | moved | {'complaints': complaints, 'suffices': verdicts})
    by_topic = {figures['topic']: figures for figures in told}
    return [_plain(figures) for figures in told], [_board(group, by_topic) for group in groups]


def _new_complaints(finding: Figures, complaints: Sequence[str]) -> Iterator[str]:
    """Yield what the medians of the topic did not tell already."""
    told = ' '.join(finding['complaints'])
    for complaint in complaints:
        if not ('deg/s' in complaint and 'deg/s' in told):
            yield complaint


def _about_others(
    topic: str, groups: Sequence[Board], motions: Mapping[str, Motion]
) -> Iterator[str]:
    """Yield how a topic differs from the board that most others belong to."""
    first = groups[0].topics[0]
    if topic not in groups[0].topics:
        yield unlike(first, closeness(motions[first], motions[topic])) + '.'
    share = shared_share([motions[name] for name in motions], motions[topic])
    if share < HALF:
        yield (
            f'it covers {100 * share:.0f} % of the time that another topic does; keep its driver '
            'running from beginning to end.'
        )


def unlike(first: str, alike: float) -> str:
    """Say how a topic differs from `first`, and what to do."""
    if alike == STRANGE:
        return f'it shares less than 10 s with {first}; record both together, for longer'
    return (
        f'it does not move as {first} does (correlation {alike:.2g}); fix both to one body and '
        'record again, or leave one out with `--topics`'
    )


def _board(group: Board, figures: Mapping[str, Figures]) -> dict[str, Any]:
    verdicts = judge_board({topic: figures[topic]['suffices'] for topic in group.topics})
    return {
        'topics': group.topics,
        'correlations': group.correlations,
        'suffices': [verdict._asdict() for verdict in verdicts],
    }


def _plain(figures: Figures) -> Figures:
    return figures | {'suffices': [verdict._asdict() for verdict in figures['suffices']]}
