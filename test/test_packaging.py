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
import yaml

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
    always = [line for line in distribution('multiimu_ros').requires if 'extra ==' not in line]
    needed = [re.match(r'[\w.-]+', line)[0].lower() for line in always]
    assert [name for name in needed if f'\n{name}==' not in pinned] == []


def test_the_example_runs():
    run = subprocess.run(
        [sys.executable, ROOT / 'examples/pipeline_in_a_loop.py'],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout.startswith('2000 frames')  # 10 s at 200 Hz, none lost


@pytest.fixture
def tree(tmp_path):
    """Return a copy of the repository, without what was built."""
    built = shutil.ignore_patterns('.venv*', '.git', 'build', '*.egg-info', '__pycache__', 'out')
    return Path(shutil.copytree(ROOT, tmp_path / 'tree', ignore=built))


def test_colcon_installs_every_executable_where_ros2_run_looks(tree, tmp_path):
    # The command of colcon's ament_python build.
    command = f"""setup.py -q egg_info --egg-base {tmp_path} build --build-base {tmp_path}/build
        install --prefix {tmp_path}/install --record {tmp_path}/install.log
        --single-version-externally-managed"""
    subprocess.run([sys.executable, *command.split()], cwd=tree, check=True, capture_output=True)
    programs = {path.name: path for path in (tmp_path / 'install/lib/multiimu_ros').iterdir()}
    assert sorted(programs) == sorted(SCRIPTS)
    # Started by the Python that has the libraries, which `/usr/bin/env python3` may not be.
    first_lines = {path.read_text().partition('\n')[0] for path in programs.values()}
    assert first_lines == {f'#!{sys.executable}'}
    share = tmp_path / 'install/share'
    assert (share / 'ament_index/resource_index/packages/multiimu_ros').exists()
    assert (share / 'multiimu_ros/launch/demo.launch.py').exists()


def test_the_launch_files_start_executables_that_exist():
    text = ''.join(path.read_text() for path in ROOT.glob('launch/*.py'))
    started = set(re.findall(r"(?:\bnode|ExecutableInPackage)\('(\w+)'", text))
    assert {'driver', 'pipeline', 'fusion', 'emulator'} <= started <= set(SCRIPTS)


def test_the_parameter_file_has_a_section_for_each_node_that_is_launched():
    text = (ROOT / 'launch/multiimu.launch.py').read_text()
    sections = yaml.safe_load((ROOT / 'config/params.yaml').read_text())
    assert {f'/**/{name}' for name in re.findall(r"\bnode\('(\w+)'", text)} == set(sections)


def test_a_wheel_carries_what_the_nodes_need_at_run_time(tree, tmp_path):
    build = 'import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])'
    subprocess.run(
        [sys.executable, '-c', build, tmp_path],
        cwd=tree,
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
