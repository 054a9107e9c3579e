"""Every figure draws without a display, and the page holds it all."""

import base64
import io

import numpy as np
from numpy.testing import assert_allclose
from PIL import Image
import pytest
from report_runs import comparison

from multiimu_ros.errors import ConfigError
from multiimu_ros.report import figures, page


def draw(name):
    result = comparison()
    array, single = result.errors['array'], result.errors[result.best('angular_rate')]
    track = result.tracks['array']
    singles = {name: e for name, e in result.scored.items() if name.startswith('imu')}
    ages = np.random.default_rng(0).gamma(6, 4e-4, 500)
    arguments = {
        'scoreboard': (result.rows, singles),
        'rate_and_force_errors': (single, array, track.still, (2.0, 6.0)),
        'spectra': (single, array, 200.0, (7e-5, 1e-3)),
        'attitude': (single, array, track),
        'trajectory': (track, result.truth),
        'position_error': (result.errors, result.best('position_n')),
        'weights': (track, ['imu0', 'imu1', 'imu2']),
        'latency': (ages, {'p50': 0.0023, 'p99': 0.006}),
    }
    return getattr(figures, name)(*arguments[name])


@pytest.mark.parametrize(
    'name',
    [
        'scoreboard',
        'rate_and_force_errors',
        'spectra',
        'attitude',
        'trajectory',
        'position_error',
        'weights',
        'latency',
    ],
)
def test_figure_is_a_picture_as_wide_as_the_others(name):
    image = np.asarray(Image.open(io.BytesIO(draw(name))).convert('L'))
    assert image.shape[1] == round(figures.WIDTH * figures.STYLE['figure.dpi'])
    assert (image < 200).mean() > 0.01  # some ink


def test_white_noise_is_drawn_at_its_density():
    noise = np.random.default_rng(0).normal(scale=0.5 * np.sqrt(200), size=(40000, 3))
    _, density = figures._amplitude(noise, 200.0)
    # 25 windows with overlap and three axes: about 9 % on the lowest points, less above.
    assert_allclose(density[20:], 0.5, rtol=0.1)


def test_the_page_needs_nothing_from_outside(tmp_path):
    path = tmp_path / 'report.html'
    rows = comparison().rows
    sections = [
        page.score_table(rows, 3, 'a note'),
        page.facts({'scans': '12'}),
        page.picture('Path', 'a caption', b'not really a PNG'),
        page.notes('Notes', ['one', 'two']),
    ]
    page.write_page(path, 'A < B', 'lead', sections)
    text = path.read_text(encoding='utf-8')
    assert '<title>A &lt; B</title>' in text
    assert base64.b64encode(b'not really a PNG').decode() in text
    assert 'http' not in text
    assert f'{rows[0].gain:.2f} ×' in text


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    with pytest.raises(ConfigError, match='Cannot write the report'):
        page.write_page(tmp_path / 'no' / 'report.html', 'title', 'lead', [])
