"""Strapdown mechanisation: angular rate and specific force to attitude, velocity, position.

Between two samples both readings follow the parabola through them and the sample before.  What
it differs from the straight line is its mean, by `curvature`: left out, it adds up to a drift as
large as that of neglected coning.  Beside that the readings are linear in time, and to third
order in dt the rotation vector (Bortz) and velocity increment in the earlier body frame are [1]_

    phi = (w0 + w1) dt / 2 + dt^2 / 12 w0 x w1                                     (coning)
    dv  = J(phi) (f0 + f1) dt / 2 + dt^2 / 12 (w0 x f1 + f0 x w1)                 (sculling)

with J(phi) the left Jacobian of SO(3), which is exact for a constant rate.  The earth does not
turn and is flat: for the minutes and metres of a hand or foot that is below the sensors' noise.

.. [1] P. G. Savage, "Strapdown inertial navigation integration algorithm design", parts 1 and 2,
   J. Guidance, Control, and Dynamics 21(1) and 21(2), 1998.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import (
    as_stamps,
    as_vectors,
    Matrix,
    NANOSECONDS,
    Scalars,
    Stamps,
    Vector,
    Vectors,
)
from multiimu_ros.compiled import compiled
from multiimu_ros.rotations import exp_so3, product, renormalise, right_jacobian, skew


@dataclass(frozen=True)
class Motion:
    """What strapdown integration returns for N samples.

    Parameters
    ----------
    position_n, velocity_n : (N, 3) arrays
        In the local level frame [m], [m/s].
    R_nb : (N, 3, 3) array
        Attitude: rotates body into local level vectors.
    """

    position_n: Vectors
    velocity_n: Vectors
    R_nb: Matrix


@compiled
def cross(u: Vector, v: Vector) -> Vector:
    """Return u x v for (3,) arrays."""
    return np.array(
        [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]]
    )


@compiled
def curvature(earlier: Vector, start: Vector, end: Vector, before: float, dt: float) -> Vector:
    """Return by how much the mean of a parabola over a step exceeds that of its chord.

    Parameters
    ----------
    earlier, start, end : (3,) arrays
        Readings at three instants; the step is from `start` to `end`.
    before, dt : float
        Time from `earlier` to `start`, 0 if there is no such sample, and length of the step [s].

    Returns
    -------
    (3,) array
        -dt^2 / 12 of the second derivative, in the unit of the readings; 0 after a hole, for it
        would be mostly noise.
    """
    if not 0.5 * dt < before < 2.0 * dt:
        return np.zeros(3)
    slopes = (end - start) / dt - (start - earlier) / before
    return slopes * (-dt * dt / 6.0 / (dt + before))


@compiled
def increments(
    rate0: Vector, force0: Vector, rate1: Vector, force1: Vector, dt: float
) -> tuple[Vector, Vector, Vector]:
    """Return rotation vector, velocity and position increments of one step.

    Parameters
    ----------
    rate0, force0, rate1, force1 : (3,) arrays
        Readings at the start and the end of the step [rad/s], [m/s^2].
    dt : float
        Length of the step [s].

    Returns
    -------
    phi, dv, dp : (3,) arrays
        In the body frame at the start, gravity apart [rad], [m/s], [m].
    """
    rate = 0.5 * (rate0 + rate1)
    force = 0.5 * (force0 + force1)
    square = dt * dt
    phi = dt * rate + square / 12.0 * cross(rate0, rate1)
    sculling = cross(rate0, force1) + cross(force0, rate1)
    dv = dt * (right_jacobian(-phi) @ force) + square / 12.0 * sculling
    dp = square / 6.0 * (2.0 * force0 + force1) + square * dt / 6.0 * cross(rate, force)
    return phi, dv, dp


@compiled
def _mechanise(
    dt: Vector, rate: Vectors, force: Vectors, R: Matrix, gravity: float
) -> tuple[Vectors, Vectors, Matrix]:
    n = len(rate)
    position, velocity, attitude = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, 3, 3))
    attitude[0] = R
    for k in range(1, n):
        h, before = dt[k - 1], dt[k - 2] if k > 1 else 0.0
        turn = curvature(rate[k - 2], rate[k - 1], rate[k], before, h)
        push = curvature(force[k - 2], force[k - 1], force[k], before, h)
        phi, dv, dp = increments(
            rate[k - 1] + turn, force[k - 1] + push, rate[k] + turn, force[k] + push, h
        )
        position[k] = position[k - 1] + h * velocity[k - 1] + R @ dp
        velocity[k] = velocity[k - 1] + R @ dv
        position[k, 2] -= 0.5 * gravity * h * h
        velocity[k, 2] -= gravity * h
        R = renormalise(R @ exp_so3(phi))
        attitude[k] = R
    return position, velocity, attitude


def mechanise(
    stamp_ns: Stamps,
    angular_rate: Vectors,
    specific_force: Vectors,
    R_nb: Matrix,
    velocity_n: Vector,
    gravity: float = 9.80665,
) -> Motion:
    """Integrate a recording from a known start, at the origin.

    Parameters
    ----------
    stamp_ns : (N,) int array
        Instants of the samples [ns].
    angular_rate, specific_force : (N, 3) arrays
        Readings without bias, in the body frame [rad/s], [m/s^2].
    R_nb : (3, 3) array
        Attitude at the first sample.
    velocity_n : (3,) array
        Velocity at the first sample [m/s].
    gravity : float
        Local gravity [m/s^2]; gravity_n = [0, 0, -gravity].

    Returns
    -------
    Motion
        At every sample.
    """
    elapsed = np.asarray((as_stamps(stamp_ns, 'stamp_ns') - stamp_ns[0]) / NANOSECONDS)
    rate = np.ascontiguousarray(as_vectors(angular_rate, 'angular_rate'))
    force = np.ascontiguousarray(as_vectors(specific_force, 'specific_force'))
    if not len(elapsed) == len(rate) == len(force):
        came = f'{len(elapsed)} stamps, {len(rate)} rates and {len(force)} forces'
        msg = f'`stamp_ns`, `angular_rate` and `specific_force` must be equally long, got {came}.'
        raise ValueError(msg)
    start = np.array(R_nb, dtype=np.float64)
    position, velocity, attitude = _mechanise(np.diff(elapsed), rate, force, start, gravity)
    # Without coupling to the earth, a start velocity only adds a straight line.
    return Motion(position + elapsed[:, None] * velocity_n, velocity + velocity_n, attitude)


@compiled
def rk4_step(R: Matrix, rate: Vector, dt: float) -> Matrix:
    """Return the attitude (3, 3) after `dt` [s] at `rate` (3,) [rad/s]."""
    S = skew(rate)
    k1 = product(R, S)
    k2 = product(R + 0.5 * dt * k1, S)
    k3 = product(R + 0.5 * dt * k2, S)
    k4 = product(R + dt * k3, S)
    return renormalise(R + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4))


def attitude_rk4(R_nb: Matrix, angular_rate: Vectors, dt: Scalars) -> Matrix:
    """Integrate the attitude by the fourth-order Runge-Kutta scheme of the thesis, (9.1), (9.2).

    The thesis normalises a quaternion; a matrix made orthonormal is the same scheme.  The rate is
    held at (w_k + w_{k-1}) / 2 over a step: fed with w_k alone it lags by half a sample.
    `AttitudeFilter` uses the exact exponential instead.

    Parameters
    ----------
    R_nb : (3, 3) array
        Attitude at the first sample.
    angular_rate : (N, 3) array
        Rates without bias [rad/s].
    dt : (N - 1,) array
        Time between the samples [s].

    Returns
    -------
    (N, 3, 3) array
        Attitude at every sample, made orthonormal to first order.
    """
    rate = as_vectors(angular_rate, 'angular_rate')
    attitude = np.empty((len(rate), 3, 3))
    attitude[0] = R_nb
    for k in range(1, len(rate)):
        attitude[k] = rk4_step(attitude[k - 1], 0.5 * (rate[k - 1] + rate[k]), dt[k - 1])
    return attitude
