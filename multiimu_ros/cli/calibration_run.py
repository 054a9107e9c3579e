"""A recording and the calibration that came of it: what `calibrate` and `register` have in common.

A stage that is repeated alone changes its own figures and nothing else in the rig file; what it
came from is noted under its name in the provenance, beside what the other figures came from.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import Progress

from multiimu_ros.bags import find_imu_topics, ImuTrack, read_imus, Topic
from multiimu_ros.cli.bag_facts import bag_facts, bag_sha256, temperature_span
from multiimu_ros.errors import CalibrationError, ConfigError
from multiimu_ros.rig import Extrinsics, Imu, Rig
from multiimu_ros.rig_calibration.calibrate import (
    calibrate_rig,
    Calibration,
    rest_rms,
    spread_per_imu,
    STAGES,
)
from multiimu_ros.rig_calibration.verdicts import judge, why_it_failed, worst

# What a stage may change of an IMU, and of its extrinsics.
KEYS = {
    'time': ('time_offset', 'time_offset_sigma'),
    'intrinsics': ('intrinsics',),
    'noise': ('noise',),
}
POSE_KEYS = {
    'rotation': ('rotation', 'rotation_sigma'),
    'lever_arm': ('lever_arm', 'lever_arm_sigma'),
}
LIVE = 'biases_'  # what the nodes note of the biases that they saved; new ones have no such past
STEPS_PER_IMU, STEPS = 2, 5  # what the progress bar counts to
APART = 1.0  # [m/s^2] 6 deg of gravity between IMUs that were registered: not one body
STANDARD = (
    'Local gravity was not stated and is taken as 9.80665 m/s^2, which may be off by 0.3 %, and '
    'all accelerometer scales with it; repeat with `--latitude` and `--height`.'
)


class Run:
    """A calibration, the verdicts on it, and the rig file that it makes."""

    def __init__(
        self,
        bag: Path,
        calibration: Calibration,
        facts: Sequence[dict[str, Any]],
        stages: Sequence[str],
    ) -> None:
        self.bag = bag
        self.calibration = calibration
        self.verdicts = judge(calibration)
        before, found = calibration.before, calibration.after
        imus = [
            self._noted(k, fact, stages, repeated(old, new, stages))
            for k, (old, new, fact) in enumerate(zip(before.imus, found.imus, facts, strict=True))
        ]
        self.rig = found.model_copy(update={'imus': tuple(imus)})

    def _noted(self, k: int, fact: dict[str, Any], stages: Sequence[str], imu: Imu) -> Imu:
        """Return the IMU with where its figures come from: as a whole, or stage by stage."""
        own = fact | self._residuals(k, imu.name)
        if 'intrinsics' in stages:
            same_noise = imu.noise == self.calibration.before.imus[k].noise
            kept = {
                key: value
                for key, value in imu.provenance.items()
                if not key.startswith(LIVE)
                and (key not in stages or (key == 'noise' and same_noise))
            }
            return imu.model_copy(update={'provenance': kept | own})
        parts = {stage: dict(own) for stage in stages}
        return imu.model_copy(update={'provenance': imu.provenance | parts})

    def _residuals(self, k: int, name: str) -> dict[str, Any]:
        own = tuple(verdict for verdict in self.verdicts if verdict.imu == name)
        noted: dict[str, Any] = {'verdict': worst(own)}
        if self.calibration.intrinsics:
            fit = self.calibration.intrinsics[k]
            rms = rest_rms(fit.residual_after, fit.poses.duration)
            noted |= {'poses': int(fit.poses.known.sum()), 'residual_rms': round(rms, 6)}
        alignment = self.calibration.alignments[k] if self.calibration.alignments else None
        if alignment is not None and alignment.fine is not None and alignment.fine.skew:
            noted |= {'clock_skew_ppm': round(1e6 * alignment.fine.skew, 4)}
        return noted


def repeated(old: Imu, new: Imu, stages: Sequence[str]) -> Imu:
    """Return the old IMU with what the stages have found of it."""
    keys = [key for stage in stages for key in KEYS.get(stage, ())]
    update = {key: getattr(new, key) for key in keys}
    turned = [key for stage in stages for key in POSE_KEYS.get(stage, ())]
    if turned and new.extrinsics is not None:
        pose = {key: getattr(new.extrinsics, key) for key in turned}
        update['extrinsics'] = (old.extrinsics or Extrinsics()).model_copy(update=pose)
    return old.model_copy(update=update)


def run_calibration(
    bag: Path,
    board: Rig,
    present: Sequence[Topic],
    wanted: list[str],
    stages: Sequence[str] = STAGES,
    *,
    joint: bool = False,
    bare: bool = False,
) -> Run:
    """Read the bag and run the stages, under a progress bar on a terminal's stderr.

    A `bare` rig, which no file tells, gets the frames that the messages name.

    Raises
    ------
    ConfigError
        If the bag is damaged or lacks an IMU of the rig.
    CalibrationError
        If the recording cannot determine what was asked for.
    """
    topics = _all_topics(board, present, wanted)
    with _steps(STEPS + STEPS_PER_IMU * len(topics)) as tell:
        tell('reading the bag')
        tracks = read_imus(bag, topics).tracks
        facts = _facts(bag, tracks, present)
        board = _with_frames(board, tracks) if bare else board
        samples = [track.samples for track in tracks]
        try:
            found = calibrate_rig(board, samples, stages=stages, joint=joint, tell=tell)
        except CalibrationError as error:
            raise CalibrationError(why_it_failed(str(error), board.names, samples)) from error
    _refuse_two_bodies(found)
    frame = found.after.rig
    if 'intrinsics' in stages and frame.gravity is None and frame.latitude is None:
        found = replace(found, notes=(*found.notes, STANDARD))
    return Run(bag, found, facts, stages)


def _all_topics(board: Rig, present: Sequence[Topic], wanted: list[str]) -> list[str]:
    found = find_imu_topics(present, board.names, wanted)
    absent = [name for k, name in enumerate(board.names) if k not in found]
    if absent:
        msg = (
            f'The bag must hold all IMUs of the rig, but nothing was recorded of '
            f'`{"`, `".join(absent)}`; record it again, name its topics by `--topics`, or take '
            f'them out of the rig file.'
        )
        raise ConfigError(msg)
    topics = [found[k] for k in range(len(found))]
    twice = [topic for topic in topics if topics.count(topic) > 1]
    if twice:
        msg = f'`--topics` must name another topic for each IMU, got `{twice[0]}` more than once.'
        raise ConfigError(msg)
    return topics


@contextmanager
def _steps(total: int) -> Iterator[Callable[[str], None]]:
    console = Console(stderr=True)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task('calibrating', total=total)

        def tell(step: str) -> None:
            bar.update(task, description=step, advance=1)

        yield tell


def _facts(
    bag: Path, tracks: Sequence[ImuTrack], present: Sequence[Topic]
) -> list[dict[str, Any]]:
    sha256 = bag_sha256(bag)
    facts = []
    for track in tracks:
        fact = bag_facts(bag, track, sha256)
        stamps = track.samples.stamp_ns
        fact |= {'duration_s': round(float(np.ptp(stamps)) * 1e-9, 3)}
        span = temperature_span(bag, track.topic, present)
        facts.append(fact if span is None else fact | {'temperature': list(span)})
    return facts


def _with_frames(board: Rig, tracks: Sequence[ImuTrack]) -> Rig:
    imus = [
        imu.model_copy(update={'frame_id': track.frame_id or imu.frame_id})
        for imu, track in zip(board.imus, tracks, strict=True)
    ]
    return board.model_copy(update={'imus': tuple(imus)})


def _refuse_two_bodies(found: Calibration) -> None:
    """Refuse IMUs that were registered and still do not feel the same gravity at rest."""
    if not found.mountings:
        return
    apart = spread_per_imu(found.board, found.intervals)
    size = [rest_rms(column, found.intervals.duration_s) for column in apart.T]
    farthest = int(np.argmax(np.nan_to_num(size)))
    if size[farthest] > APART:
        msg = (
            f'`{found.after.imus[farthest].name}` feels gravity {size[farthest]:.2g} m/s^2 away '
            f'from where the other IMUs feel it, however it is turned; fix all IMUs to one rigid '
            f'body, and record again.'
        )
        raise CalibrationError(msg)
