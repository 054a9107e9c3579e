"""Each local filter against its printed equations, the linear one, and its own promises."""

from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.stats import chi2

from multiimu_ros.fusion.adaptive_filter import AdaptiveLocal
from multiimu_ros.fusion.filter_bank import FilterBank
from multiimu_ros.fusion.local_filters import (
    COVARIANCE_WEIGHTS,
    fading_factors,
    FadingLocal,
    kalman_step,
    KalmanLocal,
    MEAN_WEIGHTS,
    unscented_step,
)
from multiimu_ros.fusion.particle_filter import (
    effective_particles,
    ParticleLocal,
    resample_systematically,
)

seeds = st.integers(0, 2**32 - 1)
INF = np.inf


def scene(rng, shape, scans, R=1.0, Q=0.3):
    """Return a random walk (N, A) and what K IMUs see of it (N, K, A)."""
    truth = np.cumsum(np.sqrt(Q) * rng.standard_normal((scans, shape[1])), axis=0)
    return truth, truth[:, None] + np.sqrt(R) * rng.standard_normal((scans, *shape))


def run(local, z, R, Q):
    """Feed (N, K, A) readings to a filter by itself; return x, P of all scans."""
    x, P, out = np.zeros(z.shape[1:]), np.full(z.shape[1:], INF), []
    for scan in z:
        noise, walk = local.believe(scan, R, Q)
        walk = np.broadcast_to(walk, R.shape)
        x, P, _, _ = local.step(x, P, scan, noise, walk, P + walk)
        out.append((x, P))
    return np.array(out).swapaxes(0, 1)


def test_the_linear_filter_is_the_printed_one():
    x, P, z, R, Q = 1.0, 2.0, 4.0, 3.0, 0.5
    P_minus = P + Q  # (5.74)
    K = P_minus / (R + P_minus)  # (5.76)
    step = kalman_step(*(np.full((1, 1), value) for value in (x, P, z, R, Q)))
    printed = x + K * (z - x), (1.0 - K) * P_minus, K  # (5.77), (5.78)
    assert_allclose(np.ravel(step[:3]), printed, rtol=1e-12)


@pytest.mark.parametrize('step', [kalman_step, unscented_step])
def test_an_unknown_state_is_the_first_reading_and_none_is_no_news(step):
    x, P = np.array([[0.0, 5.0, 0.0, 5.0]]), np.array([[INF, 2.0, INF, INF]])
    z, R = np.array([[7.0, np.nan, np.nan, 7.0]]), np.array([[4.0, INF, INF, 4.0]])
    after = step(x, P, z, R, np.full((1, 4), 0.5))
    assert_allclose(after.x, [[7.0, 5.0, 0.0, 7.0]], rtol=1e-12)
    assert_allclose(after.P, [[4.0, 2.5, INF, 4.0]], rtol=1e-12)
    assert_allclose(after.gain, [[1.0, 0.0, 0.0, 1.0]], rtol=1e-12)


def test_sigma_point_weights_sum_to_one_which_the_printed_ones_do_not():
    assert MEAN_WEIGHTS.sum() == pytest.approx(1.0, rel=1e-12)
    # alpha = 1, beta = 2: the middle one of the covariance carries beta more.
    assert COVARIANCE_WEIGHTS.sum() == pytest.approx(3.0, rel=1e-12)
    assert_allclose(MEAN_WEIGHTS[1:], 1.0 / 6.0, rtol=1e-12)  # 1 / (2 (M + lambda)), M = 3


@given(seed=seeds, ratio=st.floats(1e-4, 1e4))
@settings(max_examples=50)
def test_the_unscented_filter_is_the_linear_one_on_a_linear_model(seed, ratio):
    rng = np.random.default_rng(seed)
    R, Q = rng.uniform(0.1, 10.0, (4, 3)), ratio * rng.uniform(0.1, 10.0, (4, 3))
    linear = unscented = np.zeros((4, 3)), np.full((4, 3), INF)
    for _ in range(20):
        z = rng.standard_normal((4, 3))
        linear = kalman_step(*linear, z, R, Q)[:2]
        unscented = unscented_step(*unscented, z, R, Q)[:2]
    assert_allclose(unscented, linear, rtol=1e-11, atol=1e-11)


@given(seed=seeds, size=st.floats(1.0, 1e4))
@settings(max_examples=50)
def test_the_secant_recursion_ends_at_the_closed_form_of_a_scalar(seed, size):
    rng = np.random.default_rng(seed)
    prior, R = rng.uniform(0.1, 10.0, (2, 5, 3))
    square = (size * rng.standard_normal((5, 3))) ** 2
    threshold = chi2.isf(1e-3, 1)
    closed = np.maximum(1.0, (square / threshold - R) / prior)
    # It stops when the distance is within 1e-12 of the threshold; the factor is S - R over the
    # prior, and R may be 100 times the prior.
    assert_allclose(fading_factors(square, prior, R, threshold), closed, rtol=1e-9)


def test_the_fading_filter_takes_a_jump_at_once_and_noise_for_noise(rng):
    R, Q = np.ones((1, 4000)), np.full(4000, 1e-4)
    _, z = scene(rng, (1, 4000), 60, Q=1e-4)
    local, x, P = FadingLocal(), np.zeros(R.shape), np.full(R.shape, INF)
    alarms = 0
    for scan in z[:50]:
        update = local.step(x, P, scan, R, np.broadcast_to(Q, R.shape), P + Q)
        x, P = update.x, update.P
        alarms += (update.fading > 1.0).sum()
    # q = 1e-3 of 49 x 4000 readings, the first has no prediction: 196 +- 14, four of them.
    assert alarms == pytest.approx(196, abs=56)
    jumped = local.step(x, P, x + 100.0, R, np.broadcast_to(Q, R.shape), P + Q)
    # M^2 = chi^2 leaves S = 100^2 / chi^2, so R / S of the jump is still missing.
    assert_allclose(x + 100.0 - jumped.x, 100.0 * local.threshold / 100.0**2, rtol=1e-6)


def test_the_adaptive_filter_finds_both_noises_from_wrong_ones(rng):
    truth_R, truth_Q, axes = 2.0, 0.5, 2000
    _, z = scene(rng, (1, axes), 250, truth_R, truth_Q)
    local = AdaptiveLocal(window=200)
    given_R, given_Q = np.full((1, axes), 6.0), np.full(axes, 0.2)
    for scan in z:
        R, Q = local.believe(scan, given_R, given_Q)
    for learnt, truth in ((R, truth_R), (Q, truth_Q)):
        error = learnt.std() / np.sqrt(axes)  # of the mean of 2000 filters; four of them
        assert learnt.mean() == pytest.approx(truth, abs=4.0 * error)
    # One filter: products of three alike terms; sqrt(2/200) = 10 % were they one and independent.
    assert 0.1 * truth_R < R.std() < 0.25 * truth_R


def test_the_printed_pair_of_equations_cannot_leave_a_wrong_gain(rng):
    """Show why (5.80) and (5.81) alone are not used: any gain satisfies them."""
    _, z = scene(rng, (1, 2000), 300, 2.0, 0.5)
    K, x, squares = 0.1, z[0], []  # the right gain is 0.39
    for scan in z[1:]:
        squares.append((scan - x) ** 2)
        x = x + K * (scan - x)
    S = np.mean(squares[100:])
    Q, P = K**2 * S, K * S
    R = S - P
    assert pytest.approx(K, rel=1e-12) == P / (P + R)  # the gain that it came from
    assert pytest.approx((1.0 - K) * P + Q, rel=1e-12) == P  # and P^- of it is steady
    assert R > 3.0  # and far from 2


def test_what_is_learnt_stays_positive_and_waits_for_half_a_window(rng):
    R, Q = np.full((2, 3), 4.0), np.full(3, 0.1)
    local = AdaptiveLocal(window=20)
    for n in range(60):
        stuck = np.full((2, 3), float(n))  # a ramp without noise: R would be 0 or less
        noise, walk = local.believe(stuck, R, Q)
        assert (noise > 0.0).all()
        assert (walk > 0.0).all()
        if n < 10:
            assert_allclose(noise, R, rtol=1e-12)
    noise, _ = local.believe(np.full((2, 3), np.nan), np.full((2, 3), INF), Q)
    assert np.isinf(noise).all()  # what is not read stays unread


@given(seed=seeds)
@settings(max_examples=30)
def test_systematic_resampling_draws_each_as_often_as_its_weight_says(seed):
    rng = np.random.default_rng(seed)
    weights = rng.dirichlet(np.full(50, 0.3), 4)
    clouds = np.tile(np.arange(50.0), (4, 1))
    drawn = resample_systematically(clouds, weights, rng.random(4))
    for row, weight in zip(drawn, weights, strict=True):
        times = np.bincount(row.astype(int), minlength=50)
        assert (np.abs(times - 50.0 * weight) < 1.0 + 1e-9).all()


def test_systematic_resampling_favours_nobody(rng):
    weights = np.array([0.25, 0.05, 0.4, 0.3])
    clouds, starts = np.tile(np.arange(4.0), (4000, 1)), rng.random(4000)
    drawn = resample_systematically(clouds, np.tile(weights, (4000, 1)), starts)
    times = np.bincount(drawn.ravel().astype(int)) / 4000.0
    # Each comes 0 or 1 times more than its floor: standard error below 0.5 / sqrt(4000) = 0.008.
    assert_allclose(times, 4.0 * weights, atol=0.032)


def test_effective_particles_are_all_or_one():
    alike, one = np.full(10, 0.1), np.eye(10)[3]
    assert_allclose(effective_particles(np.array([[alike, one]])), [[10.0, 1.0]], rtol=1e-12)


@pytest.mark.parametrize('Q', [0.1, 3.0])
def test_particles_come_as_near_the_linear_filter_as_their_number_allows(Q, rng):
    particles, R = 1000, np.ones((2, 20))
    _, z = scene(rng, (2, 20), 60, Q=Q)
    x, P = run(ParticleLocal(1, particles), z, R, np.full(20, Q))
    linear_x, linear_P = run(KalmanLocal(), z, R, np.full(20, Q))
    prior = linear_P[-1].mean() + Q
    effective = particles * np.sqrt(2.0 * 1.0 / (prior + 1.0)) if prior > 1.0 else particles / 2
    error = np.sqrt(np.mean(linear_P[20:]) / effective)
    # Errors of some scans add up, by 1 / (1 - (1 - K)^2) < 4 in variance.
    assert (x - linear_x)[20:].std() < 2.0 * error
    assert P[20:].mean() == pytest.approx(linear_P[20:].mean(), rel=0.02)


def test_a_cloud_goes_where_its_master_puts_it(rng):
    local, R = ParticleLocal(3), np.ones((2, 3))
    first = local.step(np.zeros((2, 3)), np.full((2, 3), INF), R, R, R, np.full((2, 3), INF))
    moved = local.step(first.x + 10.0, 4.0 * first.P, R, np.full((2, 3), INF), 0.0 * R, R)
    # Nothing is seen and Q = 0: exactly the mean and variance that were given.
    assert_allclose(moved.x, first.x + 10.0, rtol=1e-9)
    assert_allclose(moved.P, 4.0 * first.P, rtol=1e-9)
    restored = local.step(np.zeros((2, 3)), np.full((2, 3), 5.0), R, np.full((2, 3), INF), R, R)
    assert restored.P.mean() == pytest.approx(6.0, rel=0.1)


def test_a_cloud_that_is_hit_by_nothing_still_has_a_variance():
    local, R = ParticleLocal(3, 100), np.full((1, 1), 1e-6)
    x, P = np.zeros((1, 1)), np.ones((1, 1))
    after = local.step(x, P, np.full((1, 1), 50.0), R, 0.0 * R, P)
    assert np.isfinite(after.x).all()
    assert after.P[0, 0] >= 1e-8


def test_readings_that_never_change_leave_an_adaptive_filter_sane():
    bank = FilterBank('adaptive', 'carlson', 2, 1)
    for _ in range(500):
        bank.step(np.full((2, 1), 0.25), np.ones((2, 1)), np.ones(1))
    x, P, _ = bank.step(np.full((2, 1), 0.5), np.ones((2, 1)), np.ones(1))
    assert 0.25 <= x[0] <= 0.5
    assert P[0] > 0.0
