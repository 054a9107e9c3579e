"""The demonstration: live once, and its lines and verdict on made-up figures."""

from dataclasses import replace
import json
from pathlib import Path
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from report_runs import comparison, IMUS, recording
from rich.console import Console
from typer.testing import CliRunner

from multiimu_ros.cli import demo, demo_live
from multiimu_ros.cli.demo_report import Outcome, write_report
from multiimu_ros.errors import ConfigError
from multiimu_ros.report.recorded import Recorded
from multiimu_ros.report.truth import Lateness

IMU_LINES = {f'fusion: imu{k}': {'weight': '0.125'} for k in range(8)}


def outcome(last=None):
    run, rig, _ = recording()
    result = comparison()
    track = result.tracks['array']
    ages = np.random.default_rng(0).gamma(6, 4e-4, len(track))
    return Outcome('hand', 12.0, rig, Recorded(run.raw, track, ages), track, result, last or {})


def test_the_live_line_fits_a_terminal_and_says_it_all():
    figures = {'rate_hz': 199.6, 'still': True, 'age_p50_s': 0.0052, 'age_p99_s': 0.0113}
    line = demo._line(demo_live.Glance(12.3, {**figures, 'figures': IMU_LINES}), 45.0).plain
    for part in ('12 of 45 s', '199.6 Hz', 'still', '▄▄▄▄▄▄▄▄', '5.2 ms', '11.3'):
        assert part in line
    assert len(line) < 80


def test_the_live_line_is_there_before_the_monitor_speaks():
    line = demo._line(demo_live.Glance(0.0, {}), 45.0).plain
    assert 'moving' in line
    assert 'ms' not in line


def test_a_scan_without_fused_message_is_counted():
    whole = outcome()
    track = whole.recorded.track
    hole = track.between(int(track.stamp_ns[0]), int(track.stamp_ns[99]))
    assert whole.unfused == 0
    object.__setattr__(hole, 'stamp_ns', np.delete(track.stamp_ns[:103], [3, 40, 41]))
    object.__setattr__(whole.recorded, 'track', hole)
    assert whole.unfused == 3
    # Another IMU's stamps a little later in the same scans are as good.
    object.__setattr__(hole, 'stamp_ns', np.delete(track.stamp_ns[:103] + 400_000, [3, 40, 41]))
    assert whole.unfused == 3


def test_the_report_tells_how_it_was_measured(tmp_path):
    loads = {f'{name}: node': {'cpu [%]': '12.5'} for name in demo_live.NODES}
    write_report(tmp_path / 'report.html', outcome({'figures': loads}))
    text = (tmp_path / 'report.html').read_text(encoding='utf-8')
    for part in (
        'with hindsight',
        'stamps are late',
        'fusion, % of a core',
        'smaller in attitude',
    ):
        assert part in text
    assert text.count('<img') == 8


def test_a_motion_that_cannot_show_the_lateness_says_so():
    result = outcome()
    blind = replace(result.comparison, lateness=Lateness(0.0, np.inf))
    assert 'cannot show it' in replace(result, comparison=blind).footnote()


def test_machines_get_si_and_people_a_table(capsys):
    result = outcome()
    demo._tell(result, Path('report.html'), Console(), True)
    table = json.loads(capsys.readouterr().out)
    assert table['errors']['angular_rate']['fused'] == pytest.approx(
        result.comparison.rows[0].fused
    )
    assert table['replay_difference'] == 0.0  # here the replay is the recording itself
    assert table['fused_messages'] == len(result.recorded.track)
    demo._tell(result, Path('report.html'), Console(width=80), False)
    text = capsys.readouterr().out
    assert 'specific force [mm/s²]' in text
    assert max(len(line) for line in text.splitlines()) <= 80


def test_a_defeat_is_said_in_one_sentence(capsys, monkeypatch):
    monkeypatch.setattr(demo, 'not_won', lambda _rows: ('attitude',))
    demo._tell(outcome(), Path('report.html'), Console(width=80), False)
    assert 'did not beat its best IMU in attitude' in capsys.readouterr().out


def test_what_does_not_exist_is_refused_before_anything_starts(tmp_path):
    result = CliRunner().invoke(demo.app, ['--motion', 'dance', '-o', str(tmp_path / 'out')])
    assert isinstance(result.exception, ConfigError)
    assert not (tmp_path / 'out').exists()


@pytest.mark.ros
@pytest.mark.slow
def test_the_demo_runs_live(tmp_path):
    result = CliRunner().invoke(
        demo.app, ['--duration', '12', '-o', str(tmp_path), '--keep', '--json']
    )
    # Twelve seconds are too few to promise a victory, which is what the exit code says.
    assert result.exit_code in (0, 1), result.exception
    table = json.loads(result.stdout)
    assert table['scans_without_fused_message'] < 10  # a busy machine may stall once
    # A topic that is served later than the first half second is given up, live but not again.
    if table['scans_without_fused_message'] == 0 and table['age_p99_s'] < 0.4:
        assert table['replay_difference'] < 1e-9  # rounding: matrices are multiplied in batches
    rate = table['errors']['angular_rate']
    assert rate['fused'] < rate['best_single']
    assert (tmp_path / 'report.html').stat().st_size > 100_000
    assert (tmp_path / 'run' / 'bag' / 'metadata.yaml').exists()
    assert IMUS < demo_live.IMUS  # the other tests make do with fewer


@pytest.mark.ros
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_demo_leaves_no_process_behind(tmp_path, number):
    call = 'from multiimu_ros.cli.demo import app; app()'
    process = subprocess.Popen(
        [sys.executable, '-c', call, '-o', str(tmp_path), '--keep'],
        stdout=subprocess.PIPE,
        text=True,
    )
    logs = tmp_path / 'run' / 'logs'
    deadline = time.monotonic() + 30.0
    while not (logs / 'monitor.log').exists():
        assert time.monotonic() < deadline
        time.sleep(0.1)
    time.sleep(1.0)
    process.send_signal(number)
    out, _ = process.communicate(timeout=20.0)
    assert process.returncode == 130
    assert 'all processes have ended' in out
    assert not commands_with(str(tmp_path))


def commands_with(text):
    """Return the processes whose command line holds a text."""
    found = []
    for path in Path('/proc').glob('[0-9]*/cmdline'):
        try:
            command = path.read_bytes().decode(errors='replace')
        except OSError:
            continue  # it has just ended
        if text in command:
            found.append(command)
    return found
