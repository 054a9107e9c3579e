"""How a node ends, and what it says about the parameters it was given; plain kill and wait."""

import signal
import time

import pytest
from ros_helpers import node_process

pytestmark = pytest.mark.ros

RIG = """
version: 1
rig: {name: one}
imus: [{name: imu0, frame_id: imu0_link}]
"""


@pytest.fixture
def rig_file(tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text(RIG)
    return path


def wait_for_text(process, text, timeout_s=10.0):
    end = time.monotonic() + timeout_s
    while text not in process.text:
        assert time.monotonic() < end, f'{text!r} is not in {process.text!r}'
        time.sleep(0.05)


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_a_node_with_exit_code_0(rig_file, number):
    with node_process('registration', rig_file=rig_file) as process:
        wait_for_text(process, 'nominal')
        time.sleep(0.5)
        code, seconds = process.end(number)
    assert code == 0
    assert seconds < 1.0  # 0.2 s on an idle machine
    assert 'Traceback' not in process.text


def test_a_node_that_compiles_its_kernels_says_so_and_can_be_interrupted(
    rig_file, tmp_path, monkeypatch
):
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))  # nothing is compiled there yet
    with node_process('fusion', rig_file=rig_file) as process:
        wait_for_text(process, 'Compiling', timeout_s=20.0)
        code, seconds = process.end(signal.SIGINT)
        assert code == 0
        assert seconds < 5.0  # the longest single compilation is a few seconds, of 30 in all
        assert 'Traceback' not in process.text


def test_a_rig_that_leaves_blocks_nominal_is_named(rig_file):
    with node_process('calibration', rig_file=rig_file) as process:
        wait_for_text(process, 'leaves imus[0].intrinsics, imus[0].noise, imus[0].extrinsics')


def test_unknown_parameters_are_named(rig_file):
    with node_process('calibration', rig_file=rig_file, rig_flie='x') as process:
        wait_for_text(process, 'Ignored `rig_flie`: no such parameter')


def test_a_parameter_file_for_another_node_is_named(rig_file, tmp_path):
    path = tmp_path / 'params.yaml'
    path.write_text('/ns/fusion:\n  ros__parameters: {publish_tf: true}\n')
    with node_process('calibration', '--params-file', str(path), rig_file=rig_file) as process:
        wait_for_text(process, f'`{path}` sets nothing for /calibration')


def test_a_missing_parameter_file_is_one_sentence():
    with node_process('calibration', '--params-file', '/nowhere.yaml') as process:
        assert process.wait() == 1
        assert 'The ROS arguments are wrong' in process.text
        assert 'Traceback' not in process.text


def test_a_parameter_of_the_wrong_type_is_one_sentence(rig_file):
    with node_process('calibration', rig_file=rig_file, topics='3') as process:
        assert process.wait() == 1
        assert 'Parameter `topics` must be a list of str, got 3' in process.text
