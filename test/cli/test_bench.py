"""`multiimu bench` runs the checkout's benchmarks, or says that there are none."""

import pytest
from typer.testing import CliRunner

from multiimu_ros.cli import bench
from multiimu_ros.errors import ConfigError


def test_it_hands_its_arguments_on(capfd):
    result = CliRunner().invoke(bench.app, ['--help'])
    assert result.exit_code == 0
    assert '--load' in capfd.readouterr().out


def test_without_a_checkout_it_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(bench.multiimu_ros, '__file__', str(tmp_path / 'lib' / '__init__.py'))
    with pytest.raises(ConfigError, match='must run in a checkout'):
        CliRunner().invoke(bench.app, [], catch_exceptions=False)
