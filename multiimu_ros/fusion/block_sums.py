"""What the fusion stage adds up over a tenth of a second, gathered over rests and motions.

A block (K + 1, 7) is that of `ArrayFusion.block`.  Its mean reading is an affine function of its
mean rate, so means lose nothing that a scale could hide in, and average the white noise.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.compiled import compiled

REST_SIZE = 13
MOTION_SIZE = 7
LEAST_TURN = 1e-6  # [rad^2/s^2 s] added to the moments, so that they can be inverted


def slopes(moments: Matrix, density: Vectors, alike_s: float) -> tuple[Matrix, Matrix]:
    """Fit reading - fused = constant + slope @ rate of K IMUs.

    Parameters
    ----------
    moments : (K, 7, 7) array
        As `add_motion` sums them.
    density : (K, 3) array
        White noise density [rad/s/sqrt(Hz)].
    alike_s : float
        How long what the fit leaves is alike [s].

    Returns
    -------
    (K, 3, 3) array
        d(reading)/d(rate), the identity taken off [-].
    (K, 3, 3) array
        Its variance: that of the white noise, or of what the fit leaves where this is more.
    """
    gram = moments[:, :4, :4] + LEAST_TURN * np.eye(4)
    inverse = np.linalg.inv(gram)
    fit = inverse @ moments[:, :4, 4:]  # (K, 4, 3)
    explained = np.einsum('kij,kij->kj', fit, moments[:, :4, 4:])
    seconds = np.maximum(moments[:, :1, 0], LEAST_TURN)
    left = (np.diagonal(moments, axis1=1, axis2=2)[:, 4:] - explained) / seconds
    noise = np.maximum(density**2, alike_s * left)
    variance = noise[:, :, None] * np.diagonal(inverse, axis1=1, axis2=2)[:, None, 1:]
    return fit[:, 1:].transpose(0, 2, 1), variance


@compiled
def add_rest(block: Vectors, rest: Vectors, keep: float, span_s: float) -> None:
    """Add the means of a block (K + 1, 7) that lasted `span_s` [s] to `rest` (K, REST_SIZE).

    What was there counts `keep` times.  Columns: seconds; reading - fused, six; fused, six.
    """
    last = len(rest)
    row = np.ones(REST_SIZE)
    for i in range(last):
        _block_mean(block, i, row)
        weight = span_s * row[0]
        for axis in range(REST_SIZE):
            rest[i, axis] = keep * rest[i, axis] + weight * row[axis]
    _empty(block)


@compiled
def add_motion(block: Vectors, moments: Matrix, keep: float, span_s: float) -> None:
    """Add the means of a block (K + 1, 7) to the moments (K, MOTION_SIZE, MOTION_SIZE).

    The moments are those of (1, fused rate, reading - fused rate), weighted in seconds.
    """
    last = len(moments)
    row, rates = np.ones(REST_SIZE), np.ones(MOTION_SIZE)
    for i in range(last):
        _block_mean(block, i, row)
        weight = span_s * row[0]
        for axis in range(3):
            rates[1 + axis], rates[4 + axis] = row[7 + axis], row[1 + axis]
        for a in range(MOTION_SIZE):
            for b in range(MOTION_SIZE):
                moments[i, a, b] = keep * moments[i, a, b] + weight * rates[a] * rates[b]
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
