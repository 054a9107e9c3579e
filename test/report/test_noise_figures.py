"""The figures and sections of the noise of one IMU."""

from functools import cache
import io

import numpy as np
from numpy.testing import assert_allclose
from PIL import Image
import pytest

from multiimu_ros.calibration.noise import fit_noise, spectrum
from multiimu_ros.report import figures, noise_figures, noise_page
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.errors import BMI160, draw_noise

RATE = 100.0


@cache
def model():
    rng, count = np.random.default_rng(2), 12000
    stamps = 10**18 + 10_000_000 * np.arange(count)
    rate = draw_noise(count, RATE, BMI160.gyroscope, rng)
    force = draw_noise(count, RATE, BMI160.accelerometer, rng)
    return fit_noise(ImuSamples(stamps, rate, force + np.array([0.0, 0.0, 9.81])))


@pytest.mark.parametrize('triad', noise_figures.SHOWN)
@pytest.mark.parametrize('name', ['allan_deviation', 'power_density', 'correlogram'])
def test_figure_is_a_picture_as_wide_as_the_others(name, triad):
    noise, values = model().triad(triad), model().record.samples.angular_rate
    arguments = {
        'allan_deviation': (noise, triad),
        'power_density': (spectrum(values, RATE), noise, triad),
        'correlogram': (values, triad),
    }
    png = getattr(noise_figures, name)(*arguments[name])
    image = np.asarray(Image.open(io.BytesIO(png)).convert('L'))
    assert image.shape[1] == round(figures.WIDTH * figures.STYLE['figure.dpi'])
    assert (image < 200).mean() > 0.01  # some ink


@pytest.fixture
def painted(monkeypatch):
    """Return a function that draws a figure and returns its axes instead of a PNG."""
    from matplotlib.figure import Figure

    def paint(name, *arguments):
        kept = []

        def keep(painter, height):
            figure = Figure()
            painter(figure)
            kept.append(figure)
            return b''

        monkeypatch.setattr(noise_figures, 'draw', keep)
        getattr(noise_figures, name)(*arguments)
        return kept[0].axes

    return paint


def test_axes_and_told_terms_are_drawn_where_they_are(painted):
    (axes,) = painted('allan_deviation', model().gyroscope, 'gyroscope')
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert list(lines)[:4] == ['x', 'y', 'z', 'N: white noise']
    assert 'R: ramp' not in lines  # two minutes tell of no ramp
    curve, per_si = model().gyroscope.curve, 1e3 * 180 / np.pi
    assert_allclose(lines['y'].get_ydata(), per_si * curve.deviation[:, 1])
    tau, white = lines['N: white noise'].get_data()
    density = model().gyroscope.together('N').value
    assert len(tau) > 100  # of 200: the rest is below the figure
    assert_allclose(white * np.sqrt(tau), per_si * density)
    assert axes.get_ylabel() == 'angular rate [mdeg/s]'
    assert axes.get_xlabel().endswith('[s]')


def test_spectrum_and_fit_agree_on_white_noise(painted):
    values = model().record.samples.specific_force
    density = spectrum(values, RATE)
    (axes,) = painted('power_density', density, model().accelerometer, 'accelerometer')
    lines = {line.get_label(): line for line in axes.get_lines()}
    drawn, fitted = lines['x'].get_ydata(), lines['N: white noise'].get_ydata()[0]
    # Two routes to one density: the upper decade is good to 1 %, the fit of two minutes to 1 %.
    assert_allclose(np.median(drawn[-15:]), fitted, rtol=0.04)


def test_a_spectrum_keeps_its_power_when_it_is_thinned():
    frequency = np.arange(1, 10001) / 100
    thin, power = noise_figures.by_decades(frequency, np.tile([[2.0, 3.0, 4.0]], (10000, 1)))
    assert_allclose(power, np.tile([[2.0, 3.0, 4.0]], (len(thin), 1)))
    assert len(thin) <= 4 * noise_figures.DECADE + 1
    assert (np.diff(thin) > 0).all()


def test_figures_are_in_the_units_of_data_sheets():
    rows = noise_page.noise_rows(model(), 'gyroscope')
    assert [row['gyroscope'] for row in rows] == ['x', 'y', 'z']
    assert list(rows[0])[1:] == [
        'noise density [deg/s/√Hz]',
        'bias instability [deg/h]',
        'bias random walk [deg/h/√h]',
    ]
    value, sigma = map(float, rows[0]['noise density [deg/s/√Hz]'].split(' ± '))
    assert_allclose(value, 0.007, rtol=0.04)  # of the BMI160's data sheet
    assert 0 < sigma < 0.0002
    rows = noise_page.noise_rows(model(), 'accelerometer')
    assert_allclose(float(rows[2]['noise density [µg/√Hz]'].split()[0]), 180, rtol=0.04)
    # 1 rad/s/sqrt(s) is 180/pi * 3600 deg/h a root second, of which an hour has 60.
    walk = noise_page.UNITS['gyroscope']['bias_random_walk'].per_si
    assert_allclose(walk, 180 / np.pi * 3600 * 60)
    walk = noise_page.UNITS['accelerometer']['bias_random_walk'].per_si
    assert_allclose(walk, 60 / 9.80665e-6)


def test_what_is_not_told_is_said_with_the_length_that_would():
    rows = noise_page.noise_rows(model(), 'gyroscope')
    assert rows[0]['bias random walk [deg/h/√h]'].startswith('< ')
    sentences = noise_page.untold(model())
    assert any('2 min of rest do not tell the bias random walk' in text for text in sentences)
    assert all('at least' in text for text in sentences)
    assert [noise_page.duration(s) for s in (59, 119, 150, 7200)] == [
        '59 s',
        '119 s',
        '2.5 min',
        '2 h',
    ]


def test_sections_hold_tables_pictures_and_hints():
    sections = noise_page.noise_sections('imu0', model())
    assert len(sections) == 7
    assert sections[0].count('<table>') == 2
    assert all('data:image/png;base64' in section for section in sections[1:])
    assert 'white' in sections[3]  # what the samples of a BMI160 look like
