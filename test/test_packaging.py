"""What pip, colcon and `ros2 run` find agrees with the tree."""

import ast
from importlib.metadata import distribution
from importlib.util import find_spec
from pathlib import Path
import re
import shutil
import subprocess
import sys
from xml.etree import ElementTree
from zipfile import ZipFile

import pytest

import multiimu_ros

ROOT = Path(__file__).parent.parent
MANIFEST = ElementTree.parse(ROOT / 'package.xml').getroot()
SCRIPTS = {
    script.name: script.value
    for script in distribution('multiimu_ros').entry_points.select(group='console_scripts')
}
ROS_PACKAGES = re.compile(r'rclpy|tf2_\w+|launch\w*|\w+_msgs|\w+_srvs|\w+_interfaces')


def imported_packages(folder):
    """Return the top-level names that the modules under `folder` import."""
    names = set()
    for path in (ROOT / folder).rglob('*.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Import):
                names |= {alias.name.split('.')[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                names.add(node.module.split('.')[0])
    return names


def test_one_version_everywhere():
    version = MANIFEST.findtext('version')
    assert version == multiimu_ros.__version__ == distribution('multiimu_ros').version
    assert version in (ROOT / 'CHANGELOG.rst').read_text(encoding='utf-8')


def test_the_executables_are_those_of_the_readme():
    readme = (ROOT / 'README.md').read_text(encoding='utf-8')
    tables = readme.split('## Nodes')[1].split('## At the desk')[0]
    promised = re.findall(r'`(\w+)`', ' '.join(re.findall(r'^\|([^|]*)\|', tables, re.MULTILINE)))
    assert sorted([*promised, 'multiimu']) == sorted(SCRIPTS)


@pytest.mark.parametrize('name', SCRIPTS)
def test_every_executable_has_a_main(name):
    module, function = SCRIPTS[name].split(':')
    source = Path(find_spec(module).origin).read_text(encoding='utf-8')
    defined = [node.name for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)]
    assert function in defined


def test_pip_users_find_every_executable_where_ros2_run_looks():
    wrappers = {path.name: path.stat().st_mode for path in (ROOT / 'lib/multiimu_ros').iterdir()}
    assert sorted(wrappers) == sorted(SCRIPTS)
    assert all(mode & 0o111 for mode in wrappers.values())


def test_a_wrapper_runs_the_script_of_its_name():
    wrapper = ROOT / 'lib/multiimu_ros/multiimu'
    run = subprocess.run(
        [sys.executable, wrapper, '--help'], capture_output=True, text=True, check=True
    )
    assert 'multiimu' in run.stdout


@pytest.mark.parametrize('folder', ['multiimu_ros', 'launch'])
def test_every_ros_package_that_is_imported_is_declared(folder):
    declared = {element.text for element in MANIFEST.findall('exec_depend')} | {'tf2_ros'}
    needed = {name for name in imported_packages(folder) if ROS_PACKAGES.fullmatch(name)}
    assert needed <= declared


def test_every_requirement_is_pinned_and_names_no_host():
    lines = (ROOT / 'requirements.txt').read_text() + (ROOT / 'requirements-dev.txt').read_text()
    pins = [line for line in lines.splitlines() if line and line[0] not in '#-']
    assert [pin for pin in pins if not re.match(r'[\w.\[\]-]+==[\w.]+( +#.*)?$', pin)] == []
    assert '://' not in lines


def test_what_setup_asks_for_is_pinned():
    pinned = (ROOT / 'requirements.txt').read_text().lower()
    needed = [
        re.match(r'[\w.-]+', line)[0].lower() for line in distribution('multiimu_ros').requires
    ]
    assert [name for name in needed if f'\n{name}==' not in pinned] == []


def test_the_example_runs():
    run = subprocess.run(
        [sys.executable, ROOT / 'examples/pipeline_in_a_loop.py'],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.startswith('2000 frames')  # 10 s at 200 Hz, none lost


def test_a_wheel_carries_what_the_nodes_need_at_run_time(tmp_path):
    shutil.copytree(
        ROOT,
        tmp_path / 'tree',
        ignore=shutil.ignore_patterns('.venv*', '.git', 'build', '*.egg-info', '__pycache__'),
    )
    build = 'import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])'
    subprocess.run(
        [sys.executable, '-c', build, tmp_path],
        cwd=tmp_path / 'tree',
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob('*.whl')
    held = {name.partition('.data/data/')[2] or name for name in ZipFile(wheel).namelist()}
    needed = {'multiimu_ros/py.typed', 'share/multiimu_ros/package.xml'}
    needed |= {f'share/multiimu_ros/config/{path.name}' for path in ROOT.glob('config/*')}
    needed |= {f'share/multiimu_ros/launch/{path.name}' for path in ROOT.glob('launch/*.py')}
    needed |= {f'lib/multiimu_ros/{name}' for name in SCRIPTS}
    needed |= {str(path.relative_to(ROOT)) for path in ROOT.glob('multiimu_ros/**/*.py')}
    assert needed <= held
