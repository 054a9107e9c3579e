"""The switch between plain numpy and compiled kernels.

A function under `@compiled` is written in the part of numpy that numba compiles.  Where numba is
installed it runs as machine code, cached on disk, so that only the first run ever waits;
elsewhere, or with the environment variable `MULTIIMU_COMPILED=0`, the same lines run as they
stand.  Both give the same answer to 1e-12; a test compares them.
"""

from collections.abc import Callable
import hashlib
import os
from pathlib import Path
import tempfile
from typing import ParamSpec, TypeVar

P = ParamSpec('P')
T = TypeVar('T')


def cache_folder(package: Path) -> Path:
    """Return a folder of its own for the kernels of a package as they are now.

    numba looks at the file of a kernel alone, and would go on using an old copy after another
    kernel that it calls has changed, as after an update.
    """
    digest = hashlib.sha256()
    for path in sorted(package.rglob('*.py')):
        content = path.read_bytes()
        if b'@compiled' in content:
            digest.update(content)
    cache = os.environ.get('XDG_CACHE_HOME') or os.path.expanduser('~/.cache')  # noqa: PTH111
    folder = Path(cache) / 'multiimu_ros' / digest.hexdigest()[:16]
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
        if not numba.config.CACHE_DIR:  # the user's NUMBA_CACHE_DIR wins
            numba.config.CACHE_DIR = str(cache_folder(Path(__file__).parent))


def compiled(function: Callable[P, T]) -> Callable[P, T]:
    """Compile `function` with numba where that is possible, else return it unchanged."""
    if not COMPILED:
        return function
    return numba.njit(cache=True, error_model='numpy')(function)  # type: ignore[no-any-return]
