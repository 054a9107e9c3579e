"""The truth of an emulated run, in a file: a numpy archive whose keys are the fields of `Motion`.

Beside them stands `stamp_ns`, the host clock's time of each instant, against which the stamps of
the nodes can be held.
"""

from dataclasses import fields
import os
from pathlib import Path

import numpy as np

from multiimu_ros.arrays import Stamps
from multiimu_ros.errors import ConfigError
from multiimu_ros.simulation.motion import Motion


def save_truth(path: str | os.PathLike[str], motion: Motion, stamp_ns: Stamps) -> None:
    """Write the truth; a reader sees the whole file or none.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    """
    target = Path(path)
    draft = target.with_name(f'.{target.name}.{os.getpid()}')
    try:
        with draft.open('wb') as file:
            np.savez(file, stamp_ns=stamp_ns, **vars(motion))
        draft.replace(target)
    except OSError as error:
        msg = f'Cannot write the truth file `{path}`: {error.strerror}; choose a writable place.'
        raise ConfigError(msg) from error


def load_truth(path: str | os.PathLike[str]) -> tuple[Motion, Stamps]:
    """Read a file of `save_truth`.

    Raises
    ------
    ConfigError
        If the file is missing or none of ours.
    """
    try:
        with np.load(path) as file:
            return Motion(**{field.name: file[field.name] for field in fields(Motion)}), file[
                'stamp_ns'
            ]
    except (OSError, KeyError, ValueError) as error:
        msg = f'Cannot read the truth file `{path}`: {error}; pass a file of the emulator.'
        raise ConfigError(msg) from error
