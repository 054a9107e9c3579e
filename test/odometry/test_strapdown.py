"""The mechanisation against motions that are known in closed form."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.odometry.strapdown import attitude_rk4, curvature, increments, mechanise
from multiimu_ros.rotations import exp_so3

G = 9.80665


def stamps(n, rate_hz):
    """Return n even stamps from a time like today's [ns]."""
    return 1_700_000_000_000_000_000 + np.round(np.arange(n) * (1e9 / rate_hz)).astype(np.int64)


def on_a_turntable(rate_hz, seconds=4.0, spin=2.0, radius=0.5):
    """Return a level circle: stamps, rates, forces, positions."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    rate = np.tile([0.0, 0.0, spin], (len(t), 1))
    force = np.tile([-radius * spin**2, 0.0, G], (len(t), 1))
    position = radius * np.column_stack((np.cos(spin * t) - 1, np.sin(spin * t), 0 * t))
    return stamps(len(t), rate_hz), rate, force, position


def coning(rate_hz, seconds=2.0):
    """Return rates of a body whose axis circles at 40 rad/s, and its attitudes."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    half, spin = 0.05, 40.0
    wobble = half * np.column_stack((np.cos(spin * t), np.sin(spin * t), 0 * t))
    R = np.array([exp_so3(v) for v in wobble])
    # w = J_r(phi) dphi/dt, for |phi| constant and dphi/dt perpendicular to it.
    slope = half * spin * np.column_stack((-np.sin(spin * t), np.cos(spin * t), 0 * t))
    a = half
    rate = np.sin(a) / a * slope - (1 - np.cos(a)) / a**2 * np.cross(wobble, slope)
    return rate, R


def angle(R, S):
    """Return the angle between rotations (3, 3) [rad]."""
    return np.linalg.norm(R - S) / np.sqrt(2)


def test_at_rest_specific_force_is_plus_g_and_nothing_moves():
    # At rest specific_force_n = [0, 0, +9.81], for gravity_n = [0, 0, -9.81].
    force = np.tile([0.0, 0.0, 9.81], (1000, 1))
    motion = mechanise(stamps(1000, 100), 0 * force, force, np.eye(3), np.zeros(3), 9.81)
    # 10 s of rounding: 1e-16 * 9.81 * 50.
    assert_allclose(motion.position_n, 0.0, atol=1e-12)


def test_a_circle_closes_though_samples_are_rare():
    stamp_ns, rate, force, position = on_a_turntable(50)
    motion = mechanise(stamp_ns, rate, force, np.eye(3), [0.0, 1.0, 0.0])
    # Constant rate and force: attitude and velocity are exact, position is to dt^2.
    assert_allclose(motion.velocity_n[-1], [-np.sin(8.0), np.cos(8.0), 0.0], atol=1e-9)
    assert_allclose(motion.position_n, position, atol=2e-4)


def test_a_thrown_body_falls_on_its_parabola():
    zeros = np.zeros((201, 3))
    motion = mechanise(stamps(201, 100), zeros, zeros, np.eye(3), [3.0, 0.0, 5.0], G)
    assert_allclose(motion.position_n[-1], [6.0, 0.0, 10.0 - G * 2.0], atol=1e-9)


def waving(rate_hz, seconds=4.0):
    """Return stamps, rates, forces, attitudes, positions, velocities of a smooth motion."""
    t = np.arange(round(seconds * rate_hz) + 1) / rate_hz
    zero = np.zeros_like(t)
    yaw, roll = np.sin(2 * t), 0.8 * np.sin(3 * t + 1)
    R = Rotation.from_euler('ZX', np.column_stack((yaw, roll)))
    turn = np.column_stack((zero, zero, 2 * np.cos(2 * t)))
    rate = Rotation.from_euler('X', roll[:, None]).apply(turn, inverse=True)
    rate[:, 0] += 2.4 * np.cos(3 * t + 1)
    omega, phase = np.array([4.0, 5.0, 6.0]), np.array([0.0, 1.0, 2.0])
    angle_n = t[:, None] * omega + phase
    position, velocity = 0.1 * np.sin(angle_n), 0.1 * omega * np.cos(angle_n)
    force = R.apply(-(omega**2) * position + [0.0, 0.0, G], inverse=True)
    return stamps(len(t), rate_hz), rate, force, R.as_matrix(), position, velocity


def test_error_falls_with_the_cube_of_the_step():
    errors = []
    for rate_hz in (100, 200, 400):
        stamp_ns, rate, force, R, position, velocity = waving(rate_hz)
        motion = mechanise(stamp_ns, rate, force, R[0], velocity[0])
        errors.append(np.abs(motion.position_n - (position - position[0])).max())
    # Third order, thanks to the parabola: halving the step leaves an eighth.
    assert_allclose(np.array(errors[:-1]) / errors[1:], 8.0, rtol=0.1)
    assert errors[1] < 1e-3  # 200 Hz, 4 s: below a good sensor's own drift


def test_curvature_is_what_the_mean_of_a_parabola_has_over_its_chord(rng):
    a, b, c = rng.standard_normal((3, 3))
    earlier, start, end = (a + b * t + c * t**2 for t in (-0.3, 0.0, 0.4))
    mean = a + b * 0.2 + c * 0.4**2 / 3.0
    bend = curvature(earlier, start, end, 0.3, 0.4)
    assert_allclose(0.5 * (start + end) + bend, mean, rtol=1e-12)
    assert (curvature(earlier, start, end, 0.0, 0.4) == 0.0).all()
    assert (curvature(earlier, start, end, 0.1, 0.4) == 0.0).all()


def test_coning_term_beats_plain_averaging():
    rate, R = coning(200)
    plain = R[0]
    exact = R[0]
    for k in range(1, len(rate)):
        phi, _, _ = increments(rate[k - 1], np.zeros(3), rate[k], np.zeros(3), 1 / 200)
        exact = exact @ exp_so3(phi)
        plain = plain @ exp_so3((rate[k - 1] + rate[k]) / 400)
    drift = angle(plain, R[-1]), angle(exact, R[-1])
    # Averaging loses half^2 spin (spin dt)^2 / 12 = 3.3e-4 rad/s to coning, for 2 s.
    assert drift[1] < 0.6 * drift[0]


def test_sculling_term_beats_plain_averaging():
    # Rolling by a sin(st) while pushed by b sin(st): ab / 2 along z that no axis feels on average.
    a, b, spin, dt = 0.05, 10.0, 40.0, 1 / 200
    t = np.arange(401) * dt
    rate = np.outer(a * spin * np.cos(spin * t), [1.0, 0.0, 0.0])
    force = np.outer(b * np.sin(spin * t), [0.0, 1.0, 0.0])
    speed, plain = 0.0, 0.0
    for k in range(1, len(t)):
        roll = a * np.sin(spin * t[k - 1])
        _, dv, _ = increments(rate[k - 1], force[k - 1], rate[k], force[k], dt)
        speed += np.sin(roll) * dv[1] + np.cos(roll) * dv[2]
        plain += np.sin(roll) * dt * 0.5 * (force[k - 1, 1] + force[k, 1])
    exact = np.trapezoid(b * np.sin(spin * t) * np.sin(a * np.sin(spin * t)), t)
    # What is left is (spin dt)^2 / 12 = 0.3 %; without the turn within a step it is twice that.
    assert abs(speed - exact) < 0.5 * abs(plain - exact)
    assert abs(speed - exact) < 0.005 * exact


def test_uneven_steps_cost_little():
    stamp_ns, rate, force, R, position, velocity = waving(1600)
    kept = np.cumsum(np.random.default_rng(1).integers(5, 12, 790))  # 3 to 7 ms
    motion = mechanise(stamp_ns[kept], rate[kept], force[kept], R[kept[0]], velocity[kept[0]])
    # Half as much again as even steps of 5 ms, 1e-3: the mean of dt^3 is 1.6 times that of 5 ms.
    error = motion.position_n - (position[kept] - position[kept[0]])
    assert np.abs(error).max() < 1.5e-3


def test_the_newest_rate_alone_leads_by_half_a_sample():
    # Spun up to 112 deg/s within a second at 100 Hz: half a sample of it is 0.56 deg.
    t = np.arange(101) / 100
    rate = np.outer(np.deg2rad(112.0) * 0.5 * (1 - np.cos(np.pi * t)), [0.0, 0.0, 1.0])
    held = np.rad2deg(rate[1:, 2].sum() / 100)
    mean = attitude_rk4(np.eye(3), rate, np.diff(t))[-1]
    assert_allclose(held - 56.0, 0.56, rtol=1e-6)
    assert_allclose(np.rad2deg(np.arctan2(mean[1, 0], mean[0, 0])), 56.0, atol=1e-4)


def test_rk4_agrees_with_the_exponential_at_fourth_order():
    rate = np.tile([0.3, -1.0, 2.0], (101, 1))
    gaps = []
    for rate_hz in (50, 100):
        n = rate_hz + 1
        attitude = attitude_rk4(np.eye(3), rate[:n], np.full(n - 1, 1 / rate_hz))
        gaps.append(angle(attitude[-1], exp_so3(rate[0])))
    assert gaps[1] < gaps[0] / 12  # 16 but for the orthonormalisation
    assert gaps[1] < 1e-7


def test_rk4_takes_the_rate_between_the_samples():
    t = np.arange(101) / 100
    rate = np.outer(t, [0.0, 0.0, 2.0])  # spins up: angle t^2
    attitude = attitude_rk4(np.eye(3), rate, np.diff(t))
    # With w_k alone it would lead by half a sample, 0.01 rad.
    assert angle(attitude[-1], exp_so3(np.array([0.0, 0.0, 1.0]))) < 1e-6


def test_lengths_must_agree():
    with pytest.raises(ValueError, match='got 3 stamps, 4 rates and 4 forces'):
        mechanise(stamps(3, 100), np.zeros((4, 3)), np.zeros((4, 3)), np.eye(3), np.zeros(3))
