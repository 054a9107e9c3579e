"""The rig that a verb starts from: a file, or a bare one with an IMU for each raw topic."""

from collections.abc import Sequence
from pathlib import Path
import re

from multiimu_ros.bags import find_imu_topics, Topic
from multiimu_ros.bags.reader import IMU_TYPE
from multiimu_ros.errors import ConfigError
from multiimu_ros.rig import Imu, load_rig, MAX_IMUS, Rig, RigFrame


def start_rig(
    rig: Path | None, output: Path, present: Sequence[Topic], wanted: list[str]
) -> tuple[Rig, list[str]]:
    """Return the rig to start from, a bare one where none is given, and the topics to read.

    Raises
    ------
    ConfigError
        If the rig file is wrong, the bag has no Imu topics, or `output` exists and would be
        replaced by a bare rig.
    """
    if rig is not None:
        return load_rig(rig), wanted
    if output.exists():
        msg = f'`--rig {output}` must be given to keep what it holds, or another `-o` be chosen.'
        raise ConfigError(msg)
    imu_topics = [t.name for t in present if t.type == IMU_TYPE and t.count]
    raw = [name for name in imu_topics if name.endswith('/data_raw')]
    found = wanted or sorted(raw, key=_by_number)
    if not found:
        find_imu_topics(present, ['imu0'])  # which says what the bag holds instead
    if len(found) > MAX_IMUS:
        msg = f'`--topics` must name at most {MAX_IMUS} IMUs of the bag, which has {len(found)}.'
        raise ConfigError(msg)
    imus = tuple(Imu(name=name, frame_id=f'{name}_link') for name in names_of(found))
    return Rig(version=1, rig=RigFrame(name=output.stem), imus=imus), found


def _by_number(topic: str) -> list[tuple[int, str]]:
    """Return a key that sorts imu2 before imu10."""
    return [(int(x), '') if x.isdigit() else (-1, x) for x in re.split('([0-9]+)', topic)]


def names_of(topics: Sequence[str]) -> list[str]:
    """Return what stands before `/data_raw`, or imu0, imu1 ... where that makes no names."""
    heads = [re.fullmatch('(?:.*/)?([a-zA-Z][a-zA-Z0-9_]*)/data_raw', topic) for topic in topics]
    names = [head.group(1) for head in heads if head]
    if len(set(names)) == len(topics):
        return names
    return [f'imu{k}' for k in range(len(topics))]
