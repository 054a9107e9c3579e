"""Differences of biases: learnt at once, moved slowly, and no step when an IMU leaves."""

from array_scans import fuse, model_of, scan, SIGMA
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.array_fusion import ArrayFusion, ArrayFusionConfig


def configured(**settings):
    return ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0, **settings)


@pytest.mark.compiled
def test_when_an_imu_leaves_and_returns_nothing_jumps(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + 1e-6 * rng.standard_normal((2000, 4, 6))
    readings[800:1200, 2] = np.nan
    share = np.ones((2000, 4))
    share[1200:1300, 2] = 0.0
    values, _ = fuse(ArrayFusion(model_of(4, bias_sigma=0.1), configured()), readings, share)
    assert_allclose(values, np.broadcast_to(bias.mean(axis=0), values.shape), atol=2e-5)


@pytest.mark.compiled
def test_an_imu_that_returns_with_another_bias_does_not_move_the_rest(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + 1e-6 * rng.standard_normal((2000, 4, 6))
    readings[800:1200, 2] = np.nan
    readings[1200:, 2] += 1.0
    share = np.ones((2000, 4))
    share[1200:1300, 2] = 0.0
    values, _ = fuse(ArrayFusion(model_of(4, bias_sigma=0.1), configured()), readings, share)
    assert_allclose(values, np.broadcast_to(bias.mean(axis=0), values.shape), atol=2e-5)


@pytest.mark.compiled
def test_the_offsets_are_the_differences_of_the_biases(rng):
    bias = 0.05 * rng.standard_normal((3, 6))
    fusion = ArrayFusion(model_of(3, bias_sigma=0.1), configured())
    _, frames = fuse(fusion, bias + SIGMA * rng.standard_normal((2000, 3, 6)))
    # The running mean looks back 2 s, 400 scans: sigma / sqrt(800), five of them.
    assert_allclose(fusion.offsets, bias - bias.mean(axis=0), atol=5 * SIGMA[3] / np.sqrt(800))
    assert_allclose(frames[-1].bias_variance, 0.01 / 3, rtol=1e-9)


def test_an_imu_that_speaks_first_does_not_impose_its_bias(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + 1e-6 * rng.standard_normal((500, 4, 6))
    readings[:3, 1:] = np.nan
    values, _ = fuse(ArrayFusion(model_of(4, bias_sigma=0.1), configured()), readings)
    assert_allclose(values[3:], np.broadcast_to(bias.mean(axis=0), values[3:].shape), atol=2e-5)


@pytest.mark.compiled
def test_where_nobody_is_trusted_nothing_is_learnt(rng):
    bias = 0.05 * rng.standard_normal((4, 6))
    readings = bias + [0, 0, 0, 0, 0, 9.81] + 1e-6 * rng.standard_normal((1000, 4, 6))
    share = np.ones((1000, 4))
    share[500:600] = 0.0
    fusion = ArrayFusion(model_of(4, bias_sigma=0.05), configured())
    frames = [fusion.push(scan(n, z, share[n])) for n, z in enumerate(readings)]
    assert all((frame is None) == (n in range(500, 600)) for n, frame in enumerate(frames))
    # Seen before the cure: the offsets took in gravity.
    assert_allclose(frames[600].values, frames[499].values, atol=1e-5)


@pytest.mark.compiled
@pytest.mark.parametrize('guard', [True, False])
@pytest.mark.parametrize('count', [2, 3])
def test_a_step_of_one_imu_hardly_moves_its_offset(count, guard, rng):
    step = np.deg2rad(5.0)
    readings = SIGMA * rng.standard_normal((1200, count, 6))
    readings[600:, 0, 0] += step
    fusion = ArrayFusion(model_of(count, bias_sigma=0.02), configured(guard=guard))
    _, frames = fuse(fusion, readings[:800])
    # Three sigma of a reading in two seconds: 1.5 x 1.7 mrad/s of 87.
    assert abs(fusion.offsets[0, 0]) < 0.1 * step
    if not (guard and count == 2):
        return
    for n, z in enumerate(readings[800:], start=800):
        frames.append(fusion.push(scan(n, z, np.ones(2))))
    # Of two nobody knows which: their mean is off by half, and its variance says so.
    nees = np.mean([f.values[0] ** 2 / f.variance[0] for f in frames[640:]])
    assert 0.5 < nees < 1.5
    assert [fault.state for fault in fusion.faults()] == ['ambiguous', 'ambiguous']


def test_a_fresh_board_aligns_in_its_first_scans(rng):
    bias = 0.05 * rng.standard_normal((3, 6))
    fusion = ArrayFusion(model_of(3, bias_sigma=0.05), configured())
    fuse(fusion, bias + SIGMA * rng.standard_normal((20, 3, 6)))
    # The mean of 20 scans, about the mean of three; five standard errors.
    assert_allclose(fusion.offsets, bias - bias.mean(axis=0), atol=5 * SIGMA[3] / np.sqrt(20))


def test_a_single_imu_has_no_offset(rng):
    fusion = ArrayFusion(model_of(1, bias_sigma=0.05), configured())
    values, _ = fuse(fusion, 0.03 + SIGMA * rng.standard_normal((200, 1, 6)))
    assert_allclose(fusion.offsets, 0.0, atol=1e-15)
    assert_allclose(values.mean(axis=0), 0.03, atol=5 * SIGMA[3] / np.sqrt(200))


def test_a_restart_keeps_the_alignment(rng):
    bias = 0.05 * rng.standard_normal((3, 6))
    fusion = ArrayFusion(model_of(3, bias_sigma=0.05), configured())
    fuse(fusion, bias + SIGMA * rng.standard_normal((100, 3, 6)))
    before = fusion.offsets
    fusion.restart()
    assert_allclose(fusion.offsets, before, rtol=1e-12)
    assert (fusion.block == 0.0).all()


def limited(count):
    limits = np.tile(np.repeat([2.0, 15.0], 3), (count, 1))
    return model_of(count, bias_sigma=0.01)._replace(limits=limits)


def test_an_accelerometer_at_its_range_is_left_out_and_teaches_nothing(rng):
    readings = [0, 0, 0, 0, 0, 9.81] + SIGMA * rng.standard_normal((400, 3, 6))
    readings[200:, 1, 5] = 15.0
    fusion = ArrayFusion(limited(3), configured())
    fuse(fusion, readings[:200])
    offsets = fusion.offsets
    values = [fusion.push(scan(n, readings[n], np.ones(3))).values for n in range(200, 400)]
    assert_allclose(np.mean(values, axis=0)[5], 9.81, atol=5 * SIGMA[5] / np.sqrt(400))
    assert_allclose(fusion.offsets[1] - offsets[1], 0.0, atol=1e-3)  # the others' recentring
