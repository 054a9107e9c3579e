"""The angular rate while gyroscopes are at their limit, bridged by the accelerometer array [1]_.

A gyroscope axis at full scale says no more than that the rate is beyond it.  The accelerometers
feel the turn all the same (`docs/derivations/array_geometry.md`):

    f_i = f_0 + a x r_i + w x (w x r_i) + noise,        w_n = w_(n-1) + dt (a_(n-1) + a_n) / 2

Integrating a carries the rate over the gap, the centripetal term holds the sum near the truth, and
the axes that still measure stay as they were.  The state is (w, a), for an error of w is one of a
where the array cannot tell them apart; f_0 is eliminated axis by axis.  Each scan is one
least-squares problem in (w, a): its start, the prediction, decides between w and -w, which the
accelerometers cannot.

.. [1] I. Skog, J.-O. Nilsson, P. Handel, A. Nehorai, "Inertial sensor arrays, maximum likelihood,
   and Cramer-Rao bound", IEEE Trans. Signal Process. 64(16), 2016.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.array_acceleration import add_forces, invert

NEAR_LIMIT = 0.998  # of full scale; the last counts before it are not always reached
SETTLING, ITERATIONS = 2, 20  # Gauss-Newton; the misfit is judged once it has settled
ENOUGH = 1e-6  # sigmas squared: a step, or a rise of the misfit, below it does not count
AGREED = 0.01  # part by which the inflation of a variance may still change
MOTION_LASTS = 0.1  # [s] for which an angular acceleration keeps its sign: scans add up
WALK_MEMORY = 1.0  # [s]


@compiled
def saturated(values: Vectors, to_sensor: Matrix, limits: Vectors, out: Vectors) -> bool:
    """Mark the sensor axes at full scale; say whether there is one.

    Parameters
    ----------
    values : (K, 6) array
        Readings in the base frame, calibrated [rad/s], [m/s^2]; NaN is no reading.
    to_sensor : (K, 6, 7) array
        [A | c] from there back to the raw readings, A @ values + c.
    limits : (K, 6) array
        Full scale of the raw axes [rad/s], [m/s^2]; infinite where unknown.
    out : (K, 6) array
        Becomes 1 where a raw axis is at its limit, else 0.
    """
    found = False
    for i in range(len(values)):
        for axis in range(6):
            raw = to_sensor[i, axis, 6]
            for k in range(6):
                if to_sensor[i, axis, k] != 0.0:  # a missing force must not hide a rate
                    raw += to_sensor[i, axis, k] * values[i, k]
            out[i, axis] = 0.0
            if abs(raw) >= NEAR_LIMIT * limits[i, axis]:
                out[i, axis] = 1.0
                found = True
    return found


@compiled
def start_bridge(
    rate: Vector, rate_variance: Vector, acceleration: Vector, P_acceleration: Matrix
) -> tuple[Vector, Matrix]:
    """Return state (6,) and covariance (6, 6) of the last scan before a gap."""
    x, P = np.zeros(6), np.zeros((6, 6))
    for row in range(3):
        x[row], x[3 + row] = rate[row], acceleration[row]
        P[row, row] = rate_variance[row]
        for column in range(3):
            P[3 + row, 3 + column] = P_acceleration[row, column]
    return x, P


@compiled
def learn_walk(walk: Vector, before: Vector, now: Vector, noise: Vector, dt: float) -> None:
    """Follow, in place, how much of the turn between two scans the trapezoid misses.

    Vibration above half the scan rate shows in samples of the angular acceleration, not in the
    rate, and grows with the motion.  So what is learnt while the gyroscopes see is a part.

    Parameters
    ----------
    walk : (2,) array
        Sums of squares, missed and turned, which fade [(rad/s)^2]; begin with zeros.
    before, now : (6,) arrays
        Rate and angular acceleration of two scans, `dt` seconds apart.
    noise : (3,) array
        Variance of what is missed by the noise of the four of them [(rad/s)^2].
    """
    walk *= max(1.0 - dt / WALK_MEMORY, 0.0)
    for axis in range(3):
        turned = 0.5 * dt * (before[3 + axis] + now[3 + axis])
        missed = now[axis] - before[axis] - turned
        walk[0] += missed * missed - noise[axis]
        walk[1] += turned * turned


@compiled
def bridge_rate(
    state: Vector,
    P: Matrix,
    dt: float,
    acceleration_sigma: Vector,
    walk: Vector,
    gyro: Vectors,
    gyro_R: Vectors,
    at_limit: Vectors,
    to_sensor: Matrix,
    force: Vectors,
    force_R: Vectors,
    lever_arms_b: Vectors,
) -> tuple[Vector, Matrix]:
    """Return rate and angular acceleration of this scan, and their covariance.

    Parameters
    ----------
    state, P : (6,), (6, 6) arrays
        Rate and angular acceleration of the last scan [rad/s], [rad/s^2]: `start_bridge` or the
        last answer.
    dt : float
        Time since then [s].
    acceleration_sigma : (3,) array
        What the motion allows, where the array does not see the angular acceleration [rad/s^2].
    walk : (2,) array
        From `learn_walk`.
    gyro : (K, 3) array
        Rates in the base frame [rad/s], of which sensor axes may be at their limit.
    gyro_R : (K, 3) array
        Variances of the sensor axes [(rad/s)^2]; infinite where there is no reading.
    at_limit, to_sensor : (K, 6), (K, 6, 7) arrays
        What `saturated` said, and was told.
    force, force_R, lever_arms_b : (K, 3) arrays
        As `array_acceleration` has them.  An error that lasts for T seconds (bias, scale) counts
        T / dt times in `force_R`: here scans add up, and it does not average out.

    Returns
    -------
    (6,) array, (6, 6) array
        State and covariance.
    """
    prior, information = _predicted(state, P, dt, acceleration_sigma, walk)
    start = state.copy()
    for axis in range(3):
        start[axis] += dt * state[3 + axis]
    x, step, covariance = start.copy(), np.zeros(6), np.zeros((6, 6))
    pull = prior - information @ start
    inflation, least, settled = 1.0, np.inf, 0
    for _ in range(ITERATIONS):
        moved = information @ (x - start)
        N, g, cost = information.copy(), pull - moved, ((moved - 2.0 * pull) * (x - start)).sum()
        cost += _add_gyroscopes(N, g, x, gyro, gyro_R, at_limit, to_sensor)
        misfit, freedom = add_forces(N, g, x, force, force_R * inflation, lever_arms_b)
        if cost + misfit > least + ENOUGH:  # too far: the forces are quadratic in the rate
            step *= 0.5
            x -= step
            continue
        least = cost + misfit
        covariance = invert(N)
        step = covariance @ g
        x += step
        settled += 1
        if settled > SETTLING:
            judged = _inflation(inflation * misfit, freedom)
            if (step * g).sum() < ENOUGH and abs(judged - inflation) < AGREED * inflation:
                break
            inflation, least = judged, np.inf
    _hold_beyond_limits(x, covariance, gyro, gyro_R, at_limit, to_sensor)
    return x, covariance


@compiled
def _inflation(misfit: float, freedom: float) -> float:
    """Return by what the variance of the forces must grow to explain their squared misfit.

    Stamps that differ and a board that bends leave more than the noise, and only the scan itself
    tells how much.  What chance does, at three standard errors, is no reason.
    """
    if freedom < 1.0 or misfit < freedom + 3.0 * np.sqrt(2.0 * freedom):
        return 1.0
    return misfit / freedom


@compiled
def _predicted(
    state: Vector, P: Matrix, dt: float, acceleration_sigma: Vector, walk: Vector
) -> tuple[Vector, Matrix]:
    """Return information vector (6,) and matrix (6, 6) of the trapezoid w - dt/2 a = u.

    u = w + dt/2 a of the last scan.  The new a is known by what the motion allows alone.
    """
    half, lasting = 0.5 * dt, max(MOTION_LASTS / dt, 1.0)
    u, U = np.zeros(3), np.zeros((3, 3))
    missed = 0.0
    if walk[1] > 0.0:
        missed = max(walk[0] / walk[1], 0.0) * dt * dt * (state[3:] * state[3:]).sum()
    for row in range(3):
        u[row] = state[row] + half * state[3 + row]
        for column in range(3):
            U[row, column] = P[row, column] + half * half * P[3 + row, 3 + column]
            U[row, column] += half * (P[row, 3 + column] + P[3 + row, column])
        U[row, row] += missed
    known = invert(U)
    vector, matrix = np.zeros(6), np.zeros((6, 6))
    for row in range(3):
        for column in range(3):
            vector[row] += known[row, column] * u[column]
            matrix[row, column] = known[row, column]
            matrix[3 + row, column] = matrix[row, 3 + column] = -half * known[row, column]
            matrix[3 + row, 3 + column] = half * half * known[row, column]
    for row in range(3):
        vector[3 + row] = -half * vector[row]
        matrix[3 + row, 3 + row] += 1.0 / (acceleration_sigma[row] ** 2 * lasting)
    return vector, matrix


@compiled
def _add_gyroscopes(
    N: Matrix,
    g: Vector,
    x: Vector,
    gyro: Vectors,
    gyro_R: Vectors,
    at_limit: Vectors,
    to_sensor: Matrix,
) -> float:
    """Add the raw axes that measure; return their squared misfit at x.

    Calibration mixes the axes, so that all base axes of an IMU are wrong where one raw axis is at
    its limit; a raw axis is not.
    """
    squares = 0.0
    for i in range(len(gyro)):
        for axis in range(3):
            if at_limit[i, axis] > 0.0 or gyro_R[i, axis] == np.inf:
                continue
            h, weight, misfit = to_sensor[i, axis], 1.0 / gyro_R[i, axis], 0.0
            for k in range(3):
                misfit += h[k] * (gyro[i, k] - x[k])
            squares += weight * misfit * misfit
            for row in range(3):
                g[row] += weight * h[row] * misfit
                for column in range(3):
                    N[row, column] += weight * h[row] * h[column]
    return squares


@compiled
def _hold_beyond_limits(
    x: Vector, P: Matrix, gyro: Vectors, gyro_R: Vectors, at_limit: Vectors, to_sensor: Matrix
) -> None:
    """Move x beyond the readings at their limit, the nearest way in the metric of P.

    The truth lies there, so no move makes its normalised distance larger: P stays honest as it
    is, and nothing is counted twice where many axes say the same.
    """
    for i in range(len(gyro)):
        for axis in range(3):
            if at_limit[i, axis] == 0.0 or gyro_R[i, axis] == np.inf:
                continue
            h = to_sensor[i, axis]
            limit, estimate, variance = 0.0, 0.0, 0.0
            for k in range(3):
                limit += h[k] * gyro[i, k]
                estimate += h[k] * x[k]
                for m in range(3):
                    variance += h[k] * P[k, m] * h[m]
            short = NEAR_LIMIT * limit - estimate
            if short * limit > 0.0:  # of the same sign: not reached, or on the other side
                for row in range(6):
                    along = P[row, 0] * h[0] + P[row, 1] * h[1] + P[row, 2] * h[2]
                    x[row] += short * along / variance
