"""The sources' odometry: both doors, its alignment, its trap in print, and what it reaches."""

import numpy as np
from numpy.testing import assert_allclose
import odometry_runs
from odometry_runs import FORCE_DENSITY, G, nees, RATE_DENSITY, read, to_start_frame
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.profiles import odometry_configs, PROFILES
from multiimu_ros.odometry.rest import RestBuffer, Sample
from multiimu_ros.odometry.seed_scheme import levelled, reckon_seeds, RESET_S, SeedScheme
from multiimu_ros.simulation.gait import duration_of
from multiimu_ros.simulation.trajectories import make_motion

UP = np.array([0.0, 0.0, G])
DENSITIES = RATE_DENSITY, FORCE_DENSITY


def scheme(profile='foot'):
    """Return the scheme for the IMU of `odometry_runs`."""
    known = (odometry_runs.RATE_BIAS, odometry_runs.FORCE_BIAS)
    walks = (odometry_runs.RATE_WALK, odometry_runs.FORCE_WALK)
    return SeedScheme(odometry_configs(PROFILES[profile], G, *known, *walks)[2])


def recorded(motion, rng, rate_hz, profile='foot'):
    """Return the samples that a filter gets, rest told late, as far as they are known."""
    detector, _, _ = odometry_runs.filters(profile)
    buffer, samples, dt = RestBuffer(0.25), [], 1 / rate_hz
    rate, force, bias, _ = read(motion, rng, rate_hz)
    for w, f in zip(rate, force, strict=True):
        samples += buffer.push(Sample(dt, w, f, *DENSITIES, *detector.push(dt, w, f, *DENSITIES)))
    return samples, bias


def batch(samples, still=None, reset_s=RESET_S):
    """Run the batch door on samples, with their flags or others."""
    dt, rate, force = (np.array([sample[k] for sample in samples]) for k in range(3))
    flags = np.array([sample[5:] for sample in samples])
    still = flags[:, 0] if still is None else np.full(len(dt), still)
    return reckon_seeds(dt, rate, force, still, flags[:, 1], G, reset_s)


def percent(position, truth):
    """Return end error and rms error of a path, in percent of its length."""
    error = np.linalg.norm(position - truth, axis=1)
    length = np.sum(np.linalg.norm(np.diff(truth, axis=0), axis=1))
    return 100 * np.array([error[-1], np.sqrt(np.mean(error**2))]) / length


@pytest.mark.compiled
@pytest.mark.parametrize('seconds', [4.0, 12.0])  # no long rest yet; a rest and some strides
def test_stream_and_batch_agree(rng, seconds):
    motion = make_motion('foot', seconds, 100, seed=2)
    samples, _ = recorded(motion, rng, 100)
    whole, stream = batch(samples), scheme()
    for k, sample in enumerate(samples):
        stream.step(sample)
        # The stream is levelled by the filter's `align`, whose last step is linear: 1e-9 rad.
        assert_allclose(stream.R_nb, whole.R_nb[k], rtol=0, atol=1e-8)
        assert_allclose(stream.velocity_n, whole.velocity_n[k], rtol=0, atol=1e-6)
        assert_allclose(stream.position_n, whole.position_n[k], rtol=0, atol=1e-5)


def test_a_rest_gives_bias_and_gravity():
    stream = scheme()
    reading = Rotation.from_euler('xy', [0.2, -0.3]).inv().apply([0.0, 0.0, 9.9])
    rate = np.array([0.01, -0.02, 0.03])
    for _ in range(400):
        stream.push(Sample(0.01, rate, reading, *DENSITIES, True, True))
    assert_allclose(stream.gyro_bias, rate, rtol=1e-9)
    assert_allclose(stream.R_nb @ reading, [0.0, 0.0, 9.9], atol=1e-9)
    # 9.9 is what it reads at rest: taken as gravity, nothing moves when flags are lost.
    there = stream.position_n
    for _ in range(100):
        stream.step(Sample(0.01, rate, reading, *DENSITIES, False, False))
    assert_allclose(stream.position_n, there, atol=1e-6)


def test_levelling_keeps_the_yaw():
    R = Rotation.from_euler('ZYX', [1.0, 0.2, -0.1])
    force = R.inv().apply(UP)
    tilted = (R * Rotation.from_rotvec([0.0, 0.0, 0.0])).as_matrix()
    assert_allclose(levelled(tilted, force), R.as_matrix(), atol=1e-12)
    turned = levelled((Rotation.from_rotvec([0.05, 0.0, 0.0]) * R).as_matrix(), force)
    assert_allclose(turned @ force, UP, atol=1e-9)


def test_a_swing_that_turns_round_resets_in_print_alone(rng):
    samples, _ = recorded(make_motion('foot', 20.0, 200, seed=3), rng, 200)
    truth = to_start_frame(make_motion('foot', 20.0, 200, seed=3))[1][: len(samples)]
    printed = percent(batch(samples, still=True, reset_s=0.0).position_n, truth)[1]
    lasting = percent(batch(samples, still=True).position_n, truth)[1]
    # Each swing turns round twice at up to 2 m/s; a reset there costs part of the stride, in other
    # simulations 5.5 % of the way.  With a duration: as in the test of 100 m.
    assert lasting < 0.9
    assert printed > 5 * lasting


@pytest.mark.slow  # where nothing is compiled
def test_a_loop_of_100_m_ends_where_the_sources_scheme_does():
    found, scores = [], []
    for seed in range(4):
        motion = make_motion('foot', duration_of(100.0), 200, seed)
        samples, _ = recorded(motion, np.random.default_rng(seed), 200)
        truth = to_start_frame(motion)[1][: len(samples)]
        found.append(percent(batch(samples).position_n, truth))
        if seed > 1:
            continue
        stream = scheme()
        for sample in samples:
            stream.step(sample)
        scores.append(nees(truth[-1] - stream.position_n, stream.P[:3, :3]))
    # 0.62 to 0.70 % in other simulations of this scheme, told to +-25 %.
    assert 0.45 < np.mean(found, axis=0)[0] < 0.9
    # The noise model is that of real feet; of this smooth walk it may expect too much, never less.
    assert np.mean(scores) < 1.0


@pytest.mark.compiled
def test_what_it_knows_grows_until_the_velocity_is_reset(rng):
    stream, sigmas = scheme(), []
    for sample in recorded(make_motion('foot', 12.0, 100, seed=1), rng, 100)[0]:
        stream.step(sample)
        sigmas.append(np.sqrt(np.diag(stream.P)))
    sigmas = np.array(sigmas)
    assert (np.diff(sigmas[400:, 0]) > -1e-9).all()  # walking; nothing ever corrects it
    slip = PROFILES['foot'].zero_velocity_sigma
    assert slip <= sigmas[:, 3].min() < 1.1 * slip  # of a sole, and a little that it rolls
    assert sigmas[400:, 3].max() > 0.03  # 2 % of a swing at 1.5 m/s


def test_without_flags_it_only_integrates():
    stream = scheme('hand')
    moved = np.array([0.5, 0.0, G])
    for _ in range(201):
        stream.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, False, False))
    stream.reset_motion()
    for _ in range(201):
        stream.push(Sample(0.005, np.zeros(3), moved, *DENSITIES, False, False))
    # From the first sample on: 200 steps of 5 ms, the first of them half as fast.
    assert_allclose(stream.velocity_n, [0.5 * 0.9975, 0.0, 0.0], atol=1e-9)
    stream.reset_motion()
    assert_allclose(stream.state[:6], 0.0)
    assert stream.P[3, 3] == 0.5**2


def test_a_hole_is_not_integrated():
    stream = scheme('hand')
    for _ in range(2):
        stream.push(Sample(0.005, np.zeros(3), UP, *DENSITIES, False, False))
    stream.push(Sample(2.0, np.zeros(3), np.array([5.0, 0.0, G]), *DENSITIES, False, False))
    assert_allclose(stream.velocity_n, 0.0, atol=1e-12)
    assert np.sqrt(stream.P[0, 0]) > 0.5
