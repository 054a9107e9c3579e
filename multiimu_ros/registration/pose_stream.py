"""The motion behind a tracker's poses: rates and accelerations by local polynomials.

Within +-`half_width` of an instant the positions, and the rotation vectors phi_k of R_c' R_k about
the pose R_c in the middle, are fitted by polynomials of time (Savitzky and Golay [1]_, here for
uneven stamps and gaps). Their coefficients are position, velocity and acceleration, and

    R = R_c exp(phi_0),    w = J_r(phi_0) phi',    dw/dt = phi'' + O(phi_0).                (1)

The tracker knows nothing of gravity: a resting IMU feels R_wt' [0, 0, g] where the second
derivative of position is zero, so gravity must be put back (thesis 6.2.2 takes it out of the
IMU's reading, which asks for its attitude; here the tracker has it). An instant whose window has
lost a third of its poses is NaN.

.. [1] A. Savitzky, M. J. E. Golay, "Smoothing and differentiation of data by simplified least
   squares procedures", Analytical Chemistry 36(8), 1964.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import (
    as_stamps,
    as_vectors,
    Flags,
    Matrix,
    NANOSECONDS,
    Scalars,
    Stamps,
    Vector,
    Vectors,
)

MIN_SHARE = 2 / 3  # of a window's samples that must be there
MIN_SPARE = 2  # samples beyond the number of coefficients


@dataclass(frozen=True)
class TrackerPoses:
    """What a tracker says about its target t, in its own frame w.

    Parameters
    ----------
    stamp_ns : (N,) int array
        Instant of each pose, rising [ns].
    position_w : (N, 3) array
        Of the target's origin, NaN where it was not seen [m].
    R_wt : (N, 3, 3) array
        v_w = R_wt v_t, NaN where it was not seen.
    """

    stamp_ns: Stamps
    position_w: Vectors
    R_wt: Matrix

    def __post_init__(self) -> None:
        object.__setattr__(self, 'stamp_ns', as_stamps(self.stamp_ns, 'stamp_ns'))
        object.__setattr__(self, 'position_w', as_vectors(self.position_w, 'position_w'))
        count = len(self.stamp_ns)
        if len(self.position_w) != count or np.shape(self.R_wt) != (count, 3, 3):
            came = f'{self.position_w.shape} and {np.shape(self.R_wt)}'
            msg = f'`position_w` and `R_wt` must be ({count}, 3) and ({count}, 3, 3) like '
            msg += f'`stamp_ns`, got {came}.'
            raise ValueError(msg)
        if (np.diff(self.stamp_ns) <= 0).any():
            msg = '`stamp_ns` must rise from pose to pose; sort the poses and drop repeated ones.'
            raise ValueError(msg)

    @property
    def seen(self) -> Flags:
        """Where there is a whole pose (N,)."""
        there = np.isfinite(self.position_w).all(axis=1)
        return np.asarray(there & np.isfinite(self.R_wt).all(axis=(1, 2)), dtype=np.bool_)


@dataclass(frozen=True)
class TargetMotion:
    """The motion of a tracker's target, at the N stamps of its poses; NaN where unknown.

    Parameters
    ----------
    stamp_ns : (N,) int array
        [ns].
    R_wt : (N, 3, 3) array
        Smoothed attitude.
    angular_rate_t, angular_acceleration_t : (N, 3) arrays
        [rad/s], [rad/s^2].
    acceleration_w : (N, 3) array
        Of the target's origin, without gravity [m/s^2].
    position_sigma, rotation_sigma : float
        Noise of one pose, per axis, as it scatters about the polynomials [m], [rad].
    """

    stamp_ns: Stamps
    R_wt: Matrix
    angular_rate_t: Vectors
    angular_acceleration_t: Vectors
    acceleration_w: Vectors
    position_sigma: float
    rotation_sigma: float

    def specific_force_t(self, up_w: Vector) -> Vectors:
        """Return what an ideal accelerometer at the target's origin feels (N, 3) [m/s^2].

        Parameters
        ----------
        up_w : (3,) array
            Gravity turned round: [0, 0, +9.81] for a tracker whose z axis points up [m/s^2].
        """
        return np.asarray(np.einsum('nji,nj->ni', self.R_wt, self.acceleration_w + up_w))


@dataclass(frozen=True)
class Windows:
    """Which samples lie around each of M instants: (M, W) indices, times [s], and flags."""

    index: Stamps
    time: Scalars
    inside: Flags


def windows_around(times: Scalars, centres: Scalars, half_width: float) -> Windows:
    """Gather the samples at `times` (N,) within `half_width` of each of `centres` (M,) [s]."""
    first = np.searchsorted(times, centres - half_width)
    last = np.searchsorted(times, centres + half_width, side='right')
    index = first[:, np.newaxis] + np.arange(max(int((last - first).max(initial=1)), 1))
    inside = index < last[:, np.newaxis]
    index = np.minimum(index, len(times) - 1)
    return Windows(index, np.where(inside, times[index] - centres[:, np.newaxis], 0.0), inside)


def fit_polynomials(
    windows: Windows, values: Matrix, half_width: float, order: int
) -> tuple[Matrix, float]:
    """Fit a polynomial in each window.

    Parameters
    ----------
    windows : Windows
        Times of the samples.
    values : (M, W, C) array
        Samples of C channels; NaN is left out.
    half_width : float
        Of the windows [s].
    order : int
        Of the polynomials.

    Returns
    -------
    derivatives : (M, order + 1, C) array
        At the centres: value, first derivative ...; NaN where a window is too empty.
    sigma : float
        Standard deviation of one coordinate about the polynomials.
    """
    there = windows.inside & np.isfinite(values).all(axis=2)
    power = np.arange(order + 1)
    V = there[..., np.newaxis] * (windows.time[..., np.newaxis] / half_width) ** power
    values = np.where(there[..., np.newaxis], values, 0.0)
    counts = there.sum(axis=1)
    full = np.median(windows.inside.sum(axis=1))
    good = (counts >= MIN_SHARE * full) & (counts >= order + 1 + MIN_SPARE)
    derivatives = np.full((len(V), order + 1, values.shape[2]), np.nan)
    V, values = V[good], values[good]
    coefficients = np.linalg.solve(V.transpose(0, 2, 1) @ V, V.transpose(0, 2, 1) @ values)
    factor = np.cumprod(np.maximum(power, 1)) / half_width**power
    derivatives[good] = coefficients * factor[:, np.newaxis]
    square = float(np.sum((values - V @ coefficients) ** 2))
    freedom = values.shape[2] * int(np.sum(counts[good] - order - 1))
    return derivatives, float(np.sqrt(square / freedom)) if freedom else float('nan')


def differentiate(poses: TrackerPoses, half_width: float, order: int) -> TargetMotion:
    """Return rate and accelerations of a tracker's target, (1)."""
    times = (poses.stamp_ns - poses.stamp_ns[0]) / NANOSECONDS
    windows = windows_around(times, times, half_width)
    seen = poses.seen
    position = poses.position_w[windows.index]
    places, position_sigma = fit_polynomials(windows, position, half_width, order)
    R_wt = np.where(seen[:, np.newaxis, np.newaxis], poses.R_wt, np.eye(3))
    turns = np.einsum('nji,nwjk->nwik', R_wt, R_wt[windows.index])
    phi = (
        Rotation.from_matrix(turns.reshape(-1, 3, 3)).as_rotvec().reshape(*windows.index.shape, 3)
    )
    phi[~(seen[:, np.newaxis] & np.take(seen, windows.index))] = np.nan
    angles, rotation_sigma = fit_polynomials(windows, phi, half_width, order)
    lost = np.asarray(~np.isfinite(angles).all(axis=(1, 2)), dtype=np.bool_)
    start = np.where(lost[:, np.newaxis], 0.0, angles[:, 0])
    smooth = R_wt @ Rotation.from_rotvec(start).as_matrix()
    smooth[lost] = np.nan
    rate = angles[:, 1] - 0.5 * np.cross(start, angles[:, 1])  # J_r to first order
    return TargetMotion(
        poses.stamp_ns, smooth, rate, angles[:, 2], places[:, 2], position_sigma, rotation_sigma
    )
