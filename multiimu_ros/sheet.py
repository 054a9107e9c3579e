"""Files that people and nodes keep: read, validated, refused with the path of the key, written."""

from collections.abc import Sequence
import os
from pathlib import Path
import shutil
import tempfile
from typing import TypeVar

from pydantic import BaseModel, ValidationError
import yaml

from multiimu_ros.errors import ConfigError

Sheet = TypeVar('Sheet', bound=BaseModel)
TOLD = ('missing', 'extra_forbidden')  # kinds of error whose message needs no `got`
LONGEST = 120  # characters of what came


def load_sheet(path: str | os.PathLike[str], model: type[Sheet], kind: str) -> Sheet:
    """Read a YAML file into `model`; `kind` says what it should hold, as in `rig`.

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
    return parse_sheet(content, model, str(path))


def parse_sheet(content: object, model: type[Sheet], source: str) -> Sheet:
    """Validate content that was read; `source` names it in the error.

    Raises
    ------
    ConfigError
        If it is wrong; names the key's path.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        reason = first['msg'].removeprefix('Value error, ')
        got = '' if first['type'] in TOLD else f', got {first["input"]!r}'
        msg = f'{source}: `{_key_path(first["loc"])}`: {reason}{got[:LONGEST]}.'
        raise ConfigError(msg) from error


def write_sheet(
    text: str, path: str | os.PathLike[str], kind: str, *, keep_old: bool = False
) -> None:
    """Write a file at once or not at all: whoever reads it meets the old or the new text.

    Parameters
    ----------
    text, path : str, path
        What, and where.
    kind : str
        What the file is, for the error.
    keep_old : bool
        Whether a file that was there survives as `<path>.old`.

    Raises
    ------
    ConfigError
        If the file cannot be written; it stays as it was then.
    """
    target, draft = Path(path), Path()
    try:
        with tempfile.NamedTemporaryFile(
            'w', encoding='utf-8', dir=target.parent, prefix=f'.{target.name}.', delete=False
        ) as file:
            draft = Path(file.name)
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        draft.chmod(0o644)  # NamedTemporaryFile makes it private to its owner
        if keep_old and target.exists():
            shutil.copy2(target, target.with_name(f'{target.name}.old'))
        draft.replace(target)
    except OSError as error:
        if draft.name:
            draft.unlink(missing_ok=True)
        msg = f'Cannot write the {kind} file `{path}`: {error.strerror}; choose a writable place.'
        raise ConfigError(msg) from error


def _key_path(location: Sequence[str | int]) -> str:
    path = ''.join(f'[{part}]' if isinstance(part, int) else f'.{part}' for part in location)
    return path.removeprefix('.') or 'the top level'
