"""The board that is being recorded: what it lacks shrinks as it is moved, and faults stay."""

from io import StringIO
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.bags import ImuTrack
from multiimu_ros.cli import inspect_live as il
from multiimu_ros.cli.inspect import app
from multiimu_ros.errors import ConfigError
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

LISTENER = 'multiimu_ros.nodes.inspect'


@pytest.fixture(scope='module')
def calibration():
    """Return 140 s of two IMUs that suffice for a calibration."""
    return list(simulate(ring(2), trajectory('calibration', 140.0), 100.0).raw)


def heard(parts, step_s=5.0, until_s=140.0):
    """Yield what is heard of each IMU between two looks."""
    start_ns = parts[0].stamp_ns[0]
    for begin in np.arange(0.0, until_s, step_s):
        edges_ns = start_ns + (np.array([begin, begin + step_s]) * NANOSECONDS).astype(np.int64)
        yield [
            ImuTrack(
                f'/imu{k}/data_raw',
                '',
                part.select((lo <= part.stamp_ns) & (part.stamp_ns < hi)),
                part.stamp_ns[:0],
            )
            for k, part in enumerate(parts)
            for lo, hi in [edges_ns]
        ]


def follow(board, parts, **when):
    """Return the answer of every look."""
    answers = []
    for tracks in heard(parts, **when):
        for track in tracks:
            board.hear(track)
        answers.append(board.look([]))
    return answers


def test_a_whole_calibration_ends_with_nothing_missing(calibration):
    board = il.LiveBoard()
    answers = follow(board, calibration)
    assert not any(answers[:22])  # waving begins after 112 s, and 15 s of it are asked for
    assert answers[-1]
    board.finish()
    assert board.complete
    assert board.missing() == []
    assert 'Allan' not in {verdict.task for verdict in board.verdicts()}


def test_what_is_missing_shrinks_pose_by_pose(calibration):
    board, left = il.LiveBoard(), []
    for tracks in heard(calibration):
        for track in tracks:
            board.hear(track)
        board.look([])
        board.finish()
        [accelerometer] = [v for v in board.verdicts() if v.task == 'accelerometer']
        left.append(len(accelerometer.instead))
    assert left[0] >= 11  # twelve poses are asked for, and it lies in one
    assert left[-1] == 0
    # Another pose may be worth less than the one asked for, but never adds more than one.
    assert max(np.diff(left)) <= 1


def test_rest_is_asked_for_first(calibration):
    board = il.LiveBoard()
    follow(board, calibration, step_s=0.2, until_s=0.2)
    assert board.missing()[0] == il.FIRST


def test_a_silent_topic_keeps_the_recording_incomplete(calibration):
    board = il.LiveBoard()
    follow(board, calibration)
    assert not board.look(['`/imu9/data_raw`: nobody publishes it; start the driver.'])
    assert board.missing() == ['`/imu9/data_raw`: nobody publishes it; start the driver.']


def test_an_imu_on_another_body_is_told_and_keeps_it_incomplete(calibration):
    stranger = simulate(ring(1), trajectory('calibration', 140.0, 7), 100.0, seed=7).raw[0]
    board = il.LiveBoard()
    assert not follow(board, [calibration[0], stranger])[-1]
    board.finish()
    assert not board.complete
    assert '`/imu1/data_raw`: it does not move as /imu0/data_raw does' in board.missing()[0]


def test_wrong_units_are_told_and_keep_it_incomplete(calibration):
    board = il.LiveBoard()
    degrees = [
        ImuSamples(part.stamp_ns, np.rad2deg(part.angular_rate), part.specific_force)
        for part in calibration
    ]
    assert not follow(board, degrees)[-1]
    board.finish()
    assert not board.complete
    assert (
        '`/imu0/data_raw`: the rates turn as gravity does if they are deg/s' in board.missing()[0]
    )


def test_saturated_readings_keep_the_lever_arms_incomplete(calibration):
    board = il.LiveBoard()
    clipped = [
        ImuSamples(part.stamp_ns, np.clip(part.angular_rate, -0.3, 0.3), part.specific_force)
        for part in calibration
    ]
    assert not follow(board, clipped)[-1]
    board.finish()
    assert any('wider range' in text for text in board.missing())


def drawn(board):
    console = Console(width=100, file=StringIO())
    console.print(il.draw(board))
    return console.file.getvalue()


def test_the_view_names_imus_tasks_and_what_is_missing(calibration):
    board = il.LiveBoard()
    assert drawn(board) == 'Listening ...\n'
    follow(board, calibration, until_s=60.0)
    text = drawn(board)
    for words in ('/imu0/data_raw', '100.0', 'still', 'Still missing:', 'lever arms', '- '):
        assert words in text
    follow(board, calibration)
    board.finish()
    assert 'Nothing is missing.' in drawn(board)


def play(monkeypatch, parts, failed=0):
    """Stand in for the node: hand a recording to whoever watches, five seconds at a look."""

    def listen(watcher, topics, seconds):
        for tracks in heard(parts):
            for track in tracks:
                watcher.hear(track)
            if watcher.look([]):
                break
        return failed

    monkeypatch.setitem(sys.modules, LISTENER, SimpleNamespace(listen=listen))
    monkeypatch.setattr(il, 'PLAIN_S', 0.0)


def test_plain_lines_tell_poses_and_the_next_thing_to_do(monkeypatch, calibration):
    play(monkeypatch, calibration)
    result = CliRunner().invoke(app, ['--live'])
    lines = result.stdout.splitlines()
    assert result.exit_code == 0
    assert lines[-1] == 'complete'
    assert lines[0].startswith('2 IMUs, 0 poses; let it lie still')
    assert lines[0].endswith('more)')
    assert len(lines) == len(set(lines))  # only news


def test_what_is_missing_at_the_end_is_told_with_exit_code_1(monkeypatch, calibration):
    since = (calibration[0].stamp_ns - calibration[0].stamp_ns[0]) / NANOSECONDS
    play(monkeypatch, [part.select(since < 110.0) for part in calibration])
    result = CliRunner().invoke(app, ['--live'])
    assert result.exit_code == 1
    assert 'still missing: wave it about for' in result.stdout


def test_one_report_is_printed_for_machines(monkeypatch, calibration):
    play(monkeypatch, calibration)
    result = CliRunner().invoke(app, ['--live', '--json'])
    report = json.loads(result.stdout)
    assert list(report) == ['complete', 'imus', 'suffices', 'missing']
    assert report['complete']
    assert [imu['topic'] for imu in report['imus']] == ['/imu0/data_raw', '/imu1/data_raw']


def test_a_terminal_is_drawn_upon(monkeypatch, calibration):
    monkeypatch.setenv('FORCE_COLOR', '1')
    monkeypatch.setenv('TERM', 'xterm')
    play(monkeypatch, calibration)
    result = CliRunner().invoke(app, ['--live'])
    assert result.exit_code == 0
    assert 'Nothing is missing.' in result.stdout
    assert 'complete\n' not in result.stdout  # the view says so itself


def test_a_node_that_fails_gives_exit_code_1(monkeypatch, calibration):
    play(monkeypatch, calibration, failed=1)
    assert CliRunner().invoke(app, ['--live']).exit_code == 1


def test_nothing_heard_is_not_complete(monkeypatch):
    monkeypatch.setitem(sys.modules, LISTENER, SimpleNamespace(listen=lambda *_: 0))
    result = CliRunner().invoke(app, ['--live'])
    assert result.exit_code == 1
    assert 'still missing: any Imu topic' in result.stdout


def test_without_ros_one_sentence_says_so(monkeypatch):
    monkeypatch.setitem(sys.modules, LISTENER, None)
    error = CliRunner().invoke(app, ['--live']).exception
    assert isinstance(error, ConfigError)
    assert 'must have ROS 2' in str(error)
    assert 'source its setup file' in str(error)
