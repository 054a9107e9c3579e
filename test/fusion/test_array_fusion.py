"""Scans to one IMU: the noise of N sensors, true variances, and no step when one leaves."""

from functools import partial

from array_scans import CONFIG, DENSITY, fuse, model_of, RATE_HZ, scan, SIGMA, STEP_NS
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.array_fusion import ArrayFusion, ArrayFusionConfig
from multiimu_ros.fusion.filter_bank import FilterBank
from multiimu_ros.fusion.fusion_state import fresh_state, GUARD, SETTINGS, VARIANCE
from multiimu_ros.fusion.rigid_body import HISTORY, push_slope, specific_force_at
from multiimu_ros.fusion.scan_filters import BankScans


def steps_of(model, readings):
    """Return the fused values of readings (N, K, 6), and no more, which is faster."""
    fusion = ArrayFusion(model, CONFIG)
    share = np.ones(readings.shape[1])
    return np.array([fusion.push(scan(n, z, share)).values for n, z in enumerate(readings)])


@pytest.mark.slow  # where nothing is compiled
@pytest.mark.parametrize('count', [1, 2, 4, 8, 16])
def test_n_imus_are_root_n_better_than_one(count, rng):
    # 20 000 scans, 60 000 numbers a triad: standard error of a standard deviation 0.29 %.  What
    # is beyond 1 must fit into 1 %: Huber's weights spend 1e-5 of it, for a chi-squared beyond 20
    # is one of 6000; the process noise, (0.25 rad/s)^2 and (2.5 m/s^2)^2 a scan, lowers it by
    # R / 2 Q N, 2e-5 of one IMU; forgetting two-second offsets costs nothing, sum b e = 0.
    readings = SIGMA * rng.standard_normal((20_000, count, 6))
    model = model_of(count)
    values = steps_of(model, readings)
    for triad in (slice(0, 3), slice(3, 6)):
        noise = values[10:, triad].std() * np.sqrt(count) / SIGMA[triad][0]
        assert noise == pytest.approx(1.0, abs=0.01)
    _, frames = fuse(ArrayFusion(model, CONFIG), readings[:100])
    assert_allclose(frames[-1].density, DENSITY / np.sqrt(count), rtol=1e-9)
    assert_allclose(frames[-1].weights, 1.0 / count, rtol=1e-9)


@pytest.mark.compiled
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


ARMS = 0.05 * np.array([[1.0, 0.0, 0.2], [0.3, 1.0, 0.0], [0.4, 0.1, 1.0]])


def moving(count, seconds, rng, arms=ARMS):
    """Return readings (N, K, 6) of a hand, and the rate and force of the base origin (N, 6)."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    wave = 2 * np.pi * np.array([1.0, 0.7, 1.3])
    rate = 3.0 * np.sin(wave * time[:, None])
    acceleration = 3.0 * wave * np.cos(wave * time[:, None])
    force = [0.0, 0.0, 9.81] + 3.0 * np.cos(wave[::-1] * time[:, None])
    felt = [specific_force_at(arm, force, rate, acceleration) for arm in arms[:count]]
    readings = np.stack([np.hstack([rate, f]) for f in felt], axis=1)
    return readings + SIGMA * rng.standard_normal(readings.shape), np.hstack([rate, force])


def configured(**settings):
    return ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0, **settings)


@pytest.mark.parametrize('guard', [True, False])
@pytest.mark.parametrize(
    ('one', 'other', 'rtol'),
    [
        # The same information, added in another order: rounding of some thousand scans.
        ({}, {'master': 'centralised'}, 1e-9),
        ({'local': 'kf', 'fuse_every': 2}, {'local': 'ukf', 'fuse_every': 2}, 1e-11),
    ],
)
def test_filters_that_theory_calls_equal_are(one, other, rtol, guard, rng):
    readings, _ = moving(3, 1.5, rng)
    readings[100:130, 1] = np.nan
    model = model_of(3, bias_sigma=0.01, arms=ARMS)
    tables = []
    for settings in (one, other):
        _, frames = fuse(ArrayFusion(model, configured(guard=guard, **settings)), readings)
        tables.append(np.array([frame.table for frame in frames]))
    size = np.abs(tables[0]).max(axis=(0, 2), keepdims=True)
    assert (np.abs(tables[0] - tables[1]) < rtol * size).all()


@pytest.mark.parametrize('guard', [True, False])
def test_the_compiled_default_is_the_bank_of_kf_and_carlson(guard, rng):
    readings, _ = moving(3, 1.5, rng)
    readings[100:130, 1] = np.nan
    model = model_of(3, bias_sigma=0.01, arms=ARMS)
    fusion = ArrayFusion(model, configured(guard=guard))
    _, frames = fuse(fusion, readings)
    state, settings = fresh_state(model), np.zeros(SETTINGS)
    settings[:3], settings[3:6], settings[GUARD] = 50.0, 500.0, guard
    state.fused[VARIANCE] = np.inf
    bank = BankScans(model, state, settings, partial(FilterBank, 'kf', 'carlson', 3))
    for n, (z, frame) in enumerate(zip(readings, frames, strict=True)):
        out, weights = bank.push(scan(n, z, np.ones(3)), None)
        assert_allclose(out, frame.table, rtol=1e-12, atol=1e-12)
        assert_allclose(weights, frame.weights, rtol=1e-12, atol=1e-15)


def test_the_first_scan_has_its_forces_already(rng):
    # Seen before the cure: an infinite variance of the turn times a lever arm of zero was NaN.
    for arms in (np.zeros((3, 3)), ARMS):
        readings, truth = moving(3, 0.1, rng, arms)
        frame = ArrayFusion(model_of(3, arms=arms), CONFIG).push(scan(0, readings[0], np.ones(3)))
        assert np.isfinite(frame.table).all()
        assert (np.abs(frame.values - truth[0]) < 5 * np.sqrt(frame.variance)).all()


@pytest.mark.compiled
def test_accelerometers_find_the_turn_that_an_unbalanced_array_needs(rng):
    angle = 2 * np.pi * np.arange(8) / 8
    arms = np.stack([0.09 + 0.08 * np.cos(angle), 0.08 * np.sin(angle), 0 * angle], axis=1)
    readings, truth = moving(8, 5.0, rng, arms)
    fused = fuse(ArrayFusion(model_of(8, arms=arms), CONFIG), readings)[0][:, 3:]
    mean = readings[:, :, :3].mean(axis=1)
    history = np.zeros(HISTORY, np.int64), np.zeros((HISTORY, 3)), np.zeros(1, np.int64)
    slope = [push_slope(*history, n * STEP_NS, rate)[0] for n, rate in enumerate(mean)]
    turn = [specific_force_at(arm, np.zeros_like(mean), mean, np.array(slope)) for arm in arms]
    alone = np.mean(readings[:, :, 3:] - np.stack(turn, axis=1), axis=1)
    errors = [np.sqrt(np.mean((force - truth[:, 3:])[50:] ** 2)) for force in (fused, alone)]
    # White noise is 9.0 mm/s^2.  The slope's noise, 0.13 rad/s^2 at N = 8, adds 9.7 by each axis
    # across the arm, and it lags; eight accelerometers over 16 cm know a to 0.16.  Seen 0.86.
    assert errors[0] < 0.93 * errors[1]
