"""The `emulator` executable as a user meets it: a process, a port, files, and exit codes."""

import os
from pathlib import Path
import select
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from multiimu_ros.cli import emulator
from multiimu_ros.errors import ConfigError
from multiimu_ros.rig import load_rig
from multiimu_ros.simulation.faults import FaultPlan
from multiimu_ros.simulation.truth import load_truth
from multiimu_ros.wire.decoder import FrameDecoder
from multiimu_ros.wire.packets import Scan

RIG = str(Path(__file__).parents[2] / 'config' / 'row3.yaml')


def start(*arguments):
    """Start the emulator as a process; return it with the port that it printed."""
    code = 'from multiimu_ros.cli.emulator import main; main()'
    process = subprocess.Popen(
        [sys.executable, '-c', code, '--rig', RIG, '--print-port', *arguments],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    return process, process.stdout.readline().strip()


def read_scans(port, enough, feed=None):
    decoder, scans, end = FrameDecoder(), [], time.monotonic() + 10
    file = os.open(port, os.O_RDWR | os.O_NOCTTY)
    if feed:
        feed()
    while not enough(scans) and time.monotonic() < end:
        if not select.select([file], [], [], 0.5)[0]:
            continue
        try:
            data = os.read(file, 65536)
        except OSError:
            data = b''
        if not data:  # the board is gone
            break
        sent = decoder.push(data)
        scans += [packet for packet in sent if isinstance(packet, Scan)]
    os.close(file)
    return scans


def test_a_run_ends_with_its_motion_and_leaves_truth_and_rig(tmp_path):
    truth, rig = tmp_path / 'truth.npz', tmp_path / 'rig.yaml'
    files = ['--truth', str(truth), '--calibrated-rig', str(rig)]
    process, port = start('--duration', '1', '--rate', '100', '--motion', 'static', *files)
    before = time.time_ns()
    scans = read_scans(port, lambda _: False)
    assert process.wait(timeout=5) == 0
    process.communicate()
    assert len(scans) > 80
    motion, stamps = load_truth(truth)
    assert len(motion.time) == 100
    assert before < stamps[0] < time.time_ns()
    assert np.all(np.diff(stamps) == 10_000_000)
    assert load_rig(rig).nominal_blocks() == ()


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_it_cleanly(number, tmp_path):
    process, port = start('--link', str(tmp_path / 'board'))
    assert port == str(tmp_path / 'board')
    assert read_scans(port, lambda s: len(s) > 3)
    process.send_signal(number)
    out, err = process.communicate(timeout=5)
    assert (process.returncode, out, err) == (0, '', '')
    assert not os.path.lexists(port)


def test_faults_are_obeyed_from_stdin_and_nonsense_is_answered():
    process, port = start('--fault', 'dead:0')

    def feed():
        process.stdin.write('dead:2\nexplode\n')
        process.stdin.flush()

    scans = read_scans(port, lambda s: len(s) > 100, feed)
    process.terminate()
    _, err = process.communicate(timeout=5)
    assert all(0 not in scan.imus for scan in scans)
    assert 2 not in scans[-1].imus
    assert 'got `explode`' in err


def test_a_bad_option_is_one_sentence_and_exit_code_1():
    process, _ = start('--motion', 'swim')
    _, err = process.communicate(timeout=10)
    assert (process.returncode, err.count('\n')) == (1, 1)
    assert err.startswith('`motion` must be one of static')


def test_a_run_inside_this_process_says_what_it_does_and_did(tmp_path):
    link = tmp_path / 'board'
    scans = []

    def drive():
        end = time.monotonic() + 10
        while not link.exists() and time.monotonic() < end:
            time.sleep(0.01)
        scans.extend(read_scans(link, lambda _: False))

    driver = threading.Thread(target=drive)
    driver.start()
    options = f'--rig {RIG} --motion static --duration 0.5 --link {link} --fault dead:0'.split()
    files = ['--truth', str(tmp_path / 't.npz'), '--calibrated-rig', str(tmp_path / 'r.yaml')]
    result = CliRunner().invoke(emulator.app, options + files, catch_exceptions=False)
    driver.join()
    assert result.exit_code == 0
    assert f'row3 (3 IMUs x 200 Hz), static, 0.5 s, on {link}' in result.output
    assert 'bytes sent, 0 of them lost' in result.output
    assert (tmp_path / 't.npz').exists()
    assert (tmp_path / 'r.yaml').exists()
    assert all(sorted(scan.imus) == [1, 2] for scan in scans)


class Clock:
    """All that obeying needs of a board."""

    def now(self):
        return 5.0


def test_commands_are_obeyed_until_their_file_ends(capsys):
    plan = FaultPlan(2)
    out, into = os.pipe()
    assert emulator._obey(out, Clock(), plan)  # nothing has come yet
    os.write(into, b'stuck:1\nnonsense\n')
    assert emulator._obey(out, Clock(), plan)
    assert (plan.kind_of(1, 4.9), plan.kind_of(1, 5.0)) == (None, 'stuck')
    assert 'got `nonsense`' in capsys.readouterr().err
    os.close(into)
    assert not emulator._obey(out, Clock(), plan)
    os.close(out)
    assert not emulator._obey(out, Clock(), plan)


def test_main_turns_an_error_into_one_sentence(monkeypatch, capsys):
    monkeypatch.setattr(sys, 'argv', ['emulator', '--rig', 'nowhere.yaml'])
    with pytest.raises(SystemExit) as ended:
        emulator.main()
    assert ended.value.code == 1
    assert capsys.readouterr().err.startswith('Cannot read the rig file `nowhere.yaml`')


def test_help_shows_an_example():
    assert 'Example: ' in CliRunner().invoke(emulator.app, ['--help']).output


def test_a_rate_of_nothing_is_refused():
    with pytest.raises(ConfigError, match='`rate` must be a positive'):
        CliRunner().invoke(emulator.app, ['--rig', RIG, '--rate', 'nan'], catch_exceptions=False)
