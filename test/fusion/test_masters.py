"""The masters against the centralised filter, their own variances, and sensors that differ."""

from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion import masters
from multiimu_ros.fusion.federated import federated_step, information_shares
from multiimu_ros.fusion.filter_bank import filter_series, FilterBank
from multiimu_ros.fusion.local_filters import FadingLocal
from multiimu_ros.fusion.masters import CarlsonMaster, FilterDivergedError, mean_weights

INF = np.inf
MEANS = ['average', 'inverse_sigma', 'inverse_variance']
HONEST = [*MEANS, 'carlson', 'centralised']


def walk(rng, scans, R, Q):
    """Return a random walk (N, A) from anywhere and what is seen of it with noise R (K, A)."""
    start = 100.0 * rng.standard_normal(R.shape[1])
    truth = start + np.cumsum(np.sqrt(Q) * rng.standard_normal((scans, R.shape[1])), axis=0)
    return truth, truth[:, None] + np.sqrt(R) * rng.standard_normal((scans, *R.shape))


@pytest.mark.parametrize('every', [1, 10, 100])
@pytest.mark.parametrize('reset', ['fusion', 'none'])
def test_carlson_equals_the_centralised_filter_where_it_fuses(every, reset, rng):
    R, Q = rng.uniform(0.1, 10.0, (4, 3)), rng.uniform(0.01, 3.0, 3)
    _, z = walk(rng, 300, R, Q)
    federated = filter_series(FilterBank('kf', 'carlson', 4, reset=reset, every=every), z, R, Q)
    central = filter_series(FilterBank('kf', 'centralised', 4), z, R, Q)
    at = slice(every - 1, None, every)
    for ours, reference in zip(federated, central, strict=True):
        assert_allclose(ours[at], reference[at], rtol=1e-9)


def test_carlson_with_zero_reset_equals_it_with_a_fusion_every_scan_only(rng):
    R, Q = rng.uniform(0.1, 10.0, (4, 3)), rng.uniform(0.01, 3.0, 3)
    _, z = walk(rng, 50, R, Q)
    central = filter_series(FilterBank('kf', 'centralised', 4), z, R, Q)
    zero = filter_series(FilterBank('kf', 'carlson', 4, reset='zero'), z, R, Q)
    assert_allclose(zero, central, rtol=1e-9)
    seldom = filter_series(FilterBank('kf', 'carlson', 4, reset='zero', every=10), z, R, Q)
    assert (seldom[1][10:] > central[1][10:]).all()  # readings between fusions are lost


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20)
def test_any_shares_will_do_with_a_fusion_reset_every_scan(seed):
    rng = np.random.default_rng(seed)
    R, Q = rng.uniform(0.1, 10.0, (4, 3)), rng.uniform(0.01, 3.0, 3)
    _, z = walk(rng, 30, R, Q)
    bank, central = FilterBank('kf', 'carlson', 4), FilterBank('kf', 'centralised', 4)
    with pytest.MonkeyPatch.context() as patch:
        for scan in z:
            reference = central.step(scan, R, Q)
            b = rng.dirichlet(np.ones(4), 3).T
            patch.setattr(masters, 'information_shares', lambda R, b=b: b)
            # Shares down to 1e-3 cost some digits.
            assert_allclose(bank.step(scan, R, Q)[:2], reference[:2], rtol=1e-9)
            patch.undo()


def test_carlson_is_the_compiled_filter_whoever_drops_out(rng):
    R, Q = rng.uniform(0.1, 10.0, (5, 6)), rng.uniform(0.01, 3.0, 6)
    _, z = walk(rng, 200, R, Q)
    missing = rng.random(z.shape) < 0.2
    missing[20:23] = missing[0, :, 2] = True
    bank, x, P = FilterBank('kf', 'carlson', 5, 6), np.zeros(6), np.full(6, INF)
    for scan, gone in zip(z, missing, strict=True):
        noise, seen = np.where(gone, INF, R), np.where(gone, np.nan, scan)
        b = information_shares(noise)
        x, P = federated_step(x, P, seen, noise, Q, b)
        ours = bank.step(seen, noise, Q)
        for got, want in zip(ours, (x, P, b), strict=True):
            assert_allclose(got, want, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize('master', HONEST)
@pytest.mark.parametrize('local', ['kf', 'ukf'])
def test_the_error_is_as_large_as_each_master_says(local, master, rng):
    axes = 20_000
    R = np.array([1.0, 1.0, 6.0])[:, None] * np.ones(axes)
    truth, z = walk(rng, 12, R, Q := np.full(axes, 0.3))
    x, P = filter_series(FilterBank(local, master, 3, axes), z, R, Q)
    # 20000 independent filters: standard error sqrt(2 / 20000) = 0.01, five of them.
    assert np.mean((x - truth)[-1] ** 2 / P[-1]) == pytest.approx(1.0, abs=0.05)
    assert np.mean((x - truth)[0] ** 2 / P[0]) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize('master', HONEST)
def test_nobody_jumps_more_than_its_variance_says_when_an_imu_comes_and_goes(master, rng):
    axes = 20_000
    R = np.array([1.0, 2.0, 4.0])[:, None] * np.ones(axes)
    Q = np.full(axes, 0.3)
    truth, z = walk(rng, 14, R, Q)
    noise = np.broadcast_to(R, z.shape).copy()
    noise[5:8, 0] = INF  # one leaves and comes back
    noise[9:11] = INF  # then all do
    x, P = filter_series(FilterBank('kf', master, 3, axes), z, noise, Q)
    nees = np.mean((x - truth) ** 2 / P, axis=1)
    # Standard error 0.01 each; the worst of 14 is within five.
    assert_allclose(nees, 1.0, atol=0.05)


@pytest.mark.parametrize('reset', ['fusion', 'none', 'zero'])
@pytest.mark.parametrize('every', [1, 4])
def test_carlson_never_claims_too_much_when_imus_come_and_go(reset, every, rng):
    axes = 5000
    R, Q = np.array([1.0, 2.0, 4.0])[:, None] * np.ones(axes), np.full(axes, 0.3)
    truth, z = walk(rng, 30, R, Q)
    noise = np.where(rng.random((30, 3, 1)) < 0.25, INF, R)
    noise[0] = R
    x, P = filter_series(
        FilterBank('kf', 'carlson', 3, axes, reset=reset, every=every), z, noise, Q
    )
    # Shares are upper bounds, not exact where they change: less than 1 is allowed, more is not.
    # Standard error 0.02, five of them.
    nees = np.mean((x - truth) ** 2 / P, axis=1)
    assert nees.max() < 1.1
    assert nees.mean() > 0.7


class CountingLocal(FadingLocal):
    """The fading filter, which counts its alarms."""

    def __init__(self):
        super().__init__()
        self.alarms = 0

    def step(self, x, P, z, R, Q, expected):
        update = super().step(x, P, z, R, Q, expected)
        self.alarms += int((update.fading > 1.0).sum())
        return update


@pytest.mark.parametrize(('reset', 'every'), [('fusion', 1), ('fusion', 10), ('none', 1)])
def test_innovations_under_carlson_are_judged_by_what_they_are_not_by_inflated_shares(
    reset, every, rng
):
    R, Q = np.array([1.0, 2.0, 4.0])[:, None] * np.ones(2000), np.full(2000, 0.3)
    _, z = walk(rng, 41, R, Q)
    local = CountingLocal()
    master = CarlsonMaster(local, 3, 2000, reset, every)
    for scan in z:
        master.step(scan, R, Q)
    # q = 1e-3 of 40 x 6000 readings: 240, standard error 16 were they independent; those of one
    # axis share its prediction, which at most doubles it; four of 20.
    assert local.alarms == pytest.approx(240, abs=80)


def error_ratios(rng, sigmas, names):
    """Return rms errors with these sigmas over those with sigma 1 of all, on hand motion."""
    axes, t = 300, np.arange(200) / 200.0
    phase = rng.uniform(0.0, 2.0 * np.pi, axes)
    truth = 3.0 * np.sin(2.0 * np.pi * t[:, None] + phase)  # 3 rad/s at 1 Hz
    Q = np.full(axes, (3.0 * 2.0 * np.pi / 200.0) ** 2)  # its largest change from scan to scan
    noise = 0.002 * rng.standard_normal((200, len(sigmas), axes))
    ratios = {}
    for name in names:
        errors = []
        for scale in (np.array(sigmas), np.ones(len(sigmas))):
            R = (0.002 * scale[:, None]) ** 2 * np.ones(axes)
            bank = FilterBank('kf', name, len(sigmas), axes)
            x, _ = filter_series(bank, truth[:, None] + noise * scale[:, None], R, Q)
            errors.append(np.std(x - truth))
        ratios[name] = errors[0] / errors[1]
    return ratios


def test_one_noisy_imu_of_three_costs_what_theory_says(rng):
    ratios = error_ratios(rng, [1.0, 1.0, np.sqrt(6.0)], HONEST)
    theory = {
        'average': np.sqrt(8.0 / 3.0),  # (1 + 1 + 6) / 9 over 1 / 3
        'inverse_sigma': 3.0 / (2.0 + 1.0 / np.sqrt(6.0)),
        'inverse_variance': np.sqrt(3.0 / (2.0 + 1.0 / 6.0)),
        'carlson': np.sqrt(3.0 / (2.0 + 1.0 / 6.0)),
        'centralised': np.sqrt(3.0 / (2.0 + 1.0 / 6.0)),
    }
    for name, ratio in ratios.items():
        # Two rms of 60000 samples: standard error 0.4 %, and the same noise in both; three.
        assert ratio == pytest.approx(theory[name], rel=0.012), name
    assert ratios['carlson'] <= 1.2
    assert ratios['average'] == pytest.approx(1.6, abs=0.05)


@pytest.mark.parametrize(('worse', 'cost'), [(np.sqrt(6.0), 1.059), (5.0, 1.124), (10.0, 1.169)])
def test_weights_of_one_over_sigma_cost_more_the_more_imus_differ(worse, cost):
    # The 12-17 % of unequal sensors are those of one in three that is 5-10 times worse.
    R = np.array([[1.0], [1.0], [worse**2]])
    variance = [
        (mean_weights(kind, R, R) ** 2 * R).sum() for kind in ('inverse_sigma', 'inverse_variance')
    ]
    assert np.sqrt(variance[0] / variance[1]) == pytest.approx(cost, abs=1e-3)


@given(seed=st.integers(0, 2**32 - 1), kind=st.sampled_from(MEANS))
def test_weights_sum_to_one_over_those_present(seed, kind):
    rng = np.random.default_rng(seed)
    R, P = rng.uniform(0.1, 10.0, (2, 5, 6))
    R[rng.random(R.shape) < 0.4] = INF
    weights = mean_weights(kind, R, P)
    assert (weights[np.isinf(R)] == 0.0).all()
    assert_allclose(weights.sum(axis=0), np.isfinite(R).any(axis=0), rtol=1e-12)


def scans_until_divergence(R, Q, most=2000):
    """Return how many scans the printed filter survives, `most` if it does not diverge."""
    rng, bank = np.random.default_rng(5), FilterBank('kf', 'mfkf_printed', len(R), 1)
    R = np.array(R)[:, None]
    for n in range(most):
        try:
            bank.step(np.sqrt(R) * rng.standard_normal(R.shape), R, np.full(1, Q))
        except FilterDivergedError:
            return n
    return most


@pytest.mark.parametrize(
    ('worse', 'scans'), [(6.0, 8), (1.2, 11), (1.001, 19), (1.0 + 1e-6, 32), (1.0 + 1e-9, 55)]
)
def test_the_printed_master_diverges_as_its_log_ratios_say(worse, scans):
    # ln(P_1 / P_3) is multiplied by -2 a scan.  It is -2 ln(R_1 / R_3) after the first, and ends
    # where a squared share is no number, at ln(1e308) / 2 = 355.
    theory = 1.0 + np.log2(355.0 / (2.0 * np.log(worse)))
    assert scans_until_divergence([1.0, 1.0, worse], 0.0) == pytest.approx(theory, abs=1.5)
    # A little motion, added to each P_i, slows it when P_f has come down to it: as counted.
    assert scans_until_divergence([1.0, 1.0, worse], 1e-6) == pytest.approx(scans, abs=1)


def test_the_printed_master_holds_with_equal_imus_or_much_motion():
    assert scans_until_divergence([1.0, 1.0, 1.0], 1e-6) == 2000
    # Q is added to each P_i / b_i before it is squared, and hides their ratio where it is large.
    assert scans_until_divergence([1.0, 1.0, 6.0], 100.0) == 2000


def test_the_printed_master_ends_when_its_state_is_absurd():
    bank, R, Q = FilterBank('kf', 'mfkf_printed', 2, 1), np.ones((2, 1)), np.full(1, 1e-6)
    bank.step(np.zeros((2, 1)), R, Q)
    with pytest.raises(FilterDivergedError, match='choose `carlson`'):
        bank.step(np.full((2, 1), 1e9), R, Q)


def test_the_printed_master_claims_too_much(rng):
    axes = 5000
    R, Q = np.ones((3, axes)), np.full(axes, 0.01)
    truth, z = walk(rng, 60, R, Q)
    x, P = filter_series(FilterBank('kf', 'mfkf_printed', 3, axes), z, R, Q)
    assert np.mean((x - truth)[-1] ** 2 / P[-1]) > 1.2  # the prior is counted (2 - b_m) times
