"""What points of one rigid body feel, and the angular acceleration behind it.

An accelerometer at r feels

    f = f_0 + a x r + w x (w x r)

with f_0 at the base origin, rate w and angular acceleration a = dw/dt.  "The translation component
cancels out" (TUM 2.2.2) only where the weighted mean of the lever arms is zero: at 8 cm and
3 rad/s rms one IMU is off by 1.7 m/s^2.  The angular acceleration is the slope at the newest end
of a parabola through the last 20 ms of the fused rate (Savitzky-Golay [1]_, on the stamps as
they are): no lag to first order, and less noise than a difference of two samples.

.. [1] A. Savitzky, M. Golay, "Smoothing and differentiation of data by simplified least squares
   procedures", Anal. Chem. 36(8), 1964.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Stamps, Vector, Vectors
from multiimu_ros.compiled import compiled

SLOPE_WINDOW = 0.02  # [s]
HISTORY = 64  # samples kept: the window at up to 3 kHz


@compiled
def lever_arm_matrix(angular_rate: Vector, angular_acceleration: Vector) -> Matrix:
    """Return L (3, 3) with f(r) - f_0 = L @ r; L = [a]x + [w]x [w]x."""
    w, a = angular_rate, angular_acceleration
    L: Matrix = np.outer(w, w) - (w * w).sum() * np.eye(3)
    L[0, 1] -= a[2]
    L[0, 2] += a[1]
    L[1, 0] += a[2]
    L[1, 2] -= a[0]
    L[2, 0] -= a[1]
    L[2, 1] += a[0]
    return L


def specific_force_at(
    lever_arm_b: Vector, specific_force: Vectors, angular_rate: Vectors, acceleration: Vectors
) -> Vectors:
    """Return what an accelerometer at `lever_arm_b` feels, in the base frame.

    Parameters
    ----------
    lever_arm_b : (3,) array
        Where it sits [m].
    specific_force, angular_rate, acceleration : (N, 3) arrays
        Motion of the base origin: f_0 [m/s^2], w [rad/s], dw/dt [rad/s^2].

    Returns
    -------
    (N, 3) array
        Specific force at the lever arm [m/s^2].
    """
    turning = np.cross(acceleration, lever_arm_b)
    swinging = np.cross(angular_rate, np.cross(angular_rate, lever_arm_b))
    return np.asarray(specific_force + turning + swinging)


@compiled
def end_slope(ages: Scalars, values: Vectors) -> tuple[Vector, float]:
    """Return the slope at age 0 of the parabola fitted to `values` (M, 3) at `ages` (M,) <= 0 [s].

    The second number is the variance of the slope per variance of one value [1/s^2].  Fewer than
    three samples are no parabola: two give their difference, one gives zero, known not at all.
    """
    count = len(ages)
    if count < 2:
        return np.zeros(3), np.inf
    if count == 2:
        interval = ages[1] - ages[0]
        return (values[1] - values[0]) / interval, 2.0 / interval**2
    t = ages / -ages.min()  # the moments are then of order 1
    q = t * t
    s0, s1, s2, s3, s4 = float(count), t.sum(), q.sum(), (q * t).sum(), (q * q).sum()
    # Row of the inverse normal matrix that yields the linear coefficient (cofactors).
    c0 = s2 * s3 - s1 * s4
    c1 = s0 * s4 - s2 * s2
    c2 = s1 * s2 - s0 * s3
    weights = (c0 + c1 * t + c2 * q) / (s1 * c0 + s2 * c1 + s3 * c2) / -ages.min()
    slope = np.zeros(3)
    for k in range(count):
        slope += weights[k] * values[k]
    return slope, (weights * weights).sum()


@compiled
def push_slope(
    stamps: Stamps, rates: Vectors, count: Stamps, stamp: int, angular_rate: Vector
) -> tuple[Vector, float]:
    """Shift a rate into the history (HISTORY samples, `count` (1,) of them valid); fit its slope.

    Returns
    -------
    (3,) array, float
        Angular acceleration at `stamp` [rad/s^2] and the gain of `end_slope` [1/s^2].
    """
    stamps[:-1] = stamps[1:]
    rates[:-1] = rates[1:]
    stamps[-1] = stamp
    rates[-1] = angular_rate
    count[0] = min(count[0] + 1, HISTORY)
    first = HISTORY - 1
    while HISTORY - first < count[0]:
        age = (stamp - stamps[first - 1]) * 1e-9
        # Three samples make the parabola even at 62.5 Hz; older ones than that must be recent.
        if age > SLOPE_WINDOW and (HISTORY - first >= 3 or age > 3.0 * SLOPE_WINDOW):
            break
        first -= 1
    ages = (stamps[first:] - stamp).astype(np.float64) * 1e-9
    return end_slope(ages, rates[first:])
