"""Gyroscopes at their limit: what is marked, and a bridge that is near and knows how near."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.fusion.array_acceleration import add_forces, array_acceleration
from multiimu_ros.fusion.rigid_body import specific_force_at
from multiimu_ros.fusion.saturation import (
    bridge_rate,
    learn_walk,
    MOTION_LASTS,
    saturated,
    start_bridge,
)

RATE_HZ = 200.0
DT = 1.0 / RATE_HZ
GYRO_SIGMA, FORCE_SIGMA = 1.2e-4 * np.sqrt(RATE_HZ), 1.8e-3 * np.sqrt(RATE_HZ)  # a BMI160
ANGLES = 2 * np.pi * np.arange(8) / 8
RING = 0.04 * np.stack([np.cos(ANGLES), np.sin(ANGLES), np.zeros(8)], axis=1)
CUBE = 0.03 * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
HAND = np.full(3, 200.0)  # [rad/s^2] more than the motions below have
TURNED = Rotation.from_euler('zyx', [30, 20, 10], degrees=True).as_matrix()


def maps(count, R_bs=None):
    """Return to_sensor (K, 6, 7) of ideal sensors."""
    turn = np.eye(3) if R_bs is None else R_bs
    return np.tile(np.hstack([np.kron(np.eye(2), turn.T), np.zeros((6, 1))]), (count, 1, 1))


def limits_of(count, limit):
    return np.tile(np.repeat([limit, np.inf], 3), (count, 1))


def test_axes_are_marked_in_the_frame_of_the_sensor():
    values, out = np.zeros((2, 6)), np.full((2, 6), 9.0)
    raw = np.array([9.99, -3.0, 0.0, 0.0, 0.0, -16.0])  # 0.998 x 10 = 9.98; a force at -16
    values[0] = np.kron(np.eye(2), TURNED) @ raw
    to_sensor, limits = maps(2, TURNED), np.tile(np.repeat([10.0, 16.0], 3), (2, 1))
    assert saturated(values, to_sensor, limits, out)
    assert out.tolist() == [[1, 0, 0, 0, 0, 1], [0] * 6]
    to_sensor[:, 0, 6] = -0.02  # a bias: the raw reading is 9.97
    assert saturated(values, to_sensor, limits, out)
    assert out[0].tolist() == [0, 0, 0, 0, 0, 1]


def test_what_is_missing_or_unlimited_is_not_saturated():
    values, out = np.full((2, 6), np.nan), np.ones((2, 6))
    assert not saturated(values, maps(2), limits_of(2, 10.0), out)
    assert not out.any()
    assert not saturated(np.full((2, 6), 1e9), maps(2), np.full((2, 6), np.inf), out)
    values[1, :3] = [-11.0, 0.0, 0.0]  # a rate without its force
    assert saturated(values, maps(2), limits_of(2, 10.0), out)
    assert out.sum() == out[1, 0] == 1.0


def waves(rng, peak, seconds=1.6):
    """Return rates and angular accelerations (N, 3): half a wave of `peak`, and a hand."""
    t = np.arange(round(seconds * RATE_HZ))[:, None] / RATE_HZ
    wave, phase = 2 * np.pi / (2 * seconds), rng.uniform(0, 2 * np.pi, 3)
    slow = 2 * np.pi * 1.1
    rate = peak * np.sin(wave * t) + 2.0 * np.sin(slow * t + phase)
    return rate, peak * wave * np.cos(wave * t) + 2.0 * slow * np.cos(slow * t + phase)


def scans(rng, arms, rate, acceleration, limit, R_bs=None, error=0.0):
    """Yield gyroscopes (K, 3), clipped in their own frame, and forces (K, 3), base frame."""
    turn = np.eye(3) if R_bs is None else R_bs
    for n, (w, a) in enumerate(zip(rate, acceleration, strict=True)):
        f_0 = 10.0 * np.array([np.sin(0.1 * n), np.cos(0.08 * n), np.sin(0.05 * n)])
        felt = np.stack([specific_force_at(arm, f_0, w, a) for arm in arms]) + error
        raw = w @ turn + GYRO_SIGMA * rng.standard_normal(arms.shape)
        yield (
            np.clip(raw, -limit, limit) @ turn.T,
            felt + FORCE_SIGMA * rng.standard_normal(arms.shape),
        )


class Bridge:
    """What the fusion stage does with the kernels, and the two simpler ways beside it."""

    def __init__(self, arms, limit, R_bs=None, force_R=FORCE_SIGMA**2):
        self.arms, self.to_sensor = arms, maps(len(arms), R_bs)
        self.limits, self.at_limit = limits_of(len(arms), limit), np.zeros((len(arms), 6))
        self.gyro_R = np.full(arms.shape, GYRO_SIGMA**2)
        self.force_R = np.broadcast_to(force_R, arms.shape).copy()
        self.walk, self.last, self.inside = np.zeros(2), None, False

    def push(self, gyro, force):
        """Return rate, its covariance, and whether a gyroscope is at its limit."""
        found = saturated(np.hstack([gyro, force]), self.to_sensor, self.limits, self.at_limit)
        if not found and not self.inside:
            rate = gyro.mean(axis=0)
            a, P_a = array_acceleration(force, self.force_R, self.arms, rate, np.zeros(3), HAND**2)
            self.state, self.P = start_bridge(rate, self.gyro_R[0] / len(gyro), a, P_a)
            self.held, self.alone = rate, np.concatenate([rate, a])
        else:
            self.state, self.P = bridge_rate(
                self.state, self.P, DT, HAND, self.walk, gyro, self.gyro_R, self.at_limit,
                self.to_sensor, force, self.force_R, self.arms,
            )  # fmt: skip
            self._integrate(gyro, force)
        self.inside = found
        return self.state[:3], self.P[:3, :3], found

    def _integrate(self, gyro, force):
        guess = self.alone[:3] + DT * self.alone[3:]
        a, _ = array_acceleration(force, self.force_R, self.arms, guess, np.zeros(3), HAND**2)
        rate = self.alone[:3] + 0.5 * DT * (self.alone[3:] + a)
        blind = self.at_limit[:, :3].all(axis=0)
        self.alone = np.concatenate([np.where(blind, rate, gyro.mean(axis=0)), a])


def ride(rng, arms, peak, limit, force_R=FORCE_SIGMA**2, **kwargs):
    """Return one row per scan in a gap: errors bridged, alone, held (3, 3), NEES; and a jump."""
    rate, acceleration = waves(rng, np.array(peak))
    R_bs, rows, jumps = kwargs.get('R_bs'), [], []
    bridge = Bridge(arms, limit, R_bs, force_R)
    inside, before, P_before = False, np.zeros(6), np.zeros((3, 3))
    for w, (gyro, force) in zip(
        rate, scans(rng, arms, rate, acceleration, limit, **kwargs), strict=True
    ):
        found, P, at_limit = bridge.push(gyro, force)
        error = found - w
        if at_limit:
            nees = error @ np.linalg.solve(P, error) / 3.0
            rows.append((np.stack([error, bridge.alone[:3] - w, bridge.held - w]), nees))
        if inside and not at_limit:  # the first scan of all gyroscopes, against the prediction
            expected = before[:3] + 0.5 * DT * (before[3:] + bridge.state[3:])
            jumps.append(np.abs(gyro.mean(axis=0) - expected) / np.sqrt(np.diag(P_before + P)))
        slope_P = 0.25 * DT**2 * bridge.P[3:, 3:] if bridge.inside else np.zeros((3, 3))
        inside, before, P_before = at_limit, bridge.state, P + 2.0 * slope_P
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows]), np.array(jumps)


PEAKS = {
    'about z': (0.0, 0.0, 40.0),
    'about x': (40.0, 0.0, 0.0),
    'about all': (24.0, -24.0, 24.0),
}


@pytest.mark.compiled
@pytest.mark.parametrize('peak', PEAKS)
@pytest.mark.parametrize('arms', [RING, CUBE], ids=['ring', 'cube'])
def test_a_bridge_beats_integration_and_holding_and_knows_its_error(arms, peak, rng):
    rides = [ride(rng, arms, PEAKS[peak], 17.45) for _ in range(2)]  # 1000 deg/s
    errors = np.concatenate([r[0] for r in rides])
    bridged, alone, held = np.sqrt(np.mean(errors**2, axis=(0, 2)))
    assert 0.2 < len(rides[0][0]) * DT < 1.6
    assert bridged < 0.01  # Cramer-Rao of one scan: 0.025 / (2 w r sqrt(8)), and scans add up
    assert bridged < 0.5 * alone
    assert alone < 0.1 * held
    nees = np.concatenate([r[1] for r in rides])
    # Errors last for some ten scans: 350 of them are some 35 x 3 squares, standard error 0.14.
    assert 0.65 < nees.mean() < 1.4


@pytest.mark.compiled
def test_the_gyroscopes_return_without_a_jump(rng):
    jumps = np.concatenate([ride(rng, RING, peak, 17.45)[2] for peak in PEAKS.values()])
    assert len(jumps) >= 3
    assert jumps.max() < 4.0  # sigmas


def test_sensors_that_are_turned_lend_the_axes_that_still_measure(rng):
    errors, nees, _ = ride(rng, CUBE, (0.0, 0.0, 40.0), 30.0, R_bs=TURNED)
    assert np.sqrt(np.mean(errors[:, 0] ** 2)) < 0.01
    assert 0.5 < nees.mean() < 1.6  # some 200 scans, as above: standard error 0.2


@pytest.mark.compiled
@pytest.mark.parametrize('peak', PEAKS)
def test_a_bias_that_counts_for_as_long_as_it_lasts_leaves_the_bridge_honest(peak, rng):
    sigma, lasts = 0.02, 1.0  # [m/s^2] left by calibration; [s] of the gap
    force_R, nees = FORCE_SIGMA**2 + sigma**2 * lasts / DT, []
    for _ in range(3):
        error = sigma * rng.standard_normal(RING.shape)
        errors, squares, _ = ride(rng, RING, PEAKS[peak], 17.45, force_R=force_R, error=error)
        assert np.sqrt(np.mean(errors[:, 0] ** 2)) < 0.02 * np.sqrt(np.mean(errors[:, 2] ** 2))
        nees.append(squares.mean())
    # Nothing is believed too much; with force_R left alone 1.5, 1.5 and 3.7 (12 boards).
    assert 0.01 < np.mean(nees) < 1.2


def test_what_nobody_sees_grows_in_the_gap_and_shrinks_when_the_gyroscopes_return(rng):
    # One IMU is no array: what the gyroscope does not see, nobody does.
    rate, acceleration = waves(rng, np.array([0.0, 0.0, 40.0]))
    bridge, sigmas, flags = Bridge(RING[:1], 17.45), [], []
    for w, (gyro, force) in zip(
        rate, scans(rng, RING[:1], rate, acceleration, 17.45), strict=True
    ):
        found, P, at_limit = bridge.push(gyro, force)
        sigmas.append(np.sqrt(P[2, 2]))
        flags.append(at_limit)
        assert np.abs(found - w)[:2].max() < 6 * GYRO_SIGMA
    first, last = np.flatnonzero(flags)[[0, -1]]
    growth = np.array(sigmas[first : first + 10])
    assert (np.diff(growth) > 0.0).all()
    # A walk of angular accelerations known by HAND alone, half of the first and of the last.
    assert growth[9] == pytest.approx(
        HAND[0] * np.sqrt(9.25 * MOTION_LASTS * DT + 0.25 * DT**2), rel=1e-3
    )
    assert sigmas[last + 1] < 1.01 * GYRO_SIGMA


def test_a_reading_at_its_limit_is_a_bound(rng):
    # One IMU: no array at all.  The gap is held at the limit, and honestly not known.
    errors, nees, _ = ride(rng, RING[:1], (0.0, 0.0, 40.0), 17.45)
    assert (errors[:, 0, 2] < 0.0).all()
    assert errors[:, 0, 2].min() > 17.4 - 42.0 - 0.1
    assert nees.mean() < 1.3


@pytest.mark.compiled
def test_a_scan_whose_forces_disagree_is_believed_less(rng):
    rate, acceleration = waves(rng, np.array([0.0, 0.0, 40.0]))
    shaken = 30.0 * FORCE_SIGMA * rng.standard_normal((len(rate), *RING.shape))
    bridge, nees = Bridge(RING, 17.45), []
    for w, noise, (gyro, force) in zip(
        rate, shaken, scans(rng, RING, rate, acceleration, 17.45), strict=True
    ):
        found, P, at_limit = bridge.push(gyro, force + noise * bridge.inside)
        if at_limit:
            nees.append((found - w) @ np.linalg.solve(P, found - w) / 3.0)
    # Some 300 by the stated noise; an estimate from 15 degrees of freedom costs a little.
    assert np.mean(nees[1:]) < 2.0


@given(seed=st.integers(0, 2**32 - 1))
def test_the_jacobian_of_the_forces_is_that_of_finite_differences(seed):
    rng = np.random.default_rng(seed)
    arms, x = 0.05 * rng.standard_normal((6, 3)), np.array([5.0] * 3 + [20.0] * 3)
    x *= rng.standard_normal(6)
    R, force = rng.uniform(0.5, 2.0, (6, 3)), rng.standard_normal((6, 3))

    def misfit(state):
        return add_forces(np.zeros((6, 6)), np.zeros(6), state, force, R, arms)[0]

    g, N = np.zeros(6), np.zeros((6, 6))
    add_forces(N, g, x, force, R, arms)
    slopes = [(misfit(x + 1e-4 * e) - misfit(x - 1e-4 * e)) / 2e-4 for e in np.eye(6)]
    assert_allclose(-2.0 * g, slopes, rtol=1e-5, atol=1e-5 * np.abs(g).max())
    fit, freedom = add_forces(N, g, x, force, R, arms)
    assert freedom == 18 - 3 - 6
    # Without noise the misfit is zero, and quadratic about it with N.
    for row, arm in enumerate(arms):
        force[row] = specific_force_at(arm, np.ones(3), x[:3], x[3:])
    N[:] = 0.0
    assert add_forces(N, g, x, force, R, arms)[0] == pytest.approx(0.0, abs=1e-18 + 1e-20 * fit)
    step = 1e-5 * rng.standard_normal(6)
    assert misfit(x + step) == pytest.approx(step @ N @ step, rel=1e-3)


@pytest.mark.parametrize('missed', [0.0, 0.3])
def test_what_the_trapezoid_misses_is_learnt_as_a_part_of_the_turn(missed, rng):
    walk, sigma, before = np.zeros(2), 1e-3, np.zeros(6)
    for _ in range(2000):
        now = np.concatenate([np.zeros(3), 50.0 * rng.standard_normal(3)])
        turned = 0.5 * DT * (before[3:] + now[3:])
        now[:3] = before[:3] + turned + missed * np.abs(turned) * rng.choice([-1.0, 1.0], 3)
        measured = now.copy()
        measured[:3] += sigma * rng.standard_normal(3)
        learn_walk(walk, before, measured, np.full(3, sigma**2), DT)
        before = now
    # The last second, 600 numbers: standard error 6 % of a part of 0.09, or of sigma's 3e-5.
    assert walk[0] / walk[1] == pytest.approx(missed**2, rel=0.2, abs=1e-5)


def test_a_walk_that_was_learnt_widens_the_prediction():
    x, P = start_bridge(np.zeros(3), np.full(3, 1e-6), np.full(3, 10.0), 0.01 * np.eye(3))
    at_limit, gyro_R = np.zeros((1, 6)), np.full((1, 3), np.inf)
    told = (np.zeros((1, 3)), gyro_R, at_limit, maps(1), np.zeros((1, 3)), gyro_R, RING[:1])
    _, calm = bridge_rate(x, P, DT, HAND, np.zeros(2), *told)
    _, rough = bridge_rate(x, P, DT, HAND, np.array([0.5, 1.0]), *told)
    assert_allclose(np.diag(rough - calm)[:3], 0.5 * DT**2 * 300.0, rtol=1e-6)  # |a|^2 = 300


@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_an_estimate_short_of_a_limit_is_moved_to_it_and_no_farther(sign):
    x, P = start_bridge(np.zeros(3), np.full(3, 1.0), np.zeros(3), np.eye(3))
    gyro, at_limit, unread = (
        sign * np.array([[0.0, 0.0, 10.0]]),
        np.zeros((1, 6)),
        np.full((1, 3), np.inf),
    )
    at_limit[0, 2] = 1.0
    told = (gyro, np.full((1, 3), 1e-6), at_limit, maps(1), np.zeros((1, 3)), unread, RING[:1])
    found, _ = bridge_rate(x, P, DT, HAND, np.zeros(2), *told)
    assert found[2] == pytest.approx(sign * 9.98, rel=1e-12)  # 0.998 of full scale
    assert_allclose(found[:2], 0.0, atol=1e-12)
    x[2] = sign * 15.0
    assert bridge_rate(x, P, DT, HAND, np.zeros(2), *told)[0][2] == pytest.approx(sign * 15.0)
