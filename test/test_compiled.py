"""The switch: compiled where numba is, plain where it is not or not wanted, equal either way."""

import json
import os
import subprocess
import sys
import tempfile

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros import compiled

# A kernel of every sort, run in a process of its own because the switch is read at import.
PROBE = """
import json, sys
if 'hide' in sys.argv:
    sys.modules['numba'] = None
import numpy as np
from multiimu_ros import compiled, rotations
theta = np.array([0.3, -0.7, 1.1])
R = rotations.exp_so3(theta)
answers = [R, rotations.log_so3(R), rotations.right_jacobian(theta), rotations.renormalise(R)]
print(json.dumps([compiled.COMPILED, [a.tolist() for a in answers]]))
"""


def probe(switch, *arguments):
    """Return whether a new process compiles under `switch`, and what its kernels answer."""
    environment = os.environ | {'MULTIIMU_COMPILED': switch}
    command = [sys.executable, '-c', PROBE, *arguments]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


def test_compiled_and_plain_kernels_agree():
    (on, fast), (off, plain) = probe('1'), probe('0')
    assert (on, off) == (True, False)
    for one, other in zip(fast, plain, strict=True):
        # The compiler may fuse a multiplication and an addition: rounding, no more.
        assert_allclose(one, other, rtol=1e-12, atol=1e-15)


def test_without_numba_the_kernels_run_as_they_stand():
    assert probe('1', 'hide')[0] is False


def test_off_returns_the_function_itself(monkeypatch):
    monkeypatch.setattr(compiled, 'COMPILED', False)
    assert compiled.compiled(np.sum) is np.sum


@pytest.mark.skipif(not compiled.COMPILED, reason='the switch is off in this run')
def test_on_returns_a_dispatcher_that_keeps_the_plain_function():
    assert compiled.compiled(probe).py_func is probe


@pytest.fixture
def package(tmp_path, monkeypatch):
    """Return a package in which `top` imports `kernel`; its cache is elsewhere too."""
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'cache'))
    monkeypatch.setattr(compiled, 'ROOT', tmp_path)
    folder = tmp_path / 'multiimu_ros'
    folder.mkdir()
    (folder / 'kernel.py').write_text('def one(): return 1\n')
    (folder / 'other.py').write_text('def two(): return 2\n')
    (folder / 'top.py').write_text(
        'from multiimu_ros import (\n    kernel as k,\n    compiled\n)\n'
    )
    return folder


def folder_of(module):
    compiled.imported.cache_clear()
    compiled.cache_folder.cache_clear()
    return compiled.cache_folder(module)


def test_a_change_of_what_a_kernel_imports_gives_another_cache_and_one_elsewhere_does_not(package):
    before = folder_of(package / 'top.py')
    assert before.is_dir()
    (package / 'other.py').write_text('def two(): return 3\n')
    assert folder_of(package / 'top.py') == before
    (package / 'kernel.py').write_text('def one(): return 2\n')
    assert folder_of(package / 'top.py') != before


def test_every_import_of_a_kernel_is_found():
    from_text = compiled.imported(compiled.ROOT / 'multiimu_ros' / 'fusion' / 'fuse_scan.py')
    command = (
        'import sys; import multiimu_ros.fusion.fuse_scan; '
        'print(*(m.__file__ for n, m in sys.modules.items() if n.startswith("multiimu_ros.")))'
    )
    run = subprocess.run(
        [sys.executable, '-c', command], capture_output=True, text=True, check=True
    )
    loaded = {path for path in run.stdout.split() if not path.endswith('__init__.py')}
    assert {str(path) for path in from_text} == loaded


def test_where_the_home_cannot_be_written_the_cache_is_temporary(package, tmp_path, monkeypatch):
    (tmp_path / 'file').write_text('no folder')
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'file'))
    assert folder_of(package / 'top.py').is_relative_to(tempfile.gettempdir())
