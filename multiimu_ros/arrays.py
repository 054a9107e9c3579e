"""Names for the shapes that the package passes around, and the checks at its doors.

Time is axis 0 and xyz the last axis; everything is float64 except stamps (int64 nanoseconds)
and flags.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Vector = NDArray[np.float64]  # (3,), or (M,) where the docstring says so
Vectors = NDArray[np.float64]  # (N, 3), or (N, K, 3) for K sensors
Scalars = NDArray[np.float64]  # (N,)
Matrix = NDArray[np.float64]  # (M, M), or (N, M, M)
Stamps = NDArray[np.int64]  # (N,) nanoseconds
Flags = NDArray[np.bool_]  # (N,)

NANOSECONDS = 1_000_000_000  # in a second


def as_vector(value: ArrayLike, name: str, size: int = 3) -> Vector:
    """Return `value` as a (size,) float array, or raise a ValueError that calls it `name`."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (size,):
        msg = f'`{name}` must have shape ({size},), got {array.shape}.'
        raise ValueError(msg)
    return array


def as_vectors(value: ArrayLike, name: str) -> Vectors:
    """Return `value` as an (N, 3) float array, or raise a ValueError that calls it `name`."""
    array = np.asarray(value, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        msg = f'`{name}` must have shape (N, 3), got {array.shape}.'
        raise ValueError(msg)
    return array


def as_matrix(value: ArrayLike, name: str, shape: Sequence[int] = (3, 3)) -> Matrix:
    """Return `value` as a float array of that shape, or raise a ValueError naming it."""
    array = np.asarray(value, dtype=np.float64)
    if array.shape != tuple(shape):
        msg = f'`{name}` must have shape {tuple(shape)}, got {array.shape}.'
        raise ValueError(msg)
    return array


def as_stamps(value: ArrayLike, name: str) -> Stamps:
    """Return `value` as an (N,) int64 array of nanoseconds; floats are refused (0.24 us steps)."""
    array = np.asarray(value)
    if array.ndim != 1 or not np.issubdtype(array.dtype, np.integer):
        came = f'{array.dtype} of shape {array.shape}'
        msg = f'`{name}` must be an (N,) array of integer nanoseconds, got {came}.'
        raise ValueError(msg)
    return array.astype(np.int64)
