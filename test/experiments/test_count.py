"""How many IMUs: noise falls as it must, and what is common does not."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.experiments import count


@pytest.fixture(scope='module')
def tables():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(count, 'ATTITUDE_TIME', 12.0)  # a minute is for the experiment itself
        return count.run(4, lambda _: None, boards=1, counts=(1, 4)).tables


def test_noise_of_four_is_half_that_of_one(tables):
    one, four = (row['rate noise [mdeg/s]'] for row in tables[0].rows)
    # 400 samples of three axes: each deviation is known to 2 %.
    assert four == pytest.approx(one / 2, rel=0.1)
    assert tables[0].rows[1]['1/√N'] == 0.5


def test_a_common_error_is_added_whatever_the_count(tables):
    for row in tables[1].rows:
        assert row['attitude, common'] > row['attitude [deg]']
    assert all(row['frame [µs]'] > 0 for row in tables[0].rows)


def test_the_common_part_is_found_in_errors_that_follow_the_law():
    counts = np.array([1, 2, 4, 8])
    own = np.sqrt(3.0 / counts)
    shared = np.sqrt(0.6 + 3.0 / counts)
    assert count.common_part(own, shared, counts) == pytest.approx(0.2, rel=1e-12)


def test_a_common_error_is_a_bias_and_a_scale(rng):
    fused = rng.standard_normal((5, 6))
    error = count.common_error(rng)
    assert_allclose(count.with_error(fused, error) - fused, error[0] + error[1] * fused)
