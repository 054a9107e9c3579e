"""One step of SCAAT: coast by a time, or correct by one IMU; see `scaat`.

State x (12,) is (angular rate w, angular acceleration a, force at the base origin f_0, jerk j),
P (12, 12) its covariance; both are changed in place.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled

SIZE = 12  # of the state
RATE, ACCELERATION, FORCE, JERK = 0, 3, 6, 9  # where its blocks begin


@compiled
def force_jacobian(angular_rate: Vector, lever_arm_b: Vector) -> tuple[Matrix, Matrix]:
    """Return the derivatives (3, 3) of a x r + w x (w x r) by w and by a."""
    w, r = angular_rate, lever_arm_b
    along = w[0] * r[0] + w[1] * r[1] + w[2] * r[2]
    by_rate, by_acceleration = np.empty((3, 3)), np.zeros((3, 3))
    for i in range(3):
        for j in range(3):
            by_rate[i, j] = w[i] * r[j] - 2.0 * r[i] * w[j]
        by_rate[i, i] += along
        j, k = (i + 1) % 3, (i + 2) % 3
        by_acceleration[i, j] = r[k]
        by_acceleration[i, k] = -r[j]
    return by_rate, by_acceleration


@compiled
def predict(x: Vector, P: Matrix, walk: Vector, dt: float) -> None:
    """Coast by dt [s]: P <- F P F' + Q, exact for slopes that walk with density `walk` (2,)."""
    for i in range(SIZE):
        if i // 3 % 2 == 0:  # a rate or a force, whose slope is three entries on
            x[i] += dt * x[i + 3]
            for j in range(SIZE):
                P[i, j] += dt * P[i + 3, j]
    for j in range(SIZE):
        if j // 3 % 2 == 0:
            for i in range(SIZE):
                P[i, j] += dt * P[i, j + 3]
    for i in range(SIZE):
        if i // 3 % 2 == 0:
            q = walk[i // 6]
            P[i, i] += q * dt**3 / 3.0
            P[i, i + 3] += q * dt**2 / 2.0
            P[i + 3, i] += q * dt**2 / 2.0
            P[i + 3, i + 3] += q * dt


@compiled
def correct(x: Vector, P: Matrix, h: Vector, residual: float, R: float) -> None:
    """Correct by one number, measured through the row h (12,); P in Joseph's form."""
    v, K, u = np.zeros(SIZE), np.empty(SIZE), np.zeros(SIZE)
    S = R
    for j in range(SIZE):
        if h[j] != 0.0:
            for i in range(SIZE):
                v[i] += P[i, j] * h[j]
    for j in range(SIZE):
        S += h[j] * v[j]
    for i in range(SIZE):
        K[i] = v[i] / S
        x[i] += K[i] * residual
        for j in range(SIZE):
            P[i, j] -= K[i] * v[j]  # (I - K h) P
            u[i] += P[i, j] * h[j]
    # ... (I - K h)' + K R K': stays positive where P and R differ by more than a float holds
    for i in range(SIZE):
        for j in range(i, SIZE):
            P[i, j] += R * (K[i] * K[j]) - 0.5 * (u[i] * K[j] + u[j] * K[i])
            P[j, i] = P[i, j]


@compiled
def correct_by_imu(
    x: Vector, P: Matrix, values: Vector, lever_arm_b: Vector, R: Vector, trusted: Vector
) -> None:
    """Correct by the rate, then by the force, of one IMU; R (6,) are their variances."""
    h = np.zeros(SIZE)
    if trusted[0] > 0.0:
        for i in range(3):
            h[i] = 1.0
            correct(x, P, h, values[i] - x[i], R[i] / trusted[0])
            h[i] = 0.0
    if trusted[1] > 0.0:
        w, r = x[RATE:ACCELERATION].copy(), lever_arm_b
        by_rate, by_acceleration = force_jacobian(w, r)
        along, square = (w * r).sum(), (w * w).sum()
        for i in range(3):
            h[RATE:FORCE] = 0.0
            expected = x[FORCE + i] + w[i] * along - r[i] * square
            for j in range(3):
                h[RATE + j], h[ACCELERATION + j] = by_rate[i, j], by_acceleration[i, j]
                # x has moved with the axes before, the point of linearisation has not
                expected += by_rate[i, j] * (x[RATE + j] - w[j])
                expected += by_acceleration[i, j] * x[ACCELERATION + j]
            h[FORCE + i] = 1.0
            correct(x, P, h, values[3 + i] - expected, R[3 + i] / trusted[1])
            h[FORCE + i] = 0.0
