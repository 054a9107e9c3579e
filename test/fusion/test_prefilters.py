"""The filters by frequency against the printed recursions, their lag, and IMUs that drop out."""

from importlib.util import find_spec

from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion import prefilters
from multiimu_ros.fusion.prefilters import prefilter_series, ScanPrefilter, smoothing

RATE = {'cutoff_hz': 5.0, 'rate_hz': 200.0}
CAUSAL = ['none', 'low_pass', 'high_pass', 'complementary']
HAS_WAVELETS = pytest.mark.skipif(find_spec('pywt') is None, reason='PyWavelets is an extra')
WAVELET = pytest.param('wavelet', marks=HAS_WAVELETS)
SCANS = {'none': 1, 'low_pass': 1, 'high_pass': 1, 'complementary': 1, 'wavelet': 33}


def stream(kind, values):
    """Push (N, K, 6) values one by one."""
    one = ScanPrefilter(kind, values.shape[1], **RATE)
    return np.array([one.push(scan) for scan in values]), one.lag_s


def test_the_low_pass_is_the_printed_recursion(rng):
    z = rng.standard_normal((50, 2, 6))
    tau, dt = 1.0 / (2.0 * np.pi * 5.0), 1.0 / 200.0
    alpha = tau / (tau + dt)  # (5.55)
    w = [z[0]]
    for reading in z[1:]:
        w.append(alpha * w[-1] + (1.0 - alpha) * reading)  # (5.53)
    assert_allclose(prefilter_series('low_pass', z, **RATE), w, atol=1e-12)
    assert alpha * dt / (1.0 - alpha) == pytest.approx(tau, rel=1e-12)  # (5.54)


def test_the_high_pass_is_the_reading_without_the_low_pass(rng):
    z = rng.standard_normal((50, 2, 6))
    low = prefilter_series('low_pass', z, **RATE)
    assert_allclose(prefilter_series('high_pass', z, **RATE), z - low, atol=1e-12)  # (5.56)


def test_a_constant_passes_the_high_pass_as_nothing():
    assert_allclose(stream('high_pass', np.full((20, 1, 6), 9.81))[0], 0.0, atol=1e-12)


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(CAUSAL))
@settings(max_examples=30)
def test_stream_agrees_with_batch_whoever_drops_out(seed, kind):
    rng = np.random.default_rng(seed)
    z = rng.standard_normal((60, 3, 6))
    z[rng.random((60, 3)) < 0.2] = np.nan
    assert_allclose(stream(kind, z)[0], prefilter_series(kind, z, **RATE), atol=1e-12)


@pytest.mark.parametrize('kind', ['low_pass', 'complementary', WAVELET])
def test_a_slow_motion_is_as_late_as_stated(kind):
    t = np.arange(800) / 200.0
    z = np.sin(2.0 * np.pi * 0.25 * t)[:, None, None] * np.ones((1, 2, 6))
    filtered, lag_s = stream(kind, z)
    late = np.sin(2.0 * np.pi * 0.25 * (t - lag_s))[:, None, None]
    # 1/20 of the cutoff: the lag of a one-pole differs there by (1/20)^2 / 3, its size by half
    # that square; the wavelets keep cubics, and shrink what is left of a sine by less.
    assert_allclose(filtered[200:, :, :3], (late * np.ones((1, 2, 3)))[200:], atol=2e-3)


def test_what_all_feel_passes_the_complementary_filter_as_it_is(rng):
    common = rng.standard_normal((100, 1, 3))  # white: up to half the rate
    own = np.array([0.3, -0.1, -0.2])[:, None]
    z = np.concatenate([common + own, rng.standard_normal((100, 3, 3))], axis=2)
    filtered = stream('complementary', z)[0]
    assert_allclose(filtered, z, atol=1e-12)  # a constant of its own passes the low pass, too


def test_the_complementary_filter_slows_what_one_imu_reads_alone(rng):
    z = np.zeros((4000, 4, 6))
    z[:, 0, 0] = rng.standard_normal(4000)
    filtered = stream('complementary', z)[0][200:, 0, 0]
    alpha = smoothing('complementary', **RATE)
    # High pass of a quarter of it and low pass of all: white noise through both, by their sums.
    # h_0 = alpha / 4 + 1 - alpha, h_n = alpha h_(n-1) - [n = 1] alpha / 4, squares added up.
    first = alpha / 4.0 + 1.0 - alpha
    second = alpha * first - alpha / 4.0
    power = first**2 + second**2 / (1.0 - alpha**2)
    # Standard error of a variance from 3800 samples that are alike for few: 2.3 %; four of them.
    assert filtered.var() == pytest.approx(power, rel=0.1)


def test_nobody_jumps_when_an_imu_with_another_bias_leaves():
    z = np.zeros((100, 3, 6)) + np.array([0.0, 0.1, 5.0])[:, None]
    z[50:70, 2] = np.nan
    filtered = stream('complementary', z)[0]
    assert_allclose(filtered, z, atol=1e-12)


@pytest.mark.parametrize('kind', [*CAUSAL, WAVELET])
def test_an_imu_without_readings_has_none_and_begins_anew(kind, rng):
    z = 9.0 + rng.standard_normal((200, 2, 6))
    z[100:110, 1] = np.nan
    filtered = stream(kind, z)[0]
    assert np.isnan(filtered[100:110, 1]).all()
    fresh = stream(kind, z[110:])[0]
    quiet = SCANS[kind] - 1  # the wavelets are silent for their lag: two periods of 2^4 scans
    assert np.isnan(filtered[110 : 110 + quiet, 1]).all()
    ready = 110 + quiet
    if kind != 'complementary':  # which knows the change of the others
        assert_allclose(filtered[ready:, 1], fresh[quiet:, 1], atol=1e-12)
    assert np.isfinite(filtered[ready:]).all()
    assert np.isfinite(filtered[SCANS[kind] :, 0]).all()


@HAS_WAVELETS
def test_wavelets_take_most_of_the_noise_and_none_of_the_motion(rng):
    t = np.arange(1000) / 200.0
    truth = 3.0 * np.sin(2.0 * np.pi * 0.5 * t)
    z = truth[:, None, None] + 0.1 * rng.standard_normal((1000, 3, 6))
    error = prefilter_series('wavelet', z, **RATE)[100:-100] - truth[100:-100, None, None]
    # Four octaves of details gone: a sixteenth of the power of white noise is left, 1/4 in rms.
    # A few details pass the threshold.
    assert 0.02 < error.std() < 0.03
    filtered, lag_s = stream('wavelet', z)
    late = round(200.0 * lag_s)
    error = (filtered[late:] - truth[:-late, None, None])[200:]
    assert error.std() < 0.05  # near the window's edge the smooth part is known half as well


def test_missing_wavelets_and_bad_cutoffs_are_named(monkeypatch):
    with pytest.raises(ConfigError, match=r'`cutoff_hz` must be between 0 and 100.*got 100'):
        ScanPrefilter('low_pass', 2, cutoff_hz=100.0, rate_hz=200.0)
    with pytest.raises(ConfigError, match=r"`prefilter` must be one of none, .*got 'median'"):
        ScanPrefilter('median', 2, **RATE)

    def lacks(name):
        raise ImportError(name)

    monkeypatch.setattr(prefilters, 'import_module', lacks)
    with pytest.raises(ConfigError, match='pip install PyWavelets'):
        ScanPrefilter('wavelet', 2, **RATE)
