"""The house stands: imports point upstream, and each outside library has one room."""

from pathlib import Path

from importlinter.cli import EXIT_STATUS_SUCCESS, lint_imports
import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / 'multiimu_ros'
MODULES = sorted(path.relative_to(ROOT) for path in PACKAGE.rglob('*.py'))


def test_imports_point_upstream(monkeypatch):
    monkeypatch.chdir(ROOT)
    assert lint_imports(config_filename='.importlinter', no_cache=True) == EXIT_STATUS_SUCCESS


@pytest.mark.parametrize('path', MODULES, ids=str)
def test_a_module_fits_in_three_hundred_lines(path):
    # STYLE's budget: a reader keeps one such file in mind.
    assert len((ROOT / path).read_text(encoding='utf-8').splitlines()) <= 300


def test_every_folder_with_modules_is_a_package():
    folders = {path.parent for path in MODULES}
    assert [folder for folder in folders if not (ROOT / folder / '__init__.py').is_file()] == []
