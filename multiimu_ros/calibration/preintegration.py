"""The turn of a board between two poses, and how it depends on the gyroscope's parameters.

    R' = R [w]x,   w = E (raw - b) - G f

is integrated step by step with the exact exponential of the fourth-order Magnus expansion [1]_,
so that neither the curvature of the rate nor coning is lost (RK4, which Tedaldi uses, has the same
order).  Beside the turn R(E, b, G) go its derivatives: to first order a change of the parameters
turns the end by

    theta_a = sum_i dt_i (R_i,end')_aj [dE_jc (raw - b)_c - E_jc db_c - dG_jc f_c].

.. [1] A. Iserles, S. P. Norsett, "On the solution of linear differential equations in Lie
   groups", Phil. Trans. R. Soc. A 357, 1999.
"""

from collections.abc import Sequence

import numpy as np

from multiimu_ros.arrays import Matrix, Scalars, Vector, Vectors
from multiimu_ros.calibration.poses import Transition
from multiimu_ros.compiled import compiled
from multiimu_ros.rotations import exp_so3, product


@compiled
def integrate_turn(time: Scalars, rate: Vectors, raw: Vectors, force: Vectors) -> Matrix:
    """Integrate one move of n samples.

    Parameters
    ----------
    time : (n,) array
        Instants [s].
    rate : (n, 3) array
        Calibrated angular rate [rad/s].
    raw, force : (n, 3) arrays
        Raw reading less its bias, and calibrated specific force [m/s^2].

    Returns
    -------
    (8, 3, 3) array
        Turn v_begin = R v_end; sum A of dt R'; then sums of dt R'_aj raw_c as [c][a, j], and of
        dt R'_aj force_c likewise: the derivatives of the turn.
    """
    out = np.zeros((8, 3, 3))
    out[0] = np.eye(3)
    slope = _slopes(time, rate)
    for i in range(len(time) - 1):
        h = time[i + 1] - time[i]
        w0, w1 = rate[i], rate[i + 1]
        step = h / 2 * (w0 + w1) - h * h / 12 * (slope[i + 1] - slope[i])
        step += h * h / 12 * np.cross(w0, w1)
        turn = exp_so3(step)
        half = exp_so3(0.5 * step)
        out[0] = product(out[0], turn)
        back = h * half.T
        for block in range(1, 8):
            out[block] = product(turn.T, out[block])
        out[1] += back
        for c in range(3):
            out[2 + c] += 0.5 * (raw[i, c] + raw[i + 1, c]) * back
            out[5 + c] += 0.5 * (force[i, c] + force[i + 1, c]) * back
    return out


@compiled
def _slopes(time: Scalars, rate: Vectors) -> Vectors:
    """Return the derivative at every sample (n, 3): that of the parabola through three."""
    n = len(time)
    slope = np.zeros((n, 3))
    if n < 3:
        return slope
    for i in range(n):
        j = min(max(i, 1), n - 2)
        t0, t1, t2, t = time[j - 1], time[j], time[j + 1], time[i]
        slope[i] = (
            rate[j - 1] * (2 * t - t1 - t2) / ((t0 - t1) * (t0 - t2))
            + rate[j] * (2 * t - t0 - t2) / ((t1 - t0) * (t1 - t2))
            + rate[j + 1] * (2 * t - t0 - t1) / ((t2 - t0) * (t2 - t1))
        )
    return slope


@compiled
def _integrate_all(
    time: Scalars, rate: Vectors, raw: Vectors, force: Vectors, spans: Matrix
) -> Matrix:
    out = np.zeros((len(spans), 8, 3, 3))
    for k in range(len(spans)):
        a, b = int(spans[k, 0]), int(spans[k, 1])
        out[k] = integrate_turn(time[a:b], rate[a:b], raw[a:b], force[a:b])
    return out


def preintegrate(
    time: Scalars,
    raw: Vectors,
    force: Vectors,
    transitions: Sequence[Transition],
    gyroscope: tuple[Matrix, Vector, Matrix],
) -> tuple[Matrix, Matrix]:
    """Integrate every move with the parameters (E, b, G), and differentiate it.

    Parameters
    ----------
    time, raw, force : (N,), (N, 3), (N, 3) arrays
        Instants [s], raw angular rate, calibrated specific force [m/s^2] of the whole recording.
    transitions : sequence of T Transition
        Which samples each move consists of.
    gyroscope : (3, 3), (3,), (3, 3) arrays
        E [rad/s per reading], b [reading], G [rad/s per m/s^2].

    Returns
    -------
    R : (T, 3, 3) array
        Turns, v_begin = R v_end.
    J : (T, 3, 21) array
        Rotation vector at the end per change of E (row by row), b and G (row by row) [rad].
    """
    E, b, G = gyroscope
    centred = np.ascontiguousarray(raw - b)
    rate = np.ascontiguousarray(centred @ E.T - force @ G.T)
    spans = np.array([[t.begin, t.end] for t in transitions], dtype=np.float64).reshape(-1, 2)
    sums = _integrate_all(time, rate, centred, np.ascontiguousarray(force), spans)
    J = np.empty((len(sums), 3, 21))
    for c in range(3):
        J[:, :, c:9:3] = sums[:, 2 + c]
        J[:, :, 12 + c : 21 : 3] = -sums[:, 5 + c]
    J[:, :, 9:12] = -sums[:, 1] @ E
    return sums[:, 0], J
