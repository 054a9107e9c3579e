"""The switch between plain numpy and compiled kernels.

A function under `@compiled` is written in the part of numpy that numba compiles.  Where numba is
installed it runs as machine code, cached on disk, so that only the first run ever waits;
elsewhere, or with the environment variable `MULTIIMU_COMPILED=0`, the same lines run as they
stand.  Both give the same answer to 1e-12; a test compares them.
"""

from collections.abc import Callable
from functools import cache
import hashlib
import os
from pathlib import Path
import re
import tempfile
from typing import ParamSpec, TypeVar

P = ParamSpec('P')
T = TypeVar('T')
ROOT = Path(__file__).resolve().parents[1]
IMPORT = re.compile(r'^from (multiimu_ros[\w.]*) import (\([^)]*\)|.*)$', re.MULTILINE)


@cache
def imported(module: Path) -> frozenset[Path]:
    """Return the file of a module of this package and those that it imports, near and far."""
    found, left = {module}, [module]
    while left:
        for parent, names in IMPORT.findall(left.pop().read_text()):
            folder = ROOT.joinpath(*parent.split('.'))
            near = [folder.with_suffix('.py')]
            near += [folder / f'{name}.py' for name in re.findall(r'\w+', names)]
            fresh = {path for path in near if path.is_file()} - found
            found |= fresh
            left += fresh
    return frozenset(found)


@cache
def cache_folder(module: Path) -> Path:
    """Return a folder for the kernels of a module as it and all that it imports are now.

    numba looks at the file of a kernel alone, and would go on using an old copy after another
    kernel that it calls has changed, as after an update.
    """
    digest = hashlib.sha256()
    for path in sorted(imported(module)):
        digest.update(path.read_bytes())
    home = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')  # noqa: PTH111
    folder = Path(home) / 'multiimu_ros' / digest.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:  # a read-only home: at least the processes of one start share it
        return Path(tempfile.gettempdir()) / f'multiimu_ros-{os.getuid()}' / folder.name
    return folder


if os.environ.get('MULTIIMU_COMPILED', '1') == '0':
    COMPILED = False
else:
    try:
        import numba
    except ImportError:
        COMPILED = False
    else:
        COMPILED = True


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile `function` with numba where that is possible, else return it unchanged."""
    if not COMPILED:
        return function
    theirs = numba.config.CACHE_DIR  # the user's NUMBA_CACHE_DIR wins
    if not theirs:
        numba.config.CACHE_DIR = str(cache_folder(Path(function.__code__.co_filename)))
    dispatcher = numba.njit(cache=True, error_model='numpy')(function)
    numba.config.CACHE_DIR = theirs
    return dispatcher  # type: ignore[no-any-return]
