"""The switch between plain numpy and compiled kernels.

A function under `@compiled` is written in the part of numpy that numba compiles.  Where numba is
installed it runs as machine code (cached on disk, so that only the first run ever waits);
elsewhere, or with the environment variable `MULTIIMU_COMPILED=0`, the same lines run as they
stand.  Both give the same answer to 1e-12; a test compares them.
"""

from collections.abc import Callable
import os
from typing import ParamSpec, TypeVar

P = ParamSpec('P')
T = TypeVar('T')

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
    return numba.njit(cache=True, error_model='numpy')(function)  # type: ignore[no-any-return]
