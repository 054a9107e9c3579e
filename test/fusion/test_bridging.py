"""From the last rate that was measured, over the gap, and back: the bridge inside the stage."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.array_fusion import ArrayFusion, ArrayFusionConfig
from multiimu_ros.fusion.bridging import bridge_gap
from multiimu_ros.fusion.fusion_state import BRIDGED, fresh_state, PERIOD, SETTINGS, VALUE
from multiimu_ros.fusion.rig_model import bare_model
from multiimu_ros.fusion.rigid_body import specific_force_at
from multiimu_ros.synchronization.synchronizer import Scan

RATE_HZ = 200.0
DENSITY = np.repeat([1.2e-4, 1.8e-3], 3)
SIGMA = DENSITY * np.sqrt(RATE_HZ)
ANGLES = 2 * np.pi * np.arange(4) / 4
RING = 0.06 * np.stack([np.cos(ANGLES), np.sin(ANGLES), 0 * ANGLES], axis=1)
LIMIT = 8.7


def turn(seconds=2.0):
    """Return time, rate and angular acceleration (N, 3) of a spin to 14 rad/s and back."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    wave = np.pi / seconds * time
    rate, acceleration = np.zeros((2, len(time), 3))
    rate[:, 2] = 14.0 * np.sin(wave)
    acceleration[:, 2] = 14.0 * np.pi / seconds * np.cos(wave)
    rate[:, 0], acceleration[:, 0] = np.sin(5 * time), 5 * np.cos(5 * time)
    return time, rate, acceleration


def readings_of(rng, limit=LIMIT):
    _, rate, acceleration = turn()
    force = np.tile([0.0, 0.0, 9.81], (len(rate), 1))
    felt = [specific_force_at(arm, force, rate, acceleration) for arm in RING]
    z = np.stack([np.hstack([rate, f]) for f in felt], axis=1)
    z += SIGMA * rng.standard_normal(z.shape)
    z[:, :, :3] = np.clip(z[:, :, :3], -limit, limit)
    return rate, z


def stage(limit, **settings):
    limits = np.tile(np.repeat([limit, np.inf], 3), (4, 1))
    model = bare_model(np.tile(DENSITY, (4, 1)), lever_arms_b=RING, limits=limits)
    model = model._replace(bias_variance=np.full((4, 6), 1e-4))
    config = ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0, **settings)
    return ArrayFusion(model, config)


def fuse(fusion, readings):
    one = np.ones(4)
    return [fusion.push(Scan(round(n * 5e6), z, one, one)) for n, z in enumerate(readings)]


@pytest.mark.parametrize('settings', [{}, {'local': 'ukf'}])
def test_the_rate_goes_on_beyond_the_limit_and_comes_back_without_a_jump(settings, rng):
    rate, readings = readings_of(rng)
    frames = fuse(stage(LIMIT, **settings), readings)
    error = np.array([frame.values[:3] for frame in frames]) - rate
    sigma = np.sqrt([frame.variance[:3] for frame in frames])
    beyond = np.abs(rate[:, 2]) > LIMIT
    assert beyond.sum() > 150
    chi = (error / sigma)[beyond] ** 2
    # 170 scans whose errors hang together over tenths of seconds: some 10 draws of z, and biases
    # that are stated but absent here, so that less than 1 is right.
    assert chi.mean() < 1.5
    assert np.abs(error[beyond]).max() < 0.05  # 5.3 are cut off
    steps = np.abs(np.diff(error, axis=0)) / np.hypot(sigma[1:], sigma[:-1])
    assert steps.max() < 4.5  # of 1200 draws the largest is 3.4
    assert sigma[beyond, 2].max() > 2 * sigma[20:][~beyond[20:], 2].min()


def test_a_bridge_begins_with_the_angular_acceleration_before_the_gap(rng):
    # Seen before the cure: it began with none, 0.06 rad/s short of the truth, 50 sigma.
    rate, readings = readings_of(rng)
    first = np.flatnonzero(np.abs(rate[:, 2]) > LIMIT)[0]
    frames = fuse(stage(LIMIT), readings[: first + 4])
    for n in range(first - 3, first + 4):
        apart = np.abs(frames[n].values[:3] - rate[n]) / np.sqrt(frames[n].variance[:3])
        assert (apart < 5.0).all()


def test_a_clipped_rate_without_a_limit_passes_for_the_truth(rng):
    _, readings = readings_of(rng)
    frames = fuse(stage(np.inf), readings)
    assert_allclose(max(frame.values[2] for frame in frames), LIMIT, atol=5 * SIGMA[0])


def test_offsets_learn_nothing_from_a_reading_at_its_limit(rng):
    _, readings = readings_of(rng)
    readings[:, 1, 2] = np.minimum(readings[:, 1, 2], LIMIT - 0.5)  # as of another scale
    limits = np.tile(np.repeat([LIMIT, np.inf], 3), (4, 1))
    limits[1, :3] = LIMIT - 0.5
    fusion = stage(LIMIT)
    fusion = ArrayFusion(fusion._model._replace(limits=limits), fusion._config)
    fuse(fusion, readings)
    assert (np.abs(fusion.offsets[:, 2]) < 5 * SIGMA[0] / np.sqrt(64)).all()


def test_nothing_is_bridged_where_a_gyroscope_measures():
    model = bare_model(np.tile(DENSITY, (4, 1)), lever_arms_b=RING)
    state = fresh_state(model)
    state.clock[PERIOD] = 0.005
    state.clock[BRIDGED] = 1.0
    at_limit, b = np.zeros((4, 6)), np.full((4, 6), 0.25)
    at_limit[0, 2] = 1.0
    before = state.fused[VALUE].copy()
    bridge_gap(model, state, np.ones(SETTINGS), np.zeros((4, 6)), np.ones((4, 6)), at_limit, b)
    assert state.clock[BRIDGED] == 0.0
    assert_allclose(state.fused[VALUE], before)
