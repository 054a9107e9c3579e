"""The scatter of Allan variances: against simulation, and against Greenhall's numbers."""

from noise_series import five_terms
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.calibration.allan import allan_curve, averaging_factors
from multiimu_ros.calibration.allan_covariance import covariance_basis
from multiimu_ros.calibration.allan_fit import shapes

COUNT, RATE = 1024, 10.0
CASES = {
    'Q': (0.1, 0, 0, 0, 0),
    'N': (0, 1, 0, 0, 0),
    'B': (0, 0, 1, 0, 0),
    'K': (0, 0, 0, 1, 0),
    'all': (0.1, 1, 0.5, 0.3, 0.02),
    'N and ramp': (0, 1, 0, 0, 0.1),
    'K and ramp': (0, 0, 0, 1, 1.0),
}


@pytest.mark.parametrize('case', CASES)
def test_covariance_is_that_of_simulated_records(case):
    terms, runs = CASES[case], 400
    rng = np.random.default_rng(5)
    curves = [allan_curve(five_terms(COUNT, RATE, *terms, rng), RATE) for _ in range(runs)]
    variances = np.concatenate([curve.deviation.T**2 for curve in curves])
    found = np.cov(variances.T)
    stated = covariance_basis(COUNT).covariance(
        np.square(np.array(terms, float)), RATE, averaging_factors(COUNT)
    )
    deviation = np.sqrt(np.diag(stated))
    # 1200 series: 2 % for a normal law, 4 % at the long end, which scatters like chi-squared of
    # 7; three of these, and the ends of the record, which the formula counts as 5 % more.
    assert_allclose(np.sqrt(np.diag(found)) / deviation, 1, atol=0.16)
    correlation = found / np.outer(*2 * [np.sqrt(np.diag(found))])
    # The sigma of a correlation of 0 is 1 / sqrt(1200) = 0.029; four of them.
    assert_allclose(correlation, stated / np.outer(deviation, deviation), atol=0.115)


# Howe, Allan, Barnes, "Properties of signal sources and measurement methods", Proc. 35th Frequency
# Control Symposium, 1981, table 1: fits to simulations, n phases, averages of m.
EMPIRICAL = {
    1: lambda n, m: (1.5 * (n - 1) / m - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5),
    2: lambda n, m: 5 * n**2 / (4 * m * (n + 3 * m)),
    3: lambda n, m: (n - 2) / m * ((n - 1) ** 2 - 3 * m * (n - 1) + 4 * m**2) / (n - 3) ** 2,
}


@pytest.mark.parametrize('column', EMPIRICAL)
def test_degrees_of_freedom_are_those_of_the_published_table(column):
    squares = np.eye(5)[column]
    factor = averaging_factors(COUNT)
    scatter = covariance_basis(COUNT).covariance(squares, 1.0, factor)
    expected = shapes(factor.astype(float)) @ squares
    dof = 2 * expected**2 / np.diag(scatter)
    long = factor >= 4  # where discrete noise is like continuous noise
    published = EMPIRICAL[column](COUNT + 1, factor)
    # The table is good to some per cent; ours sums the lags as in an endless record, which makes
    # up to 10 % fewer at the long end.
    assert_allclose(dof[long] / published[long], 0.96, atol=0.1)


def test_sigmas_shrink_with_the_root_of_the_length():
    squares = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
    short, long = (
        np.diag(covariance_basis(n).covariance(squares, 1.0, averaging_factors(n)))[:8]
        for n in (1024, 4096)
    )
    # Each loses the last 2 m of its samples: 3 % of 1024 for m = 16.
    assert_allclose(long / short, 0.25, rtol=0.03)
