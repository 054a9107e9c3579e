"""Small-rotation maths on matrices, for the compiled kernels.

APIs speak scipy `Rotation`; filters keep a matrix `R_nb` and perturb it on the right,
`R_nb = R_nb_hat @ exp(theta)` with theta in the body frame.  Exponential and logarithm are the
textbook Rodrigues formulas [1]_ with series where the angle is too small to divide by.

.. [1] J. Sola, J. Deray, D. Atchuthan, "A micro Lie theory for state estimation in robotics",
   arXiv 1812.01537, 2018, eqs. (133)-(143).
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.compiled import compiled

SERIES_BELOW = 0.2  # [rad] below it, angle - sin(angle) has lost three digits to cancellation


@compiled
def _coefficients(angle: float) -> tuple[float, float, float]:
    """Return sin(x)/x, (1 - cos(x))/x^2 and (x - sin(x))/x^3, good to 1e-14 at every x >= 0."""
    square = angle * angle
    if angle < SERIES_BELOW:  # the first dropped term is below 2e-17 of the first kept one
        q = square
        a = 1.0 - q / 6.0 * (
            1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0 * (1.0 - q / 110.0)))
        )
        b = 0.5 - q / 24.0 * (
            1.0 - q / 30.0 * (1.0 - q / 56.0 * (1.0 - q / 90.0 * (1.0 - q / 132.0)))
        )
        c = 1.0 - q / 20.0 * (1.0 - q / 42.0 * (1.0 - q / 72.0 * (1.0 - q / 110.0)))
        return a, b, c / 6.0
    sine = np.sin(angle)
    return sine / angle, 2.0 * np.sin(0.5 * angle) ** 2 / square, (angle - sine) / (square * angle)


@compiled
def skew(v: Vector) -> Matrix:
    """Return the (3, 3) matrix S of the cross product, S @ u = v x u."""
    S = np.zeros((3, 3))
    S[0, 1], S[0, 2], S[1, 2] = -v[2], v[1], -v[0]
    S[1, 0], S[2, 0], S[2, 1] = v[2], -v[1], v[0]
    return S


@compiled
def product(A: Matrix, B: Matrix) -> Matrix:
    """Return A @ B for small matrices of any layout; for these the sums are quicker than BLAS."""
    C = np.zeros((A.shape[0], B.shape[1]))
    for i in range(A.shape[0]):
        for k in range(A.shape[1]):
            for j in range(B.shape[1]):
                C[i, j] += A[i, k] * B[k, j]
    return C


@compiled
def exp_so3(theta: Vector) -> Matrix:
    """Return the (3, 3) rotation by the rotation vector `theta` (3,) [rad]."""
    a, b, _ = _coefficients(np.sqrt(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2))
    S = skew(theta)
    return np.eye(3) + a * S + b * product(S, S)


@compiled
def log_so3(R: Matrix) -> Vector:
    """Return the rotation vector (3,) [rad] of the rotation `R` (3, 3), of angle below pi.

    The axis comes from the antisymmetric part; at angles within 1e-6 of pi that part vanishes
    and the axis is lost, so the filters, whose errors are small, are its only callers.
    """
    axis = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = 0.5 * np.sqrt(axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    angle = np.arctan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0))
    # Near zero asin(x)/x = 1 + x^2/6 + ...
    scale = 0.5 + sine**2 / 12.0 if sine < 1e-6 and angle < 1.0 else 0.5 * angle / sine
    theta: Vector = scale * axis
    return theta


@compiled
def right_jacobian(theta: Vector) -> Matrix:
    """Return J (3, 3) with exp(theta + d) = exp(theta) exp(J d) to first order in d."""
    _, b, c = _coefficients(np.sqrt(theta[0] ** 2 + theta[1] ** 2 + theta[2] ** 2))
    S = skew(theta)
    return np.eye(3) - b * S + c * product(S, S)


@compiled
def renormalise(R: Matrix) -> Matrix:
    """Return the nearest rotation to first order; `R` (3, 3) is orthogonal but for rounding."""
    return 1.5 * R - 0.5 * product(R, product(R.T, R))


@compiled
def as_quaternion(R: Matrix) -> Vector:
    """Return the unit quaternion [x, y, z, w] (4,) of the rotation `R` (3, 3), with w >= 0.

    Shepperd's method: the largest of the four squares is the divisor, so it never cancels [2]_.

    .. [2] S. W. Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1(3), 1978.
    """
    q = np.empty(4)
    squares = np.array([R[0, 0], R[1, 1], R[2, 2], R[0, 0] + R[1, 1] + R[2, 2]])
    k = np.argmax(squares)
    if k == 3:
        q[0], q[1], q[2] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
        q[3] = 1.0 + squares[3]
    else:
        i, j = (k + 1) % 3, (k + 2) % 3
        q[k] = 1.0 + R[k, k] - R[i, i] - R[j, j]
        q[i], q[j] = R[k, i] + R[i, k], R[k, j] + R[j, k]
        q[3] = R[j, i] - R[i, j]
    sign = 1.0 if q[3] >= 0.0 else -1.0
    q *= sign / np.sqrt((q * q).sum())
    return q
