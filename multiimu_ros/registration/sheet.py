"""Sheets that a person fills in, one YAML file each: read, and refused with the key's path."""

import os
from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ValidationError
import yaml

from multiimu_ros.errors import ConfigError

Sheet = TypeVar('Sheet', bound=BaseModel)


def load_sheet(path: str | os.PathLike[str], model: type[Sheet], kind: str) -> Sheet:
    """Read a YAML file into `model`; `kind` says what it should hold, as in `tip calibration`.

    Raises
    ------
    ConfigError
        If the file is missing, no YAML, or wrong; names the file and the key's path.
    """
    try:
        content = yaml.safe_load(Path(path).read_text(encoding='utf-8'))
    except OSError as error:
        msg = f'Cannot read the {kind} file `{path}`: {error.strerror}; pass an existing file.'
        raise ConfigError(msg) from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        msg = f'The {kind} file `{path}` is not YAML: {" ".join(str(error).split())}.'
        raise ConfigError(msg) from error
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        parts = (f'[{part}]' if isinstance(part, int) else f'.{part}' for part in first['loc'])
        key = ''.join(parts).removeprefix('.') or 'the top level'
        reason = first['msg'].removeprefix('Value error, ')
        told = first['type'] in ('missing', 'extra_forbidden', 'value_error')
        got = '' if told else f', got {first["input"]!r:.80}'
        msg = f'{path}: `{key}`: {reason}{got}.'
        raise ConfigError(msg) from error
