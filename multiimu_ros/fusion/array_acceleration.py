"""Angular acceleration from an array of accelerometers, joined to the slope of the fused rate.

With the rate w known, what accelerometer i feels at r_i is linear in what is sought:

    y_i = f_i - w x (w x r_i) = f_0 + a x r_i + noise

The specific force f_0 of the base origin is eliminated: about the weighted mean of an axis, force
and lever arm lose it, and what is left is least squares for the angular acceleration a.  The slope
of the fused gyroscopes is one more reading of a, with its own variance; whichever knows a
direction better is believed there.  An array in one point says nothing, two IMUs or a row nothing
about the axis through them: there the slope alone answers.  `docs/derivations/array_geometry.md`.

.. [1] I. Skog, J.-O. Nilsson, P. Handel, A. Nehorai, "Inertial sensor arrays, maximum likelihood,
   and Cramer-Rao bound", IEEE Trans. Signal Process. 64(16), 2016.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.rigid_body import lever_arm_matrix

WIDEST = 1e8  # [(rad/s^2)^2] stands for no knowledge; nothing held by hand turns at 1e4 rad/s^2
HASTE = (
    2.0 * np.pi * 3.0
) ** 2  # [1/s^2] of w''' per a = w', in the fastest waves of a hand, 3 Hz
ROUNDING = 1e-13  # of the trace: information below it is what the sums are rounded by


@compiled
def slope_variance(slope: Vector, noise: Vector, window: float) -> Vector:
    """Return the variance (3,) of the slope of a parabola: noise, and what no parabola follows.

    At the end of a window of h seconds the third derivative of the rate moves the slope by
    h^2 w''' / 10, which beside eight good accelerometers is no longer small.

    Parameters
    ----------
    slope, noise : (3,) arrays
        Angular acceleration [rad/s^2] and its variance by the noise of the rate; infinite if
        unknown.
    window : float
        Time that the parabola spans [s].
    """
    lack = 0.1 * window**2 * HASTE
    variance: Vector = noise + lack * lack * (slope * slope).sum()
    return variance


@compiled
def invert(A: Matrix) -> Matrix:
    """Return the inverse of a symmetric positive definite A (M, M), by Cholesky's factor C."""
    size = len(A)
    C, D = np.zeros((size, size)), np.zeros((size, size))  # A = C C', D = C^-1
    for column in range(size):
        for row in range(column, size):
            rest = A[row, column]
            for k in range(column):
                rest -= C[row, k] * C[column, k]
            C[row, column] = np.sqrt(rest) if row == column else rest / C[column, column]
    for column in range(size):
        D[column, column] = 1.0 / C[column, column]
        for row in range(column + 1, size):
            for k in range(column, row):
                D[row, column] -= C[row, k] * D[k, column]
            D[row, column] /= C[row, row]
    inverse = np.zeros((size, size))
    for row in range(size):
        for column in range(row + 1):
            for k in range(row, size):
                inverse[row, column] += D[k, row] * D[k, column]
            inverse[column, row] = inverse[row, column]
    return inverse


@compiled
def array_information(
    force: Vectors, R: Vectors, lever_arms_b: Vectors, L: Matrix
) -> tuple[Vector, Matrix]:
    """Return S (3, 3) and vector (3,) of the accelerometers about the angular acceleration.

    `S @ da = vector` is the normal equation of what the acceleration behind L (`lever_arm_matrix`)
    lacks, with f_0 eliminated.  Axis by axis, for the sensors weigh differently on each.
    """
    S, vector, mean = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for axis in range(3):
        after, last = (axis + 1) % 3, (axis + 2) % 3
        total, mean_misfit = 0.0, 0.0
        mean[:] = 0.0
        for i in range(len(R)):
            if R[i, axis] < np.inf:
                arm, weight = lever_arms_b[i], 1.0 / R[i, axis]
                total += weight
                for k in range(3):
                    mean[k] += weight * arm[k]
                    mean_misfit -= weight * L[axis, k] * arm[k]
                mean_misfit += weight * force[i, axis]
        if total == 0.0:
            continue
        for i in range(len(R)):
            if R[i, axis] < np.inf:
                arm, weight = lever_arms_b[i], 1.0 / R[i, axis]
                misfit = force[i, axis] - mean_misfit / total
                for k in range(3):
                    misfit -= L[axis, k] * arm[k]
                # (a x r)[axis] = a[after] r[last] - a[last] r[after]
                p = arm[last] - mean[last] / total
                q = mean[after] / total - arm[after]
                S[after, after] += weight * p * p
                S[last, last] += weight * q * q
                S[after, last] += weight * p * q
                S[last, after] += weight * p * q
                vector[after] += weight * p * misfit
                vector[last] += weight * q * misfit
    return vector, S


@compiled
def array_acceleration(
    force: Vectors,
    R: Vectors,
    lever_arms_b: Vectors,
    rate: Vector,
    slope: Vector,
    slope_variance: Vector,
) -> tuple[Vector, Matrix]:
    """Return the angular acceleration that the accelerometers and the slope of the rate tell.

    Parameters
    ----------
    force, R : (K, 3) arrays
        Specific forces in the base frame [m/s^2] and the variances of what does not average out
        between them; infinite where there is no reading, whatever its force.
    lever_arms_b : (K, 3) array
        Sensor origins [m].
    rate : (3,) array
        Fused angular rate, taken as known [rad/s].
    slope, slope_variance : (3,) arrays
        Angular acceleration from the fused rate [rad/s^2] and its variance, as of the function
        `slope_variance`; infinite if unknown.

    Returns
    -------
    (3,) array, (3, 3) array
        Angular acceleration [rad/s^2] and covariance; about `WIDEST` where neither knows it.
    """
    vector, S = array_information(force, R, lever_arms_b, lever_arm_matrix(rate, slope))
    floor = max(1.0 / WIDEST, ROUNDING * (S[0, 0] + S[1, 1] + S[2, 2]))
    for axis in range(3):
        S[axis, axis] += max(1.0 / slope_variance[axis], floor)
    P = invert(S)
    acceleration = slope.copy()
    for row in range(3):
        for k in range(3):
            acceleration[row] += P[row, k] * vector[k]
    return acceleration, P


@compiled
def turning_variance(shares: Vectors, lever_arms_b: Vectors, P: Matrix) -> Vector:
    """Return what the error of the angular acceleration adds to the variance of the fused force.

    Parameters
    ----------
    shares : (K, 3) array
        Shares of the accelerometers in each axis of the fused force; their sum is 1 or 0.
    lever_arms_b : (K, 3) array
        Sensor origins [m].
    P : (3, 3) array
        Covariance of the angular acceleration [(rad/s^2)^2].

    Returns
    -------
    (3,) array
        Variance per axis [(m/s^2)^2], zero for an array that balances about the base origin.
    """
    added = np.zeros(3)
    for axis in range(3):
        after, last = (axis + 1) % 3, (axis + 2) % 3
        p, q = 0.0, 0.0
        for i in range(len(shares)):
            p += shares[i, axis] * lever_arms_b[i, last]
            q -= shares[i, axis] * lever_arms_b[i, after]
        added[axis] = (
            p * p * P[after, after] + 2.0 * p * q * P[after, last] + q * q * P[last, last]
        )
    return added


@compiled
def add_forces(
    N: Matrix, g: Vector, x: Vector, force: Vectors, force_R: Vectors, lever_arms_b: Vectors
) -> tuple[float, float]:
    """Add what the array says of rate and angular acceleration, both unknown, to N dx = g.

    Linearised at x (6,), with f_0 eliminated.  Returns the squared misfit at x, and how many
    readings there are beyond the unknowns.
    """
    squares, freedom = 0.0, -6.0
    w = x[:3]
    L = lever_arm_matrix(w, x[3:])
    J, arm = np.zeros(6), np.zeros(3)
    for axis in range(3):
        after, last = (axis + 1) % 3, (axis + 2) % 3
        mean_arm, mean_force, total = _means(axis, force, force_R, lever_arms_b)
        if total == 0.0:
            continue
        freedom -= 1.0
        for i in range(len(force)):
            if force_R[i, axis] == np.inf:
                continue
            misfit = force[i, axis] - mean_force
            for k in range(3):
                arm[k] = lever_arms_b[i, k] - mean_arm[k]
                misfit -= L[axis, k] * arm[k]
            # d (w x (w x r)) / dw = w r' + (w . r) I - 2 r w',    d (a x r) / da = -[r]x
            for k in range(3):
                J[k] = w[axis] * arm[k] - 2.0 * arm[axis] * w[k]
            J[axis] += w[0] * arm[0] + w[1] * arm[1] + w[2] * arm[2]
            J[3 + axis], J[3 + after], J[3 + last] = 0.0, arm[last], -arm[after]
            freedom += 1.0
            squares += misfit * misfit / force_R[i, axis]
            for row in range(6):
                g[row] += J[row] * misfit / force_R[i, axis]
                for column in range(6):
                    N[row, column] += J[row] * J[column] / force_R[i, axis]
    return squares, freedom


@compiled
def _means(
    axis: int, force: Vectors, force_R: Vectors, lever_arms_b: Vectors
) -> tuple[Vector, float, float]:
    """Return the weighted means of lever arm (3,) and force of an axis, and the weight."""
    mean_arm, mean_force, total = np.zeros(3), 0.0, 0.0
    for i in range(len(force)):
        if force_R[i, axis] < np.inf:
            weight = 1.0 / force_R[i, axis]
            total += weight
            mean_force += weight * force[i, axis]
            for k in range(3):
                mean_arm[k] += weight * lever_arms_b[i, k]
    if total > 0.0:
        mean_arm /= total
        mean_force /= total
    return mean_arm, mean_force, total
