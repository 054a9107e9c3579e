"""The truth between its instants, and the lateness of stamps."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from report_runs import recording, still_truth

from multiimu_ros.report.truth import as_truth, fit_lateness
from multiimu_ros.simulation.trajectories import trajectory


def test_truth_between_its_instants_is_the_motion_there():
    way = trajectory('hand', 10.0, seed=1)
    grid, between = np.arange(2000) / 200, 5.0 + np.arange(100) / 37
    truth = as_truth(way.at(grid), np.round(grid * 1e9).astype(np.int64))
    exact, got = way.at(between), truth.at(np.round(between * 1e9).astype(np.int64))
    # Cubic splines err by h^4/384 times the fourth derivative: 1.6e-12 times 1e4 at 1.3 Hz,
    # and the path is itself made of pieces of 20 ms, whose third derivative jumps.
    assert_allclose(got.angular_rate, exact.angular_rate_b, atol=2e-5)
    assert_allclose(got.specific_force, exact.specific_force_b, atol=2e-4)
    assert_allclose(got.position_n, exact.position_n, atol=1e-8)
    assert_allclose(got.R_nb, exact.R_nb, atol=1e-7)


def test_outside_its_span_the_truth_keeps_its_ends():
    truth = still_truth()
    got = truth.at(np.array([-(10**9), 10**12]))
    assert_allclose(got.position_n, 0.0, atol=1e-12)
    assert got.still.all()


@pytest.mark.parametrize('late', [-0.004, 0.0, 0.0017])
def test_lateness_of_stamps_is_found_again(late):
    _, _, truth = recording()
    stamps = truth.stamp_ns + round(late * 1e9)
    noisy = truth.angular_rate + np.random.default_rng(0).normal(scale=1e-3, size=(len(stamps), 3))
    found = fit_lateness(truth, stamps, noisy + 0.01)
    assert 0 < found.sigma < 5e-6
    assert abs(found.seconds - late) < 4 * found.sigma  # one run in 16 000 is further off


def test_at_rest_no_lateness_is_claimed():
    truth = still_truth()
    found = fit_lateness(truth, truth.stamp_ns, truth.angular_rate + 1e-3)
    assert found.seconds == 0.0
    assert found.sigma == np.inf
