"""Options from a file, progress and JSON."""

import json
import time
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from multiimu_ros.cli import options
from multiimu_ros.errors import ConfigError

app = typer.Typer(add_completion=False)


@app.command()
def verb(
    name: str,
    window_s: Annotated[float, typer.Option()],
    file: options.OptionsFile = None,
):
    typer.echo(f'{name} {window_s}')


def call(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)), catch_exceptions=False).output


def test_options_come_from_a_file_and_the_command_line_wins(tmp_path):
    file = tmp_path / 'options.yaml'
    file.write_text('window-s: 2.5\n')
    assert call('walk', '--options', file) == 'walk 2.5\n'
    assert call('walk', '--options', file, '--window-s', 4) == 'walk 4.0\n'


@pytest.mark.parametrize(
    ('content', 'complaint'),
    [
        ('windw: 2', '`windw` must be one of file, name, window-s'),
        ('just text', '`just text` must be one of'),
        ('a: [', 'must name a YAML file'),
    ],
)
def test_a_wrong_file_is_named(tmp_path, content, complaint):
    file = tmp_path / 'options.yaml'
    file.write_text(content)
    with pytest.raises(ConfigError, match=complaint):
        call('walk', '--options', file)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match='must name a YAML file'):
        call('walk', '--options', tmp_path / 'none.yaml')


def test_names_may_be_repeated_or_joined_by_commas():
    assert options.split_names(['a, b', 'c', '']) == ['a', 'b', 'c']


def test_progress_passes_every_item_on(monkeypatch):
    monkeypatch.setattr(time, 'monotonic', iter(range(10**6)).__next__)
    assert list(options.with_progress(range(5000), 5000, 'Counting')) == list(range(5000))


def test_json_has_null_for_what_is_not_finite(capsys):
    options.print_json({'a': [float('nan'), 1.5], 'b': (float('inf'), 'x')})
    assert json.loads(capsys.readouterr().out) == {'a': [None, 1.5], 'b': [None, 'x']}


def test_a_table_of_nothing_is_only_its_title(capsys):
    options.print_table('IMUs', [])
    options.print_table('Rates', [{'name': 'imu0', 'rate [s]': 62.512345}])
    out = capsys.readouterr().out
    assert 'rate [s]' in out  # not taken for a mark-up
    assert '62.51' in out


def test_a_table_leaves_out_what_is_empty_in_all_rows(capsys):
    rows = [{'name': 'imu0', 'fault': '', 'why': ''}, {'name': 'imu1', 'fault': 'bias', 'why': ''}]
    options.print_table('IMUs', rows)
    out = capsys.readouterr().out
    assert 'fault' in out
    assert 'bias' in out
    assert 'why' not in out
