"""The other detectors, the level that adapts to the person, and both doors."""

from dataclasses import replace
from typing import get_args

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.odometry import zero_velocity as zv
from multiimu_ros.odometry.detectors import Detector
from multiimu_ros.odometry.profiles import FOOT, odometry_configs

ZERO = np.zeros(3)
UP = np.array([0.0, 0.0, 9.80665])
CONFIG = zv.GlrtConfig(
    angular_rate_sigma=0.36,
    specific_force_sigma=1.8,
    resting_rate_sigma=0.01,
    resting_force_sigma=0.05,
    swing_share=0.16,
)
OTHERS = ('gyro', 'moving_variance', 'ared')


def strides(vigour, rate_hz, count=3):
    """Return rate and force of a foot that swings for 0.6 s and stands for 0.4 s, by `vigour`.

    In its stances it rolls and trembles a twentieth as much.
    """
    t = np.arange(round(count * rate_hz)) / rate_hz
    swings = t % 1.0 >= 0.4
    size = vigour * np.where(swings, 1.0, 0.05)
    wave = np.sin(2 * np.pi * 7.3 * t), np.cos(2 * np.pi * 7.3 * t)
    rate = np.outer(size * (4.0 + wave[0]), [0.0, 1.0, 0.0])
    force = UP + np.outer(size * 10.0 * wave[1], [1.0, 0.0, 0.5])
    return rate, force, swings


def flags(config, rate, force, dt=0.005):
    """Return the (N, 2) verdicts of the stream, without sensor noise."""
    detector = zv.StillnessDetector(config)
    pushes = zip(rate, force, strict=True)
    return np.array([detector.push(dt, w, f, ZERO, ZERO) for w, f in pushes])


@pytest.mark.parametrize('rate_hz', [100, 200, 400, 1000])
@pytest.mark.parametrize('vigour', [0.1, 1.0, 3.0])
def test_the_same_setting_serves_slow_and_fast_feet_at_any_rate(vigour, rate_hz):
    rate, force, swings = strides(vigour, rate_hz)
    still = flags(CONFIG, rate, force, 1 / rate_hz)[:, 0]
    t = np.arange(len(still)) / rate_hz
    later = t >= 0.4  # before the first swing, nothing tells how this foot swings
    assert not still[later & swings & (t % 1.0 > 0.45)].any()
    # The window, 25 ms or 5 samples, has to leave the swing before the stance is seen.
    assert still[(t >= 1.0) & (t % 1.0 > 0.06) & (t % 1.0 < 0.39)].all()


@pytest.mark.parametrize('name', OTHERS)
def test_the_other_detectors_find_the_stances_too(name):
    rate, force, swings = strides(1.0, 200)
    still = flags(replace(CONFIG, detector=name), rate, force)[:, 0]
    t = np.arange(len(still)) / 200
    assert still[(t >= 1.0) & (t % 1.0 > 0.08) & (t % 1.0 < 0.39)].all()
    assert still[swings & (t % 1.0 > 0.45)].mean() < 0.05


def test_gyro_alone_needs_a_least_duration():
    rate = np.tile([0.0, 3.0, 0.0], (200, 1))
    rate[100:108] = 0.0  # the rate crosses zero in mid-swing, for 40 ms
    force = np.tile([15.0, 0.0, 9.8], (200, 1))
    patient = replace(CONFIG, detector='gyro', swing_share=0.0)
    printed = replace(patient, shortest_s=0.001)
    assert not flags(patient, rate, force)[:, 0].any()
    assert flags(printed, rate, force)[100:108, 0].any()  # as the thesis prints it: resets


def test_none_never_says_still():
    rest = np.zeros((1000, 3)), np.tile(UP, (1000, 1))
    assert not flags(replace(CONFIG, detector='none'), *rest).any()
    assert flags(CONFIG, *rest)[-1].all()


def test_motion_without_rests_is_never_still(rng):
    # A hand waves at 1 Hz: its rate passes zero twice a second, its force never stays.
    detector, _, _ = odometry_configs(FOOT, 9.80665, *np.full((4, 3), 1e-3))
    t = np.arange(4000) / 200
    rate = np.column_stack([np.sin(2 * np.pi * t), np.cos(7 * t), np.sin(5 * t + 1)])
    force = UP + 4.0 * np.column_stack([np.cos(7 * t), np.sin(6 * t), np.cos(5 * t)])
    still = flags(detector, rate + 0.01 * rng.standard_normal(rate.shape), force)[:, 0]
    assert still.mean() < 0.01


@pytest.mark.parametrize('name', [name for name in get_args(Detector) if name != 'none'])
def test_stream_agrees_with_batch(rng, name):
    config = replace(CONFIG, detector=name, swing_share=0.0, shortest_s=1e-9)
    config = replace(config, resting_rate_sigma=1e-9, resting_force_sigma=1e-9)
    rate, force = 0.3 * rng.standard_normal((300, 3)), UP + 1.5 * rng.standard_normal((300, 3))
    threshold = float(np.median(zv.glrt_statistic(rate, force, config)))
    config = replace(config, threshold=threshold, rate_bias_sigma=9.0, force_magnitude_sigma=9.0)
    batch = zv.glrt_statistic(rate, force, config) < config.threshold
    stream = flags(config, rate, force)[zv.SHORTEST - 1 :, 0]
    assert stream.tolist() == batch.tolist()


def test_statistics_are_the_printed_ones(rng):
    rate, force = rng.standard_normal((2, zv.SHORTEST, 3))
    scores = {
        name: zv.glrt_statistic(rate, force, replace(CONFIG, detector=name))[0] for name in OTHERS
    }
    # Skog et al. (2010): moving variance (8), angular rate energy (14), in units of the tremor.
    spread = force - force.mean(axis=0)
    assert_allclose(scores['moving_variance'], np.sum(spread**2) / zv.SHORTEST / 1.8**2)
    assert_allclose(scores['ared'], np.sum(rate**2) / zv.SHORTEST / 0.36**2)
    assert_allclose(scores['gyro'], np.sum(rate[-1] ** 2) / 0.36**2)


def test_an_unknown_detector_is_named():
    with pytest.raises(ValueError, match=r"`detector` must be one of none, .*, got 'shoe'"):
        replace(CONFIG, detector='shoe')
