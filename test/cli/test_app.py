"""The command line as a whole: listing, laziness, errors and exit codes."""

import subprocess
import sys

import pytest

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


@pytest.mark.ros
def test_a_node_reads_its_own_arguments():
    answer = multiimu('play', '--help')
    assert answer.returncode == 0
    assert answer.stdout.startswith('usage: play')


def test_verbs_whose_file_is_absent_are_not_listed(monkeypatch):
    monkeypatch.setitem(app.VERBS, 'dream', 'Not written yet.')
    group = app.typer.main.get_command(app.app)
    assert 'dream' not in group.list_commands(None)
    assert group.get_command(None, 'dream') is None
