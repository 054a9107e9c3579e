"""The detector against the published formula, its own promises, and bad input."""

from dataclasses import replace

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, kstest

from multiimu_ros.odometry import zero_velocity as zv

CONFIG = zv.GlrtConfig(
    angular_rate_sigma=0.002,
    specific_force_sigma=0.02,
    resting_rate_sigma=0.002,
    resting_force_sigma=0.02,
)
W = zv.SHORTEST
DT = 0.005
SILENT = np.zeros(3)


def still_rig(rng, n):
    """Return (n, 3) angular rate and specific force of a resting, tilted, noisy sensor."""
    up = Rotation.from_euler('xyz', [20, -35, 60], degrees=True).apply([0, 0, CONFIG.gravity])
    noise = rng.standard_normal((2, n, 3))
    return CONFIG.angular_rate_sigma * noise[0], up + CONFIG.specific_force_sigma * noise[1]


def flags(config, rate, force, dt=DT):
    """Return the (N, 2) verdicts of the stream, its noise being all in the config."""
    detector = zv.StillnessDetector(config)
    pushes = zip(rate, force, strict=True)
    return np.array([detector.push(dt, w, f, SILENT, SILENT) for w, f in pushes])


def test_statistic_equals_the_published_sum(rng):
    rate, force = rng.standard_normal((2, W, 3))
    mean = force.mean(axis=0)
    misfit = force - CONFIG.gravity * mean / np.linalg.norm(mean)
    published = np.sum(rate**2) / 0.002**2 / W + np.sum(misfit**2) / 0.02**2 / W
    # One number by two routes: only rounding may differ.
    assert_allclose(zv.glrt_statistic(rate, force, CONFIG), [published], rtol=1e-12)


def test_statistic_with_a_constant_error_is_the_marginal_likelihood(rng):
    config = replace(CONFIG, rate_bias_sigma=0.01)
    rate = 0.01 * rng.standard_normal((W, 3))
    covariance = 0.002**2 * np.eye(W) + 0.01**2 * np.ones((W, W))
    # -2 log likelihood of W correlated samples, docs/derivations/zupt.md (4).
    published = sum(axis @ np.linalg.solve(covariance, axis) for axis in rate.T) / W
    _, force = still_rig(rng, W)
    force_part = zv.glrt_statistic(np.zeros((W, 3)), force, config)
    statistic = zv.glrt_statistic(rate, force, config) - force_part
    assert_allclose(statistic, [published], rtol=1e-9)


@pytest.mark.parametrize(('rate_bias', 'force_error'), [(0.0, 0.0), (0.01, 0.1)])
def test_statistic_at_rest_follows_chi_squared(rng, rate_bias, force_error):
    n = 2000
    config = replace(CONFIG, rate_bias_sigma=rate_bias, force_magnitude_sigma=force_error)
    rate, force = still_rig(rng, n * W)
    rate += np.repeat(rate_bias * rng.standard_normal((n, 3)), W, axis=0)
    longer = 1 + np.repeat(force_error * rng.standard_normal(n), W) / CONFIG.gravity
    disjoint = zv.glrt_statistic(rate, force * longer[:, None], config)[::W]
    # The seed is fixed: the right law fails one seed in a thousand, a wrong law nearly all.
    assert kstest(W * disjoint, chi2(6 * W - 2).cdf).pvalue > 1e-3


@given(seed=st.integers(0, 2**32 - 1))
def test_statistic_does_not_depend_on_the_mounting(seed):
    rng = np.random.default_rng(seed)
    turn = Rotation.from_quat(rng.standard_normal(4))
    rate, force = rng.standard_normal((2, 30, 3))
    turned = zv.glrt_statistic(turn.apply(rate), turn.apply(force), CONFIG)
    assert_allclose(turned, zv.glrt_statistic(rate, force, CONFIG), rtol=1e-9)


def test_stream_agrees_with_batch(rng):
    rate, force = still_rig(rng, 700)  # the ring of 512 wraps
    force[rng.integers(0, 700, 50)] += 0.2
    gateless = replace(CONFIG, rate_bias_sigma=1.0, force_magnitude_sigma=10.0)
    batch = zv.glrt_statistic(rate, force, gateless) < gateless.threshold
    stream = flags(gateless, rate, force)[:, 0]
    assert stream.tolist() == [False] * (W - 1) + batch.tolist()
    assert 0.05 < batch.mean() < 0.95  # both answers occur


def test_flags_the_pause_in_a_walk_and_rests_a_second_later(rng):
    rate, force = still_rig(rng, 800)
    rate[np.r_[:100, 700:800]] += [0.0, 2.0, 0.0]  # a swinging foot turns at about 2 rad/s
    still, resting = flags(CONFIG, rate, force).T
    # A window of 5 must leave the motion first: 100 + 4.
    assert np.flatnonzero(still)[[0, -1]].tolist() == [104, 699]
    assert np.flatnonzero(resting)[0] >= 104 + 199  # at 200 Hz; one false alarm starts it anew
    assert resting.sum() > 100
    assert not (resting & ~still).any()


def test_a_stance_that_trembles_is_still_but_never_rests(rng):
    rate, force = still_rig(rng, 1000)
    foot = replace(CONFIG, angular_rate_sigma=0.1, specific_force_sigma=0.5)
    rate += 0.05 * np.sin(np.arange(1000) / 10.0)[:, None]
    still, resting = flags(foot, rate, force).T
    assert still[W:].all()
    assert not resting.any()


def test_a_steady_turn_is_not_hidden_by_many_samples(rng):
    # 6 sigma of the bias per axis for 0.2 s: T is near 8, but the mean alone says no.
    config = replace(CONFIG, rate_bias_sigma=0.01, window_s=0.2)
    rate, force = still_rig(rng, 100)
    assert flags(config, rate, force)[40:, 0].all()
    assert not flags(config, rate + 0.06, force)[:, 0].any()
    assert not flags(config, rate, 1.02 * force)[:, 0].any()


def test_sensor_noise_counts_besides_tremor(rng):
    config = replace(CONFIG, angular_rate_sigma=1e-6, specific_force_sigma=1e-6)
    density = np.full(3, 0.002), np.full(3, 0.02)
    noise = rng.standard_normal((2, 300, 3)) / np.sqrt(DT)
    detector = zv.StillnessDetector(config)
    up = np.array([0.0, 0.0, config.gravity])
    still = [
        detector.push(DT, 0.002 * w, up + 0.02 * f, *density)[0]
        for w, f in zip(*noise, strict=True)
    ]
    # W T is chi-squared with 28 degrees of freedom: above 60 once in 2000.
    assert np.mean(still[W - 1 :]) > 0.98


@pytest.mark.parametrize(('dt', 'window'), [(0.01, 5), (0.005, 5), (0.001, 25), (1e-5, 512)])
def test_window_is_a_time_and_never_too_few_samples(dt, window):
    force = np.tile([0.0, 0.0, CONFIG.gravity], (600, 1))
    still = flags(CONFIG, 0.0 * force, force, dt)[:, 0]
    assert np.flatnonzero(still)[0] == window - 1


def test_a_gap_starts_the_window_anew():
    detector = zv.StillnessDetector(CONFIG)
    up = np.array([0.0, 0.0, CONFIG.gravity])
    steps = [DT] * 10 + [1.0] + [DT] * 10
    still = [detector.push(dt, SILENT, up, SILENT, SILENT)[0] for dt in steps]
    assert still == [False] * 4 + [True] * 6 + [False] * 4 + [True] * 7


def test_a_nan_is_never_still_and_passes(rng):
    rate, force = still_rig(rng, 100)
    rate[50] = np.nan
    still = flags(CONFIG, rate, force)[:, 0]
    assert not still[50 : 50 + W].any()
    assert still[56:].mean() > 0.9


def test_bad_input_is_named_in_the_message():
    with pytest.raises(ValueError, match='got 9 rates, 8 forces'):
        zv.glrt_statistic(np.zeros((9, 3)), np.ones((8, 3)), CONFIG)
    with pytest.raises(ValueError, match=r'`angular_rate` must have shape \(N, 3\)'):
        zv.glrt_statistic(np.zeros((9, 2)), np.ones((9, 3)), CONFIG)
    with pytest.raises(ValueError, match='`threshold` must be positive, got nan'):
        replace(CONFIG, threshold=np.nan)
    with pytest.raises(ValueError, match='`dt` must be positive, got 0'):
        zv.StillnessDetector(CONFIG).push(0.0, SILENT, SILENT, SILENT, SILENT)
