"""The door to all filters: names, shapes, stream and batch, what every combination promises."""

from typing import get_args

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion.filter_bank import filter_series, FilterBank
from multiimu_ros.fusion.local_filters import Local
from multiimu_ros.fusion.masters import Master

LOCALS, MASTERS = get_args(Local), get_args(Master)
HONEST = [name for name in MASTERS if name != 'mfkf_printed']
R, Q = np.array([1.0, 2.0, 4.0])[:, None] * np.ones(3), np.full(3, 0.3)


def readings(rng, scans=40):
    """Return a random walk (N, 3) and readings (N, 3, 3), some of them missing, with their R."""
    truth = np.cumsum(np.sqrt(Q) * rng.standard_normal((scans, 3)), axis=0)
    z = truth[:, None] + np.sqrt(R) * rng.standard_normal((scans, 3, 3))
    missing = rng.random((scans, 3, 1)) < 0.1
    missing[20:22] = missing[0, 2] = True
    return truth, np.where(missing, np.nan, z), np.where(missing, np.inf, R)


@pytest.mark.parametrize('local', LOCALS)
@pytest.mark.parametrize('master', HONEST)
def test_batch_gives_the_numbers_of_the_stream(local, master, rng):
    truth, z, noise = readings(rng)
    stream = FilterBank(local, master, 3, seed=4)
    answers = [stream.step(*scan, Q) for scan in zip(z, noise, strict=True)]
    used = FilterBank(local, master, 3, seed=4)
    used.step(z[0] + 50.0, R, Q)  # batch forgets it
    x, P = filter_series(used, z, noise, Q)
    assert_array_equal(x, [answer[0] for answer in answers])
    assert_array_equal(P, [answer[1] for answer in answers])
    shares = np.array([answer[2] for answer in answers])
    assert (shares[np.isinf(noise)] == 0.0).all()
    assert_allclose(shares.sum(axis=1), np.isfinite(noise).any(axis=1), rtol=1e-12)
    # A combination that is no estimator at all would be off by the walk, 3.5 after 40 scans; the
    # worst sigma of a mean here is 1, and 120 errors of it are within 5.
    assert np.abs(x - truth).max() < 5.0
    assert (P > 0.0).all()


@pytest.mark.parametrize('local', LOCALS)
@pytest.mark.parametrize('master', HONEST)
def test_an_axis_that_nobody_has_seen_is_unknown_until_its_first_reading(local, master):
    bank, hidden = FilterBank(local, master, 2, 2), np.array([[1.0, np.inf], [1.0, np.inf]])
    x, P, shares = bank.step(np.array([[3.0, np.nan], [3.0, np.nan]]), hidden, np.ones(2))
    assert (x[1], P[1], shares[0, 1]) == (0.0, np.inf, 0.0)
    x, P, shares = bank.step(np.full((2, 2), 3.0), np.full((2, 2), 1e-6), np.ones(2))
    assert x[1] == pytest.approx(3.0, abs=0.01)  # 10 sigma of one reading, if particles drew it
    assert P[1] < 1e-4
    assert_allclose(shares[:, 1], 0.5, atol=0.1)  # by variance: of 1000 particles, to 4.5 %


def test_all_linear_locals_agree_under_every_master(rng):
    _, z, noise = readings(rng)
    for master in HONEST:
        linear = filter_series(FilterBank('kf', master, 3), z, noise, Q)
        unscented = filter_series(FilterBank('ukf', master, 3), z, noise, Q)
        assert_allclose(unscented, linear, rtol=1e-11, atol=1e-11)


def test_faded_filters_follow_a_jump_that_the_others_smooth(rng):
    z = 0.1 * rng.standard_normal((60, 3, 3))
    z[40:] += 20.0
    quiet, small = np.full(3, 1e-6), np.full((3, 3), 0.01)
    for master in ('average', 'inverse_variance', 'carlson'):
        faded = filter_series(FilterBank('afukf', master, 3), z, small, quiet)
        slow = filter_series(FilterBank('kf', master, 3), z, small, quiet)
        assert np.abs(faded[0][41] - 20.0).max() < 1.0  # under ten sigma of one reading
        assert np.abs(slow[0][41] - 20.0).min() > 10.0


def test_particles_are_drawn_from_their_seed(rng):
    _, z, noise = readings(rng)
    one, same, other = (
        filter_series(FilterBank('particle', 'carlson', 3, seed=seed), z, noise, Q)[0]
        for seed in (1, 1, 2)
    )
    assert_array_equal(one, same)
    assert np.abs(one - other).max() > 1e-3


def test_learnt_noise_moves_the_shares_to_the_better_imus(rng):
    truth = np.cumsum(0.5 * rng.standard_normal((400, 30)), axis=0)
    sigma = np.array([1.0, 1.0, 3.0])[:, None]
    z = truth[:, None] + sigma * rng.standard_normal((400, 3, 30))
    bank, wrong = FilterBank('adaptive', 'carlson', 3, 30), np.full((3, 30), 2.0)
    for scan in z:
        _, _, shares = bank.step(scan, wrong, np.full(30, 0.25))
    # 1 / 9 to 1 : 1 / 19 = 0.053; R is learnt to some 15 % a filter, its mean over 30 to 3 %.
    assert shares[2].mean() == pytest.approx(1.0 / 19.0, rel=0.12)


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (('ekf', 'carlson', 3), "`local` must be one of kf, .*got 'ekf'"),
        (('kf', 'scaat', 3), "`master` must be one of average, .*got 'scaat'"),
        (('kf', 'carlson', 0), '`count` must be at least 1, got 0'),
    ],
)
def test_wrong_names_are_told_with_the_right_ones(arguments, message):
    with pytest.raises(ConfigError, match=message):
        FilterBank(*arguments)


def test_a_caller_who_mixes_shapes_or_signs_is_told():
    bank = FilterBank('kf', 'carlson', 3)
    with pytest.raises(ValueError, match=r'must be \(3, 3\) twice and \(3,\), got \(2, 3\)'):
        bank.step(np.zeros((2, 3)), R, Q)
    with pytest.raises(ValueError, match='`R` must be positive'):
        bank.step(np.zeros((3, 3)), 0.0 * R, Q)
    with pytest.raises(ValueError, match='`Q` not negative'):
        bank.step(np.zeros((3, 3)), R, -Q)
