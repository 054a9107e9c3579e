"""The executables end with code 0 and without a word, whenever a signal comes."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

import pytest

from multiimu_ros.cli import executables

pytestmark = pytest.mark.ros
SCRIPTS = Path(sys.executable).parent
RIG = Path(__file__).parents[2] / 'config/row3.yaml'
ARGUMENTS = {
    'emulator': ['--rig', RIG, '--motion', 'static'],
    'driver': ['--ros-args', '-p', 'port:=/nowhere'],
    'fusion': ['--ros-args', '-p', f'rig_file:={RIG}'],
}


def start(name):
    command = [SCRIPTS / name, *ARGUMENTS[name]]
    return subprocess.Popen(
        command,
        env=os.environ | {'MULTIIMU_COMPILED': '1'},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )


# While Python starts (0.1 s), while rclpy and numba are imported, while the node is made.
@pytest.mark.parametrize('delay', [0.25, 0.6, 1.2])
@pytest.mark.parametrize('name', ARGUMENTS)
def test_a_signal_during_the_start_ends_it_quietly(name, delay):
    process = start(name)
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 0, said
    assert 'Traceback' not in said


def test_a_second_signal_on_the_way_out_changes_nothing():
    process = start('driver')
    time.sleep(2.0)
    for _ in range(30):  # a terminal and `ros2 launch` send two; here they cover the whole way
        process.send_signal(signal.SIGINT)
        time.sleep(0.01)
    _, said = process.communicate(timeout=20)
    assert process.returncode == 0, said


def test_an_executable_runs_the_program_of_its_name(monkeypatch):
    before = [signal.getsignal(number) for number in executables.SIGNALS]
    monkeypatch.setattr(sys, 'argv', ['/anywhere/emulator', '--help'])
    with pytest.raises(SystemExit) as ended:
        executables.main()
    assert ended.value.code == 0
    assert [signal.getsignal(number) for number in executables.SIGNALS] == [signal.SIG_IGN] * 2
    for number, handler in zip(executables.SIGNALS, before, strict=True):
        signal.signal(number, handler)
