"""Compiled kernels of the offline smoother; `smoother.py` tells the idea.

State x (15,), R (3, 3) and error are those of `error_dynamics`.  Equations and their numbers are
those of docs/derivations/smoother.md.
"""

import numpy as np

from multiimu_ros.arrays import Flags, Matrix, Vector
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry.error_dynamics import predict, remember
from multiimu_ros.odometry.error_fields import GRAVITY
from multiimu_ros.odometry.error_updates import begin_rest, update
from multiimu_ros.odometry.kalman import scalar_update, transform_block
from multiimu_ros.rotations import exp_so3, log_so3, product, renormalise, skew

LOST = 1e-13  # of a variance: what is left of it is rounding, a thousand times the last digit
FILTERED, PREDICTED, TRANSITION, NOISE = 0, 1, 2, 3  # what a tape of matrices holds per step


@compiled
def shift(x: Vector, R: Matrix, P: Matrix, error: Vector) -> None:
    """Move an estimated error (15,) into the state (error_state.md (8))."""
    x += error
    x[6:9] = 0.0
    R[:] = renormalise(product(R, exp_so3(error[6:9])))
    transform_block(P, exp_so3(-error[6:9]), 6)


@compiled
def see_position(x: Vector, R: Matrix, P: Matrix, position: Vector, variance: float) -> None:
    """Correct all states by a position (3,) that is known to `variance` [m^2]."""
    error = np.zeros(15)
    for axis in range(3):
        h = np.zeros(15)
        h[axis] = 1.0
        scalar_update(error, P, h, position[axis] - x[axis], variance, 0, 15)
    shift(x, R, P, error)


@compiled
def see_rest(
    x: Vector,
    R: Matrix,
    P: Matrix,
    gravity: float,
    rate: Vector,
    force: Vector,
    rate_variance: Vector,
    force_variance: Vector,
) -> None:
    """Correct all states, the position too, by a resting sample (smoother.md (2))."""
    error = np.zeros(15)
    slope = skew(gravity * R[2])
    for axis in range(3):
        h = np.zeros(15)
        h[9 + axis] = 1.0
        scalar_update(error, P, h, rate[axis] - x[9 + axis], rate_variance[axis], 0, 15)
    for axis in range(3):
        h = np.zeros(15)
        h[6:9], h[12 + axis] = slope[axis], 1.0
        residual = force[axis] - x[12 + axis] - gravity * R[2, axis]
        scalar_update(error, P, h, residual, force_variance[axis], 0, 15)
    shift(x, R, P, error)


@compiled
def run_forward(
    x: Vector,
    R: Matrix,
    P: Matrix,
    memory: Vector,
    settings: Vector,
    steps: Vector,
    readings: Matrix,
    flags: Flags,
    tape_x: Matrix,
    tape_R: Matrix,
    tape_P: Matrix,
) -> None:
    """Filter n samples, and note what the way back needs.

    Parameters
    ----------
    x, R, P, memory, settings : arrays
        Those of the filter, at the sample before; changed in place but for the settings.
    steps : (n,) array
        Time since the sample before each [s].
    readings : (n, 12) array
        Rate, force, and their noise densities.
    flags : (n, 2) bool array
        Still, resting.
    tape_x, tape_R : (n, 2, 15), (n, 2, 3, 3) arrays
        Filled with the filtered state before each step and the predicted one after it.
    tape_P : (n, 4, 15, 15) array
        Filled with the covariances of both, the transition and the noise of the step.
    """
    for k in range(len(steps)):
        dt, row = steps[k], readings[k]
        rate, force, rate_density, force_density = row[0:3], row[3:6], row[6:9], row[9:12]
        still, resting = bool(flags[k, 0]), bool(flags[k, 1])
        begin_rest(x, R, P, memory, settings, dt, resting)
        tape_x[k, FILTERED], tape_R[k, FILTERED], tape_P[k, FILTERED] = x, R, P
        noise = np.zeros((15, 15))  # all that `predict` does to a covariance of zero is to add
        F = predict(
            x, R, noise, memory, settings, dt, rate, force, rate_density, force_density, resting
        )
        P[:] = F @ P @ F.T + noise
        tape_x[k, PREDICTED], tape_R[k, PREDICTED], tape_P[k, PREDICTED] = x, R, P
        tape_P[k, TRANSITION], tape_P[k, NOISE] = F, noise
        if resting:
            see_rest(
                x, R, P, settings[GRAVITY],
                rate, force, rate_density**2 / dt, force_density**2 / dt,
            )  # fmt: skip
        else:
            update(
                x, R, P, memory, settings, dt,
                rate, force, rate_density, force_density, still, resting,
            )  # fmt: skip
        remember(memory, dt, rate, force, still, resting)


@compiled
def root(P: Matrix) -> tuple[Matrix, Vector]:
    """Return L (n, n) and D (n,) with P = D L L' D, as far as P (n, n) is positive.

    A state without variance of its own, or with none but rounding once the states before it are
    known, has a row and a column of zeros but for a one on the diagonal of L, and D = 0.
    """
    n = len(P)
    L, D = np.zeros((n, n)), np.zeros(n)
    for j in range(n):
        D[j] = np.sqrt(max(P[j, j], 0.0))
        rest, L[j, j] = 1.0, 1.0
        if D[j] == 0.0:
            continue
        for i in range(j):
            if D[i] == 0.0:
                continue
            total = P[j, i] / (D[i] * D[j])
            for k in range(i):
                total -= L[j, k] * L[i, k]
            L[j, i] = total / L[i, i]
            rest -= L[j, i] ** 2
        if rest > LOST:
            L[j, j] = np.sqrt(rest)
        else:
            L[j, :j] = 0.0
            D[j] = 0.0
    return L, D


@compiled
def solve(P: Matrix, B: Matrix) -> Matrix:
    """Return X (n, m) with P X = B (n, m); rows of X are zero where P tells nothing new."""
    L, D = root(P)
    n = len(P)
    X = np.zeros(B.shape)
    for i in range(n):
        if D[i] == 0.0:
            continue
        X[i] = B[i] / D[i]
        for k in range(i):
            if L[i, k] != 0.0:
                X[i] -= L[i, k] * X[k]
        X[i] /= L[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            if L[k, i] != 0.0:
                X[i] -= L[k, i] * X[k]
        X[i] /= L[i, i]
    for i in range(n):
        X[i] *= 1.0 / D[i] if D[i] > 0.0 else 0.0
    return X


@compiled
def step_back(
    x: Vector, R: Matrix, P: Matrix, tape_x: Matrix, tape_R: Matrix, tape_P: Matrix
) -> None:
    """Take the smoothed x, R and P from one sample to the sample before (smoother.md (4)-(6)).

    `tape_x` (2, 15), `tape_R` (2, 3, 3) and `tape_P` (4, 15, 15) are those of this step.
    """
    filtered, F, noise = tape_P[FILTERED], tape_P[TRANSITION], tape_P[NOISE]
    gain = solve(tape_P[PREDICTED], F @ filtered).T.copy()
    error = x - tape_x[PREDICTED]
    error[6:9] = log_so3(product(tape_R[PREDICTED].T, R))
    transform_block(P, exp_so3(error[6:9]), 6)  # back into the axes of the prediction
    left = np.eye(15) - gain @ F
    spread = left @ filtered @ left.T + gain @ (P + noise) @ gain.T
    P[:] = 0.5 * (spread + spread.T)
    error = gain @ error
    x[:], R[:] = tape_x[FILTERED], tape_R[FILTERED]
    shift(x, R, P, error)


@compiled
def run_backward(
    x: Vector,
    R: Matrix,
    P: Matrix,
    tape_x: Matrix,
    tape_R: Matrix,
    tape_P: Matrix,
    out_x: Matrix,
    out_R: Matrix,
    out_P: Matrix,
) -> None:
    """Smooth n steps, the last one first.

    Parameters
    ----------
    x, R, P : (15,), (3, 3), (15, 15) arrays
        Smoothed state after the last step; taken back to before the first one, in place.
    tape_x, tape_R, tape_P : arrays
        What `run_forward` noted.
    out_x, out_R, out_P : (n + 1, 15), (n + 1, 3, 3), (n + 1, 15, 15) arrays
        Filled with the smoothed states before each step and after the last one.
    """
    n = len(tape_x)
    out_x[n], out_R[n], out_P[n] = x, R, P
    for k in range(n - 1, -1, -1):
        step_back(x, R, P, tape_x[k], tape_R[k], tape_P[k])
        out_x[k], out_R[k], out_P[k] = x, R, P
