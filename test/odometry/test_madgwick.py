"""Madgwick's filter against its published formula, and what beta buys and costs."""

from attitude_runs import CONFIG
import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import FORCE_DENSITY, G, RATE_DENSITY
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.madgwick import (
    as_matrix,
    attitude_madgwick,
    BETA,
    madgwick_step,
    MadgwickAttitude,
)
from multiimu_ros.odometry.rest import Sample


def published_step(q, rate, acceleration, dt, beta):
    """Return (8.16) to (8.21), misprints put right; q is [q1, q2, q3, q4], the real part first."""
    q1, q2, q3, q4 = q
    f = np.array([2 * (q2 * q4 - q1 * q3), 2 * (q1 * q2 + q3 * q4), 2 * (0.5 - q2**2 - q3**2)])
    f -= acceleration / np.linalg.norm(acceleration)
    J = np.array(
        [
            [-2 * q3, 2 * q4, -2 * q1, 2 * q2],
            [2 * q2, 2 * q1, 2 * q4, 2 * q3],
            [0.0, -4 * q2, -4 * q3, 0.0],
        ]
    )
    gradient = J.T @ f
    turned = (Rotation.from_quat([q2, q3, q4, q1]).as_quat(), np.array([*rate, 0.0]))
    x, y, z, w = turned[0]
    a, b, c, _ = turned[1]
    slope = 0.5 * np.array(  # Hamilton's product of q and the rate
        [
            -x * a - y * b - z * c,
            w * a + y * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y * a,
        ]
    )
    q = q + (slope - beta * gradient / np.linalg.norm(gradient)) * dt
    return q / np.linalg.norm(q)


def any_step(rng):
    """Return a quaternion [x, y, z, w], a rate and a force."""
    q = Rotation.from_quat(rng.standard_normal(4)).as_quat(canonical=True)
    return q, *rng.standard_normal((2, 3))


def test_step_equals_the_published_formula(rng):
    for _ in range(20):
        q, rate, force = any_step(rng)
        ours = madgwick_step(q, rate, force, 0.01, 0.1)
        published = published_step(q[[3, 0, 1, 2]], rate, force, 0.01, 0.1)
        assert_allclose(ours[[3, 0, 1, 2]], published, rtol=1e-12)


def test_step_equals_that_of_a_library(rng):
    filters = pytest.importorskip('ahrs').filters
    library = filters.Madgwick(gain=0.1, Dt=0.01)
    for _ in range(20):
        q, rate, force = any_step(rng)
        theirs = library.updateIMU(q[[3, 0, 1, 2]], rate, force)
        assert_allclose(madgwick_step(q, rate, force, 0.01, 0.1)[[3, 0, 1, 2]], theirs, rtol=1e-9)


def test_without_force_or_misfit_only_the_rate_counts():
    level, rate = np.array([0.0, 0.0, 0.0, 1.0]), np.array([0.0, 0.0, 0.2])
    for force in (np.zeros(3), np.array([0.0, 0.0, G])):
        q = madgwick_step(level, rate, force, 0.01, 0.1)
        assert_allclose(q, [0.0, 0.0, np.sin(np.arctan(1e-3)), np.cos(np.arctan(1e-3))])


def test_tilt_falls_by_twice_beta_a_second():
    tilt = Rotation.from_euler('x', 0.05)
    n, still = 41, np.zeros((41, 3))
    up = np.tile([0.0, 0.0, G], (n, 1))
    answers = attitude_madgwick(tilt.as_matrix(), still, up, np.full(n - 1, 0.01), 0.05)
    fallen = 0.05 - Rotation.from_matrix(answers).magnitude()
    # A quaternion holds half the angle.  The gradient also stretches it, which is in vain: a share
    # of tilt^2 / 2, 1.3e-3 of the step at most.
    assert_allclose(fallen, 2 * 0.05 * 0.01 * np.arange(n), rtol=2e-3)


def test_stream_agrees_with_batch_and_its_matrix_with_scipy(rng):
    rate, force = rng.standard_normal((2, 100, 3))
    force += [0.0, 0.0, G]
    dt = rng.uniform(0.004, 0.006, 99)
    stream, answers = MadgwickAttitude(CONFIG), []
    for k, (w, f) in enumerate(zip(rate, force, strict=True)):
        step = dt[k - 1] if k else 0.005
        stream.push(Sample(step, w, f, RATE_DENSITY, FORCE_DENSITY, False, False))
        answers.append(stream.R_nb)
    assert_allclose(answers, attitude_madgwick(answers[0], rate, force, dt), atol=1e-14)
    q = rng.standard_normal(4)
    q /= np.linalg.norm(q)
    assert_allclose(as_matrix(q), Rotation.from_quat(q).as_matrix(), atol=1e-15)


def test_tilt_is_told_as_what_the_motion_and_the_accelerometer_may_do():
    stream = MadgwickAttitude(CONFIG)
    stream.align(np.array([0.0, 0.0, G]), 0.0)
    # Chasing for sqrt(0.1 m / 0.5 m/s^2), and a bias of 0.03 m/s^2.
    expected = (2 * BETA * np.sqrt(0.1 / 0.5)) ** 2 + (0.03 / G) ** 2
    assert_allclose(np.diag(stream.P)[:2], expected, rtol=1e-9)


def test_beta_must_not_be_negative():
    with pytest.raises(ValueError, match='`beta` must not be negative, got nan'):
        MadgwickAttitude(CONFIG, np.nan)
