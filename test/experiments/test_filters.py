"""The comparison of filters: what theory says of three white gyroscopes, at rest and in motion."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.experiments import filter_trials as trials, filters


@pytest.fixture(scope='module')
def result():
    return filters.run(2, lambda _: None, duration=9.0, sweep=2)


@pytest.fixture(scope='module')
def rows(result):
    return {row['filter']: row for row in result.tables[1].rows}


def test_every_printed_filter_has_our_numbers_beside_it(result):
    whose = [(row['filter'], row['whose']) for row in result.tables[0].rows]
    assert whose[:3] == [('KF_AVE', w) for w in ('paper', 'ours at rest', 'ours in motion')]
    assert len(whose) == 12
    assert result.tables[0].rows[0]['corrupted [mdeg/s]'] == 5.71


def test_in_motion_a_bad_imu_costs_what_theory_says(rows):
    # 24 series of 600 readings: ratios of rms are known to 1 %.
    mean, best = (rows[name]['ratio'] for name in ('average', 'carlson'))
    assert mean == pytest.approx(np.sqrt(8 / 3), rel=0.04)  # (1 + 1 + 2.45^2) / 9 over 1 / 3
    assert best == pytest.approx(trials.LEAST_RATIO, rel=0.03)


def test_the_hat_learns_what_the_filter_is_not_told(rows):
    # 600 scans tell R to some 7 %, which weights feel in second order.
    told, learnt = (rows[name]['motion, one bad'] for name in ('carlson', 'carlson, R learnt'))
    assert told < learnt < 1.03 * told


def test_kf_and_ukf_are_one_filter_here(rows):
    pair = [rows[name]['motion, one bad'] for name in ('carlson', 'carlson, ukf')]
    assert_allclose(pair[0], pair[1], rtol=1e-9)


def test_the_printed_master_ends_where_imus_differ_and_only_there(result, rows):
    assert np.isnan(rows['mfkf as printed']['rest, one bad'])
    said = [row['ours'] for row in result.tables[2].rows]
    assert said[0] == 'went on'
    scans = [int(text.split()[2]) for text in said[1:]]
    assert scans == sorted(scans, reverse=True)  # the more they differ, the sooner
    assert scans[0] <= 50


def test_the_smoothing_at_rest_is_that_of_the_printed_error(rng):
    wanted = 3.5 * trials.MILLIDEGREE
    Q = trials.resting_noise(wanted)
    z = trials.WHITE * rng.standard_normal((3000, 3, 48))
    kind = trials.Filter('kf', 'average')
    noise = trials.noise_of(corrupted=False)
    trial = trials.run_trial(kind, z, noise, np.full(48, Q), np.zeros((3000, 48)))
    # A gain of 1.5 % makes 48 series of 27 s some 1000 independent errors: 2.3 %.
    assert trial.error == pytest.approx(wanted, rel=0.09)
