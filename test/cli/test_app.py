"""The command line as a whole: listing, laziness, errors and exit codes."""

import runpy
import subprocess
import sys
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from multiimu_ros.cli import app


def multiimu(*arguments):
    """Run the command line in a process of its own."""
    command = [sys.executable, '-m', 'multiimu_ros.cli', *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_help_lists_every_verb_without_importing_it():
    script = (
        'import sys; sys.argv = ["multiimu", "--help"]\n'
        'from multiimu_ros.cli.app import main\n'
        'try: main()\n'
        'finally: print(sorted(set(sys.modules) & {"numpy", "rclpy", "numba", "rosbags"}))'
    )
    command = [sys.executable, '-c', script]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    assert answer.stdout.rstrip().endswith('[]')
    for verb in ('fuse', 'inspect', 'record', 'play'):
        assert verb in answer.stdout


def test_an_unknown_verb_is_refused_with_exit_code_2():
    answer = multiimu('fuze')
    assert answer.returncode == 2
    assert "No such command 'fuze'" in answer.stderr


def test_an_error_of_the_users_is_one_sentence_and_exit_code_1():
    answer = multiimu('inspect', '/nowhere')
    assert (answer.returncode, answer.stdout) == (1, '')
    assert answer.stderr.count('\n') == 1
    assert 'must be a rosbag2 folder' in answer.stderr


def test_a_node_gets_its_arguments_as_they_are(monkeypatch):
    node = SimpleNamespace(main=lambda: sys.argv == ['play', 'bag', '--help', '--ros-args'])
    monkeypatch.setattr(app, 'import_module', lambda name: node)
    answer = CliRunner().invoke(app.app, ['play', 'bag', '--help', '--ros-args'])
    assert answer.exit_code == 1  # True: they came


def test_main_turns_errors_into_a_sentence(monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['multiimu', 'inspect', '/nowhere'])
    with pytest.raises(SystemExit) as leaving:
        runpy.run_module('multiimu_ros.cli', run_name='__main__')
    assert leaving.value.code == 1
    assert capsys.readouterr().err.startswith('`/nowhere` must be')


def test_the_list_is_shown_by_the_same_names(monkeypatch):
    answer = CliRunner().invoke(app.app, ['--help'])
    assert answer.exit_code == 0
    assert 'inspect' in answer.stdout


def test_verbs_whose_file_is_absent_are_not_listed(monkeypatch):
    monkeypatch.setitem(app.VERBS, 'dream', 'Not written yet.')
    group = app.typer.main.get_command(app.app)
    assert 'dream' not in group.list_commands(None)
    assert group.get_command(None, 'dream') is None
