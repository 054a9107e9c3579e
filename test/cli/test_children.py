"""Child processes end with the verb that started them, and are heard when they die."""

import os
import time

import pytest

from multiimu_ros.cli.children import Children
from multiimu_ros.errors import MultiImuError


@pytest.fixture
def children(tmp_path, monkeypatch):
    """Return children of small modules that the test writes."""
    monkeypatch.setenv('PYTHONPATH', str(tmp_path))
    modules = {
        'sleeper': 'import time\ndef main():\n    time.sleep(60)\n',
        'deaf': 'import signal, time\ndef main():\n'
        '    signal.signal(signal.SIGINT, signal.SIG_IGN)\n    print("deaf", flush=True)\n'
        '    time.sleep(60)\n',
        'mortal': 'def main():\n    print("no such port")\n    return 3\n',
        'quick': 'def main():\n    return 0\n',
        'suicidal': 'import os\ndef main():\n    os.abort()\n',
    }
    for name, text in modules.items():
        (tmp_path / f'{name}.py').write_text(text)
    return Children(tmp_path, {})


def wait_until(condition):
    deadline = time.monotonic() + 10.0
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def gone(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_leaving_ends_every_child(children):
    with children:
        for name in ('sleeper', 'quick'):
            children.start(name, name, [])
        pids = [children.pid(name) for name in ('sleeper', 'quick')]
        assert children.running('sleeper')
    assert all(gone(pid) for pid in pids)


def test_a_child_that_does_not_listen_is_killed(children, monkeypatch):
    monkeypatch.setattr('multiimu_ros.cli.children.PATIENCE', 0.2)
    with children:
        children.start('deaf', 'deaf', [])
        wait_until(lambda: 'deaf' in children.log('deaf').read_text())
        pid = children.pid('deaf')
    assert gone(pid)


def start_and_interrupt(children):
    with children:
        children.start('sleeper', 'sleeper', [])
        raise KeyboardInterrupt


def start_and_watch(children, name):
    with children:
        children.start(name, name, [])
        wait_until(lambda: not children.running(name))


def test_an_exception_ends_the_children_too(children):
    with pytest.raises(KeyboardInterrupt):
        start_and_interrupt(children)
    assert gone(children.pid('sleeper'))


def test_a_child_that_fails_is_quoted(children):
    with pytest.raises(MultiImuError, match=r'`mortal` .* exit code 3.*\n.*no such port'):
        start_and_watch(children, 'mortal')


def test_a_child_that_crashes_without_a_word_is_named(children):
    with pytest.raises(MultiImuError, match=r'signal SIGABRT.*\n.*said nothing'):
        start_and_watch(children, 'suicidal')


def test_a_child_that_is_done_is_not_an_error(children):
    with children:
        children.start('quick', 'quick', [])
        wait_until(lambda: not children.running('quick'))
        children.end('quick')
