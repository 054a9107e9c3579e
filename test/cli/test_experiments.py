"""`multiimu experiments`: what it prints, writes and refuses."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from multiimu_ros.cli import experiments as verb
from multiimu_ros.errors import ConfigError
from multiimu_ros.report.experiment_figures import Boxes, Line, Panel, Picture
from multiimu_ros.report.experiment_page import in_words, Result, Table


def quick(seed, progress):
    """Find something small, with a curve and boxes."""
    progress(1.0)
    x = np.arange(1.0, 4.0)
    panel = Panel(
        title='t',
        x_label='x',
        y_label='y',
        lines=(Line(label='a', x=x, y=x), Line(label='', x=x, y=x, role='ideal', dashed=True)),
        names={'here': (1.0, 2.0)},
        log_x=True,
        log_y=True,
        y_limits=(0.5, 9.0),
        x_ticks=(1.0, 2.0),
    )
    boxes = Boxes(title='b', y_label='y', values={'s': x}, roles=('array',), marks={'s': 2.0})
    return Result(
        name='quick',
        title='Fish & chips',
        source='Table 7',
        question='Why?',
        answer=f'Because of {seed}.',
        setting='A kitchen.',
        seed=seed,
        tables=(Table(title='menu', rows=({'': 'cod', 'paper': float('nan'), 'ours': 2.0},)),),
        pictures=(Picture(title='p', caption='a < b', panels=(panel, boxes, panel)),),
        differs=('It is fried.',),
    )


@pytest.fixture
def two(monkeypatch):
    monkeypatch.setattr(verb, 'EXPERIMENTS', {'quick': quick, 'again': quick})


def run(*arguments):
    return CliRunner().invoke(verb.app, [str(a) for a in arguments], catch_exceptions=False)


@pytest.mark.usefixtures('two')
def test_all_experiments_are_printed_and_written_as_one_page(tmp_path):
    text = run('-o', tmp_path / 'out', '--seed', 7).stdout
    assert text.count('Because of 7.') == 2
    assert 'multiimu experiments quick --seed 7' in text
    assert '–' in text  # what the paper does not say is no number
    page = (tmp_path / 'out' / 'experiments.html').read_text(encoding='utf-8')
    assert page.count('data:image/png;base64') == 2
    assert 'Fish &amp; chips' in page
    assert 'a &lt; b' in page


@pytest.mark.usefixtures('two')
def test_one_experiment_as_json_has_null_where_the_paper_has_nothing(tmp_path):
    found = json.loads(run('quick', '-o', tmp_path, '--json').stdout)
    assert list(found) == ['quick']
    assert found['quick']['tables'] == {'menu': [{'': 'cod', 'paper': None, 'ours': 2.0}]}


@pytest.mark.usefixtures('two')
def test_an_unknown_experiment_is_refused_with_the_known_ones(tmp_path):
    with pytest.raises(ConfigError, match='`name` must be one of quick, again, got `soup`'):
        run('soup', '-o', tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_numbers_are_shown_with_three_digits_and_thousands_in_full():
    shown = [in_words(value) for value in (0.012345, 12.3456, 1610.4, float('nan'), 'went on')]
    assert shown == ['0.0123', '12.3', '1610', '–', 'went on']
