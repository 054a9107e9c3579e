"""What the fusion stage adds up over a tenth of a second, gathered over rests and motions.

A block (K + 1, 7) is that of `ArrayFusion.block`.  Its mean reading is an affine function of its
mean rate, so means lose nothing that a scale could hide in, and average the white noise.
"""

from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.compiled import compiled

SIZE = 13
SECONDS, RATE_GAP, FORCE_GAP = 0, slice(1, 4), slice(4, 7)  # columns: 1, reading - fused, fused
RATE, FORCE = slice(7, 10), slice(10, 13)
TURN = np.array([0, 7, 8, 9])  # what the regression explains with: a constant and the rate
LEAST_TURN = 1e-6  # [rad^2/s^2 s] added to the moments, so that they can be inverted


class Fit(NamedTuple):
    """What motion shows of K IMUs, and its variance: of noise, or of what a fit leaves if larger.

    Parameters
    ----------
    response, response_variance : (K, 3, 3) arrays
        d(reading)/d(rate), the identity taken off [-].
    gap, gap_variance : (K, 6) arrays
        Reading - fused: of the rate at rate 0 [rad/s], of the force on average [m/s^2].
    """

    response: Matrix
    response_variance: Matrix
    gap: Vectors
    gap_variance: Vectors


def fit_motion(moments: Matrix, density: Vectors, alike_s: float) -> Fit:
    """Fit reading - fused = constant + response @ rate, and the mean of the forces.

    Parameters
    ----------
    moments : (K, SIZE, SIZE) array
        As `add_motion` sums them.
    density : (K, 6) array
        White noise density [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)].
    alike_s : float
        How long what the fit leaves is alike [s].
    """
    seconds = np.maximum(moments[:, :1, SECONDS], LEAST_TURN)
    mean_square = np.diagonal(moments, axis1=1, axis2=2) / seconds
    inverse = np.linalg.inv(moments[:, TURN[:, None], TURN] + LEAST_TURN * np.eye(4))
    cross = moments[:, TURN, RATE_GAP]
    fit = inverse @ cross  # (K, 4, 3)
    mean_force = moments[:, SECONDS, FORCE_GAP] / seconds
    explained = np.hstack([np.einsum('kij,kij->kj', fit, cross) / seconds, mean_force**2])
    left = mean_square[:, 1:7] - explained
    noise = np.maximum(density**2, alike_s * left)
    spread = np.diagonal(inverse, axis1=1, axis2=2)
    return Fit(
        fit[:, 1:].transpose(0, 2, 1),
        noise[:, :3, None] * spread[:, None, 1:],
        np.hstack([fit[:, 0], mean_force]),
        np.hstack([noise[:, :3] * spread[:, :1], noise[:, 3:] / seconds]),
    )


@compiled
def add_rest(block: Vectors, rest: Vectors, keep: float, span_s: float) -> None:
    """Add the means of a block (K + 1, 7) that lasted `span_s` [s] to `rest` (K, SIZE).

    What was there counts `keep` times; the columns are weighted in seconds.
    """
    row = np.ones(SIZE)
    for i in range(len(rest)):
        _block_mean(block, i, row)
        weight = span_s * row[0]
        for a in range(SIZE):
            rest[i, a] = keep * rest[i, a] + weight * row[a]
    _empty(block)


@compiled
def add_motion(block: Vectors, moments: Matrix, keep: float, span_s: float) -> None:
    """Add the products of the means of a block to `moments` (K, SIZE, SIZE); see `add_rest`."""
    row = np.ones(SIZE)
    for i in range(len(moments)):
        _block_mean(block, i, row)
        weight = span_s * row[0]
        for a in range(SIZE):
            for b in range(SIZE):
                moments[i, a, b] = keep * moments[i, a, b] + weight * row[a] * row[b]
    _empty(block)


@compiled
def _block_mean(block: Vectors, i: int, row: Vector) -> None:
    """Fill `row` with 1 and the means of reading - fused and fused; 0 for 1 if scans lack."""
    last = len(block) - 1
    scans = block[last, 6]
    row[0] = 1.0 if scans > 0.0 and block[i, 6] == scans else 0.0
    for axis in range(6):
        row[1 + axis] = row[0] * (block[i, axis] - block[last, axis]) / max(scans, 1.0)
        row[7 + axis] = block[last, axis] / max(scans, 1.0)


@compiled
def _empty(block: Vectors) -> None:
    for i in range(len(block)):
        for column in range(7):
            block[i, column] = 0.0
