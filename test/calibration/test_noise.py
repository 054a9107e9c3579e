"""From samples of a resting IMU to the noise block of the rig file and kalibr's form."""

from functools import cache

from noise_series import five_terms
import numpy as np
from numpy.testing import assert_allclose
import pytest
import realdata
import yaml

from multiimu_ros.calibration import noise
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig import Intrinsics
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.errors import apply_errors, BMI160, draw_noise

RATE, COUNT = 200.0, 120000
STAMPS = 10**18 + 5_000_000 * np.arange(COUNT)
UP = np.tile([0.0, 0.0, 9.81], (COUNT, 1))


@cache
def ten_minutes():
    rng = np.random.default_rng(8)
    rate, force = (
        draw_noise(COUNT, RATE, errors, rng) for errors in (BMI160.gyroscope, BMI160.accelerometer)
    )
    return noise.fit_noise(ImuSamples(STAMPS, rate + 0.01, force + UP))


def slow(scale, seed, walks=(1.0, 1.0, 1.0)):
    """Return an hour at 1 Hz of white noise, flicker and random walk, the last one by axis."""
    rng, axes = np.random.default_rng(seed), []
    for k, walk in enumerate(walks):
        values = five_terms(1 << 14, 1.0, 0, 1.0, 0.3, 0.03 * walk, 0, rng)
        axes.append(scale * values[:, k])
    return np.column_stack(axes)


def test_the_densities_of_a_data_sheet_come_back():
    block = ten_minutes().noise
    for triad in noise.TRIADS:
        density = getattr(block.noise_density, triad)
        # 0.3 % is what ten minutes are worth; four of them.
        assert_allclose(density, getattr(BMI160, triad).noise_density, rtol=0.015)
        sigma = np.array(getattr(block.noise_density_sigma, triad))
        assert (sigma < 0.005 * np.array(density)).all()
        assert (sigma > 0.002 * np.array(density)).all()  # (2 N)^-1/2 = 0.2 % is the least


def test_quantisation_by_the_converter_counts_as_white_noise():
    rng = np.random.default_rng(9)
    raw = apply_errors(0 * UP, UP, RATE, BMI160, Intrinsics(), rng=rng)
    block = noise.fit_noise(ImuSamples(STAMPS, *raw)).noise
    for triad in noise.TRIADS:
        errors = getattr(BMI160, triad)
        # A step of 1 has a variance of 1/12, spread over the rate.
        expected = np.hypot(errors.noise_density, errors.step / np.sqrt(12 * RATE))
        assert_allclose(getattr(block.noise_density, triad), expected, rtol=0.015)


def test_what_is_not_known_stays_out_of_the_block():
    block = ten_minutes().noise
    # A BMI160's bias walks so little that ten minutes cannot show it.
    assert block.bias_random_walk is None
    assert block.bias_random_walk_sigma is None
    gyroscope = ten_minutes().gyroscope
    assert all(np.isnan(term.value) for term in gyroscope.axes('K'))
    assert all(term.high >= BMI160.gyroscope.bias_random_walk for term in gyroscope.axes('K'))
    assert all(term.needed_s >= 1200 for term in gyroscope.axes('K'))


def test_flicker_and_random_walk_are_two_figures():
    stamps = 10**18 + 10**9 * np.arange(1 << 14)
    record = noise.RestingRecord(ImuSamples(stamps, slow(1, 1), slow(1, 2)), 1.0, 0)
    model = noise.NoiseModel(
        record,
        noise.triad_noise(record.samples.angular_rate, 1.0),
        noise.triad_noise(100 * record.samples.specific_force, 1.0),
    )
    block = model.noise
    # Here both stand out: B to about a fifth, K to about a fifth, on each of six axes.
    for triad, scale in (('gyroscope', 1.0), ('accelerometer', 100.0)):
        assert_allclose(getattr(block.bias_instability, triad), 0.3 * scale, rtol=0.8)
        assert_allclose(getattr(block.bias_random_walk, triad), 0.03 * scale, rtol=0.8)
    assert_allclose(np.mean(block.bias_random_walk.gyroscope), 0.03, rtol=0.35)
    assert_allclose(np.mean(block.bias_instability.gyroscope), 0.3, rtol=0.35)


def test_three_axes_tell_together_what_one_cannot():
    # Flicker of 0.11 is about two sigmas on one axis of this length, and three on three.
    told_alone, told_together = 0, 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        triad = noise.triad_noise(five_terms(6000, 1.0, 0, 1.0, 0.11, 0, 0, rng), 1.0)
        told_alone += sum(fit.terms['B'].determined for fit in triad.fits) / 3
        told_together += triad.together('B').determined
        if triad.together('B').determined and not triad.fits[0].terms['B'].determined:
            assert triad.axes('B')[0] == triad.together('B')
    assert told_together > 1.3 * told_alone


def test_an_axis_that_differs_is_not_averaged_into_the_others():
    triad = noise.triad_noise(slow(1.0, 3, walks=(30.0, 0.0, 0.0)), 1.0)
    x, y, z = triad.axes('K')
    assert_allclose(x.value, 0.9, rtol=0.2)
    # y and z walk not at all: together they must not be said to walk like x.
    for term in (y, z):
        assert not term.determined
        assert term.high < 0.1


def test_the_common_figure_is_the_root_mean_square():
    triad = ten_minutes().gyroscope
    values = [fit.terms['N'].value for fit in triad.fits]
    together = triad.together('N')
    # Bounds at zero of other terms move the axes by less than their sigmas.
    assert_allclose(together.value, np.sqrt(np.mean(np.square(values))), rtol=0.005)
    sigma = np.sqrt(np.mean([fit.terms['N'].sigma ** 2 for fit in triad.fits]) / 3)
    assert_allclose(together.sigma, sigma, rtol=0.01)


def test_kalibr_reads_its_keys_and_nothing_invented():
    text = noise.kalibr_yaml(ten_minutes(), '/imu0/data_raw')
    content = yaml.safe_load(text)
    assert content['rostopic'] == '/imu0/data_raw'
    assert_allclose(content['update_rate'], RATE)
    assert_allclose(content['gyroscope_noise_density'], BMI160.gyroscope.noise_density, rtol=0.01)
    accelerometer = content['accelerometer_noise_density']
    assert_allclose(accelerometer, BMI160.accelerometer.noise_density, rtol=0.01)
    assert 'gyroscope_random_walk' not in content
    assert '# gyroscope_random_walk: 600 s do not tell it; at most' in text


def test_kalibr_gets_the_random_walk_and_not_the_instability():
    values = slow(1.0, 4)
    record = noise.RestingRecord(ImuSamples(10**9 * np.arange(1 << 14), values, values), 1.0, 0)
    triad = noise.triad_noise(values, 1.0)
    content = yaml.safe_load(noise.kalibr_yaml(noise.NoiseModel(record, triad, triad), '/imu'))
    assert_allclose(content['gyroscope_random_walk'], 0.03, rtol=0.4)  # not 0.3


def test_the_two_sided_spectrum_of_white_noise_is_its_density_squared(rng):
    density = noise.spectrum(0.5 * np.sqrt(RATE) * rng.standard_normal((40000, 3)), RATE)
    # 31 pieces, overlapping, 1250 frequencies: 0.6 % on the mean.
    assert_allclose(density.two_sided.mean(), 0.25, rtol=0.02)
    assert_allclose(density.one_sided, 2 * density.two_sided)
    assert density.frequency[0] > 0
    assert_allclose(density.frequency[-1], RATE / 2)


@pytest.mark.parametrize('key', ['angular_rate', 'specific_force'])
def test_a_stuck_axis_is_refused(rng, key):
    values = {
        'angular_rate': 0.002 * rng.standard_normal((20000, 3)),
        'specific_force': 0.02 * rng.standard_normal((20000, 3)) + [0.0, 0.0, 9.81],
    }
    values[key][:, 1] = 0.125
    with pytest.raises(CalibrationError, match=f'`{key}` of `imu3` must vary, but y is constant'):
        noise.fit_noise(ImuSamples(STAMPS[:20000], **values), 'imu3')


@pytest.mark.realdata
def test_the_rest_of_a_real_recording_is_found_and_its_noise_agrees_with_its_spectrum():
    folder = realdata.data_set('imu_tk_xsens')
    acc, gyro = (np.loadtxt(folder / f'xsens_{name}.mat') for name in ('acc', 'gyro'))
    stamps = np.round(1e9 * acc[:, 0]).astype(np.int64)
    # Counts per SI from the factory sheet; the means over the axes will do.
    samples = ImuSamples(stamps, (gyro[:, 1:] - 32768) / 4767, (acc[:, 1:] - 32768) / 414)
    model = noise.fit_noise(samples, 'xsens', least_s=45.0)
    assert 45 < model.record.duration < 51  # the protocol rests for 50 s at first
    values = model.record.samples.angular_rate
    density = noise.spectrum(values, model.record.rate_hz)
    low = (density.frequency > 1) & (density.frequency < 10)  # below the filter, above the drift
    assert_allclose(
        model.noise.noise_density.gyroscope,
        np.sqrt(density.two_sided[low].mean(axis=0)),
        rtol=0.08,  # 45 s of it are good to 3 %, the fit to 2 %
    )
