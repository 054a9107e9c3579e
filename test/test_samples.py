"""A batch of samples: three columns of one length, checked once at its making."""

from dataclasses import FrozenInstanceError

import numpy as np
from numpy.testing import assert_array_equal
import pytest

from multiimu_ros.samples import ImuSamples


def five_samples():
    """Return 5 samples at 200 Hz whose numbers tell them apart."""
    values = np.arange(15.0).reshape(5, 3)
    return ImuSamples(np.arange(5) * 5_000_000, values, -values)


def test_lists_become_arrays():
    samples = ImuSamples([1, 2], [[0, 0, 1], [0, 0, 2]], [[0, 0, 9], [0, 0, 8]])
    assert len(samples) == 2
    assert samples.stamp_ns.dtype == np.int64
    assert samples.specific_force.dtype == np.float64


def test_columns_of_different_length_are_refused_by_name():
    with pytest.raises(ValueError, match='`angular_rate` must have 2 rows like `stamp_ns`, got 1'):
        ImuSamples([1, 2], np.zeros((1, 3)), np.zeros((2, 3)))
    with pytest.raises(ValueError, match=r'`specific_force` must have 2 rows .* got 3'):
        ImuSamples([1, 2], np.zeros((2, 3)), np.zeros((3, 3)))


def test_a_batch_cannot_be_changed():
    with pytest.raises(FrozenInstanceError):
        five_samples().stamp_ns = np.zeros(5, dtype=np.int64)


@pytest.mark.parametrize('index', [slice(1, 3), np.array([False, True, True, False, False])])
def test_select_takes_the_same_rows_of_every_column(index):
    samples = five_samples()
    chosen = samples.select(index)
    assert chosen.stamp_ns.tolist() == [5_000_000, 10_000_000]
    assert_array_equal(chosen.angular_rate, samples.angular_rate[1:3])
    assert_array_equal(chosen.specific_force, samples.specific_force[1:3])


def test_rate_is_the_median_so_that_a_gap_does_not_move_it():
    stamp_ns = np.array([0, 5, 10, 15, 900]) * 1_000_000
    samples = ImuSamples(stamp_ns, np.zeros((5, 3)), np.zeros((5, 3)))
    assert samples.rate_hz == 200.0


@pytest.mark.parametrize('count', [0, 1])
def test_rate_of_too_few_samples_is_unknown(count):
    assert np.isnan(five_samples().select(slice(count)).rate_hz)
