"""The checks at the doors: right shapes pass as float64, wrong ones are named."""

import numpy as np
import pytest

from multiimu_ros import arrays


def test_numbers_become_float64():
    assert arrays.as_vector([1, 2, 3], 'v').dtype == np.float64
    assert arrays.as_vectors([[1, 2, 3]], 'v').dtype == np.float64
    assert arrays.as_matrix(np.eye(3, dtype=np.float32), 'm').dtype == np.float64


def test_a_right_array_is_passed_on_without_a_copy():
    vectors = np.zeros((4, 3))
    assert arrays.as_vectors(vectors, 'v') is vectors


@pytest.mark.parametrize('shape', [(), (2,), (1, 3), (3, 1)])
def test_a_vector_has_one_axis_of_its_size(shape):
    with pytest.raises(ValueError, match=r'`lever` must have shape \(3,\), got \('):
        arrays.as_vector(np.zeros(shape), 'lever')


def test_a_vector_may_have_another_size():
    assert arrays.as_vector(range(6), 'values', 6).shape == (6,)
    with pytest.raises(ValueError, match=r'`values` must have shape \(6,\), got \(3,\)'):
        arrays.as_vector(range(3), 'values', 6)


@pytest.mark.parametrize('shape', [(3,), (5, 2), (2, 4, 3)])
def test_vectors_are_rows_of_three(shape):
    with pytest.raises(ValueError, match=r'`rate` must have shape \(N, 3\), got \('):
        arrays.as_vectors(np.zeros(shape), 'rate')


def test_a_matrix_has_the_shape_that_was_asked_for():
    assert arrays.as_matrix(np.zeros((2, 6)), 'm', (2, 6)).shape == (2, 6)
    with pytest.raises(ValueError, match=r'`m` must have shape \(2, 6\), got \(6, 2\)'):
        arrays.as_matrix(np.zeros((6, 2)), 'm', [2, 6])


def test_stamps_stay_exact_to_the_nanosecond():
    now = 1_795_000_000_123_456_789  # 2026: as a float it would be a multiple of 256 ns
    assert arrays.as_stamps([now, now + 1], 'stamp_ns').tolist() == [now, now + 1]
    assert arrays.as_stamps(np.array([7], dtype=np.uint32), 'stamp_ns').dtype == np.int64


@pytest.mark.parametrize('value', [[0.5, 1.0], [[1, 2]], 3])
def test_stamps_are_a_row_of_whole_nanoseconds(value):
    needed = r'`stamp_ns` must be an \(N,\) array of integer nanoseconds, got (float|int)64'
    with pytest.raises(ValueError, match=needed):
        arrays.as_stamps(value, 'stamp_ns')
