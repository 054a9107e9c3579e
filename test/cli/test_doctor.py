"""The verb around the judgement: what it prints, what it returns, and where there is no ROS."""

from contextlib import nullcontext
import json
from types import SimpleNamespace

from heard_imus import heard_imu, N
import numpy as np
import pytest
from rich.console import Console
from typer.testing import CliRunner

from multiimu_ros.cli import doctor
from multiimu_ros.errors import ConfigError
from multiimu_ros.nodes.heard import Complaint, Graph

SOUND = Graph(
    domain_id=7,
    nodes=('/driver', '/fusion'),
    imus=(
        heard_imu(),
        heard_imu('/imu/data', frame_id='base_link', covariances=np.tile(np.eye(3), (N, 3, 1, 1))),
    ),
    odometries={'/odom': 400},
)
TIRED = Graph(domain_id=7, nodes=('/a',), complaints=(Complaint('a: b', 'warning', 'tired'),))
RIG = 'version: 1\nrig: {name: r}\nimus: [{name: imu0, frame_id: imu0_link}]\n'


@pytest.fixture
def call(monkeypatch):
    """Return a function that calls the verb on a graph."""

    def call(graph, *arguments):
        listener = SimpleNamespace(listen=lambda seconds: graph)
        monkeypatch.setattr(doctor, 'import_module', lambda name: listener)
        answer = CliRunner().invoke(doctor.app, list(arguments))
        return answer.exit_code, answer.stdout

    return call


def test_a_sound_graph_is_called_so(call):
    code, text = call(SOUND)
    assert code == 0
    assert text.startswith('ROS_DOMAIN_ID=')
    assert 'Nodes in domain 7: /driver, /fusion' in text
    assert '/odom: 400 messages' in text
    assert text.endswith('Nothing is wrong.\n')


def test_findings_are_counted_and_errors_fail(call):
    code, text = call(TIRED)
    assert code == 1
    assert 'error: graph: nobody publishes a sensor_msgs/Imu; start the driver.\n' in text
    assert 'warning: a: b: tired\n' in text
    assert text.endswith('1 error, 1 warning\n')


def test_people_are_not_shown_more_than_eight_subjects(call):
    complaints = tuple(Complaint(f'imu{k}', 'error', 'stuck') for k in range(10))
    _, text = call(Graph(domain_id=7, nodes=('/a',), complaints=complaints))
    assert 'error: imu0, imu1, imu2, imu3, imu4, imu5, imu6, imu7 and 2 more: stuck\n' in text


def test_machines_get_the_same_as_json(call, tmp_path):
    path = tmp_path / 'rig.yaml'
    path.write_text(RIG)
    code, text = call(SOUND, '--json', '--rig', str(path))
    answer = json.loads(text)
    assert (code, answer['healthy'], answer['findings']) == (0, True, [])
    assert [imu['stage'] for imu in answer['imus']] == ['raw', 'fused']
    assert json.loads(call(TIRED, '--json')[1])['findings'][0]['level'] == 'error'


def test_a_terminal_shows_that_it_listens(call, monkeypatch):
    shown = Console(force_terminal=True, highlight=False)
    monkeypatch.setattr(shown, 'status', lambda text: shown.print(text) or nullcontext())
    monkeypatch.setattr(doctor, 'Console', lambda **how: shown)
    code, text = call(SOUND, '--seconds', '2')
    assert code == 0
    assert text.startswith('Listening for 2 s ...')


def test_without_ros_it_says_what_to_do(monkeypatch):
    def import_module(name):
        raise ModuleNotFoundError(name='rclpy')

    monkeypatch.setattr(doctor, 'import_module', import_module)
    answer = CliRunner().invoke(doctor.app, [])
    assert isinstance(answer.exception, ConfigError)
    assert str(answer.exception) == (
        '`doctor` must have ROS 2, but `rclpy` is missing; source its setup file.'
    )
