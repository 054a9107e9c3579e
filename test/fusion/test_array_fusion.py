"""Scans to one IMU: the noise of N sensors, true variances, and no step when one leaves."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.array_fusion import ArrayFusion, ArrayFusionConfig
from multiimu_ros.fusion.rig_model import bare_model
from multiimu_ros.fusion.rigid_body import specific_force_at
from multiimu_ros.synchronization.synchronizer import Scan

CONFIG = ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0)
RATE_HZ = 200.0
STEP_NS = 5_000_000
DENSITY = np.repeat([1.2e-4, 1.8e-3], 3)
SIGMA = DENSITY * np.sqrt(RATE_HZ)


def model_of(count, bias_sigma=0.0, arms=None, density=None):
    return bare_model(
        np.tile(DENSITY, (count, 1)) if density is None else density,
        bias_variance=np.full((count, 6), bias_sigma**2),
        lever_arms_b=np.zeros((count, 3)) if arms is None else arms,
    )


def scan(n, values, share):
    return Scan(n * STEP_NS, values, share, np.ones(len(share)))


def fuse(fusion, readings, share=None):
    """Return fused values and the frames of readings (N, K, 6)."""
    share = np.ones(readings.shape[:2]) if share is None else share
    frames = [fusion.push(scan(n, z, share[n])) for n, z in enumerate(readings)]
    return np.array([frame.values for frame in frames]), frames


@pytest.mark.parametrize('count', [1, 2, 4, 8, 16])
def test_n_imus_are_root_n_better_than_one(count, rng):
    readings = SIGMA * rng.standard_normal((4000, count, 6))
    values, frames = fuse(ArrayFusion(model_of(count), CONFIG), readings)
    # 12 000 numbers a triad: standard error of a standard deviation 0.65 %; a generous process
    # noise leaves the filter within 1 % of the plain mean.
    for triad in (slice(0, 3), slice(3, 6)):
        noise = values[10:, triad].std() * np.sqrt(count) / SIGMA[triad][0]
        assert noise == pytest.approx(1.0, abs=0.03)
    assert_allclose(frames[-1].density, DENSITY / np.sqrt(count), rtol=1e-9)
    assert_allclose(frames[-1].weights, 1.0 / count, rtol=1e-9)


def test_a_noisy_imu_weighs_as_little_as_its_variance_demands(rng):
    density = np.outer([1.0, 1.0, 2.5], DENSITY)
    readings = np.array([1.0, 1.0, 2.5])[:, None] * SIGMA * rng.standard_normal((4000, 3, 6))
    values, frames = fuse(ArrayFusion(model_of(3, density=density), CONFIG), readings)
    assert_allclose(frames[-1].weights, np.array([6.25, 6.25, 1.0]) / 13.5, rtol=1e-9)
    nees = np.mean((values[10:] / np.sqrt([frame.variance for frame in frames[10:]])) ** 2)
    assert nees == pytest.approx(1.0, abs=0.05)  # 24 000 numbers, standard error 0.01


def test_lever_arms_are_taken_out_even_where_they_do_not_cancel():
    arms = np.array([[0.08, 0.0, 0.0], [0.0, 0.05, 0.02]])
    time = np.arange(600) / RATE_HZ
    wave = 2 * np.pi * np.array([1.0, 0.7, 1.3])
    rate = 3.0 * np.sin(wave * time[:, None])
    acceleration = 3.0 * wave * np.cos(wave * time[:, None])
    force = np.tile([0.0, 0.0, 9.81], (600, 1))
    felt = [specific_force_at(arm, force, rate, acceleration) for arm in arms]
    readings = np.stack([np.hstack([rate, f]) for f in felt], axis=1)
    values, _ = fuse(ArrayFusion(model_of(2, arms=arms), CONFIG), readings)
    uncorrected = np.abs(readings[5:, :, 3:].mean(axis=1) - force[5:]).max()
    assert uncorrected > 1.0
    # What is left: the slope of a sine over 20 ms by a parabola, 2 % of a x r at the most.
    assert np.abs(values[5:, 3:] - force[5:]).max() < 0.02 * uncorrected


def test_when_an_imu_leaves_and_returns_nothing_jumps(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + 1e-6 * rng.standard_normal((2000, 4, 6))
    readings[800:1200, 2] = np.nan
    share = np.ones((2000, 4))
    share[1200:1300, 2] = 0.0
    values, _ = fuse(ArrayFusion(model_of(4, bias_sigma=0.1), CONFIG), readings, share)
    assert_allclose(values, np.broadcast_to(bias.mean(axis=0), values.shape), atol=2e-5)


def test_an_imu_that_returns_with_another_bias_does_not_move_the_rest(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + 1e-6 * rng.standard_normal((2000, 4, 6))
    readings[800:1200, 2] = np.nan
    readings[1200:, 2] += 1.0
    share = np.ones((2000, 4))
    share[1200:1300, 2] = 0.0
    values, _ = fuse(ArrayFusion(model_of(4, bias_sigma=0.1), CONFIG), readings, share)
    assert_allclose(values, np.broadcast_to(bias.mean(axis=0), values.shape), atol=2e-5)


def test_the_offsets_are_the_differences_of_the_biases(rng):
    bias = 0.05 * rng.standard_normal((3, 6))
    fusion = ArrayFusion(model_of(3, bias_sigma=0.1), CONFIG)
    _, frames = fuse(fusion, bias + SIGMA * rng.standard_normal((2000, 3, 6)))
    # The running mean looks back 2 s, 400 scans: sigma / sqrt(800), five of them.
    assert_allclose(fusion.offsets, bias - bias.mean(axis=0), atol=5 * SIGMA[3] / np.sqrt(800))
    assert_allclose(frames[-1].bias_variance, 0.01 / 3, rtol=1e-9)


def test_an_imu_that_speaks_first_does_not_impose_its_bias(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + 1e-6 * rng.standard_normal((500, 4, 6))
    readings[:3, 1:] = np.nan
    values, _ = fuse(ArrayFusion(model_of(4, bias_sigma=0.1), CONFIG), readings)
    assert_allclose(values[3:], np.broadcast_to(bias.mean(axis=0), values[3:].shape), atol=2e-5)


def test_errors_of_scale_count_in_the_variance():
    model = model_of(2)._replace(scale_variance=np.tile(1e-4 * np.eye(6), (2, 1, 1)))
    readings = np.tile([2.0, 0.0, 0.0, 0.0, 0.0, 9.81], (50, 2, 1))
    _, frames = fuse(ArrayFusion(model, CONFIG), readings)
    without = fuse(ArrayFusion(model_of(2), CONFIG), readings)[1]
    extra = frames[-1].variance - without[-1].variance
    assert_allclose(extra, [2e-4, 0.0, 0.0, 0.0, 0.0, 9.81**2 * 0.5e-4], rtol=1e-9, atol=1e-15)


def test_a_scan_that_nobody_can_be_trusted_in_gives_nothing():
    fusion = ArrayFusion(model_of(2), CONFIG)
    assert fusion.push(scan(0, np.full((2, 6), np.nan), np.ones(2))) is None
    assert fusion.push(scan(1, np.zeros((2, 6)), np.zeros(2))) is None
    assert fusion.push(scan(2, np.zeros((2, 6)), np.ones(2))) is not None


def test_after_a_restart_the_old_motion_is_forgotten(rng):
    fusion = ArrayFusion(model_of(2), CONFIG)
    fuse(fusion, np.ones((50, 2, 6)))
    fusion.restart()
    frame = fusion.push(scan(-200_000, np.zeros((2, 6)), np.ones(2)))
    assert_allclose(frame.values, 0.0, atol=1e-12)


def test_process_noise_must_be_positive():
    with pytest.raises(ValueError, match='`jerk_sigma` must be positive, got 0'):
        ArrayFusionConfig(angular_acceleration_sigma=1.0, jerk_sigma=0.0)


def test_where_nobody_is_trusted_nothing_is_learnt(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + [0, 0, 0, 0, 0, 9.81] + 1e-6 * rng.standard_normal((1000, 4, 6))
    share = np.ones((1000, 4))
    share[500:600] = 0.0
    fusion = ArrayFusion(model_of(4, bias_sigma=0.05), CONFIG)
    frames = [fusion.push(scan(n, z, share[n])) for n, z in enumerate(readings)]
    assert all((frame is None) == (n in range(500, 600)) for n, frame in enumerate(frames))
    # Seen before the cure: the offsets took in gravity.
    assert_allclose(frames[600].values, frames[499].values, atol=1e-5)
