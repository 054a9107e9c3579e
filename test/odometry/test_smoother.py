"""The smoother: exact where all is linear, honest where not, better than live."""

from dataclasses import replace

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import filters, FORCE_DENSITY, G, nees, RATE_DENSITY, read, to_start_frame
import pytest

from multiimu_ros.odometry import smoother
from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.rest import RestBuffer, Sample
from multiimu_ros.odometry.smoother import (
    admit_losses,
    believe_rest,
    Recording,
    smooth,
    Smoother,
)
from multiimu_ros.odometry.smoother_kernels import run_backward, run_forward, solve
from multiimu_ros.rotations import log_so3
from multiimu_ros.simulation.trajectories import make_motion

UP = np.array([0.0, 0.0, G])


def recorded(rate, force, dt=0.01, still=False, resting=False):
    """Return a recording with the noise of `read`; scalars stand for a constant."""
    n = len(rate)
    return Recording(
        dt=np.full(n, dt),
        angular_rate=rate,
        specific_force=force,
        rate_density=np.tile(RATE_DENSITY, (n, 1)),
        force_density=np.tile(FORCE_DENSITY, (n, 1)),
        still=np.full(n, still),
        resting=np.full(n, resting),
    )


def samples_of(recording):
    """Yield what a live filter is pushed."""
    columns = [column.copy() for column in vars(recording).values()]
    for row in zip(*columns, strict=True):
        yield Sample(*row)


def live(profile, name, duration, rate_hz, seed, noise_gain=1.0):
    """Return motion, recording, config, biases, and the live positions and velocities."""
    rng = np.random.default_rng(seed)
    motion = make_motion(name, duration, rate_hz, seed)
    rate, force, *biases = read(motion, rng, rate_hz, noise_gain)
    detector, _, odometry = filters(profile)
    recording = recorded(rate, force, 1 / rate_hz)
    recording.rate_density[:] *= noise_gain
    recording.force_density[:] *= noise_gain
    track = []
    for k, sample in enumerate(samples_of(recording)):
        flags = detector.push(*sample[:5])
        recording.still[k], recording.resting[k] = flags
        odometry.push(sample._replace(still=flags[0], resting=flags[1]))
        track.append(odometry.state[:6])
    return motion, recording, odometry._config, biases, np.array(track)


def linear_case():
    """Return a filter whose attitude is known for ever, hence linear, and its noise."""
    _, _, odometry = filters('hand')
    config = replace(
        odometry._config, rate_bias_walk=np.zeros(3), force_bias_walk=np.full(3, 0.1),
        zero_velocity_sigma=0.1, zero_velocity_time=0.0, rate_bias_sigma=np.zeros(3),
    )  # fmt: skip
    return ErrorStateFilter(config)


def batch(n, dt, force, zero, sigma):
    """Return the least-squares (position, velocity, accel bias) at n + 1 samples, naively.

    Start: position known, velocity to 1 m/s, bias to 0.3 m/s^2; force density 1, walk 0.1;
    velocity zero to `sigma` after the steps in `zero`.
    """
    A, one = np.eye(9), np.eye(3)
    A[:3, 3:6], A[:3, 6:], A[3:6, 6:] = dt * one, -0.5 * dt**2 * one, -dt * one
    u = np.concatenate((0.5 * dt**2 * force, dt * force, np.zeros(3)))
    Q = np.kron([[dt**3 / 3, dt**2 / 2, 0], [dt**2 / 2, dt, 0], [0, 0, 0.01 * dt]], one)
    W = np.linalg.inv(np.linalg.cholesky(Q))
    size = 9 * (n + 1)
    rows = [np.diag([1.0] * 3 + [1 / 0.3] * 3) @ np.eye(6, size, 3)]
    known = [np.zeros(6)]
    for k in range(n):
        row = np.zeros((9, size))
        row[:, 9 * k : 9 * k + 9], row[:, 9 * k + 9 : 9 * k + 18] = -W @ A, W
        rows.append(row)
        known.append(W @ u)
        if k in zero:
            rows.append(np.eye(3, size, 9 * k + 12) / sigma)
            known.append(np.zeros(3))
    J = np.vstack(rows)[:, 3:]  # the first position is zero, without doubt
    root = np.linalg.pinv(J)
    best = np.concatenate((np.zeros(3), root @ np.concatenate(known)))
    P = np.zeros((size, size))
    P[3:, 3:] = root @ root.T
    return best.reshape(-1, 9), P


def test_a_linear_case_equals_least_squares():
    n, dt, push = 12, 0.04, np.array([1.0, -0.5, 0.2])
    zero = (4, 5, 10)
    start = linear_case()
    x, R, P = np.zeros(15), np.eye(3), np.zeros((15, 15))
    memory, settings = start._memory.copy(), start._settings
    P[range(3, 6), range(3, 6)], P[range(12, 15), range(12, 15)] = 1.0, 0.09
    memory[:6] = (0, 0, 0, *(UP + push))
    readings = np.tile(np.concatenate((np.zeros(3), UP + push, np.zeros(3), np.ones(3))), (n, 1))
    flags = np.zeros((n, 2), bool)
    flags[list(zero), 0] = True
    tape = np.empty((n, 2, 15)), np.empty((n, 2, 3, 3)), np.empty((n, 4, 15, 15))
    run_forward(x, R, P, memory, settings, np.full(n, dt), readings, flags, *tape)
    out = np.empty((n + 1, 15)), np.empty((n + 1, 3, 3)), np.empty((n + 1, 15, 15))
    run_backward(x, R, P, *tape, *out)
    (expected, covariance), pick = batch(n, dt, push, zero, 0.1), np.r_[0:6, 12:15]
    # One optimum by two routes; condition numbers of 1e6 leave ten digits.
    assert_allclose(out[0][:, pick], expected, atol=1e-9)
    for k in range(n + 1):
        block = covariance[9 * k : 9 * k + 9, 9 * k : 9 * k + 9]
        assert_allclose(out[2][k][np.ix_(pick, pick)], block, atol=1e-9)


def test_solve_takes_no_direction_from_a_singular_matrix(rng):
    basis = rng.standard_normal((6, 4))
    P = basis @ basis.T  # rank 4
    P[2], P[:, 2] = 0.0, 0.0
    B = P @ rng.standard_normal((6, 5))
    X = solve(P, B)
    assert np.isfinite(X).all()
    assert (X[2] == 0.0).all()
    # A consistent right-hand side is met, to rounding times the condition number.
    assert_allclose(P @ X, B, atol=1e-9)


@pytest.mark.compiled
def test_the_forward_pass_is_the_filter():
    _, recording, config, _, _ = live('foot', 'foot', 8.0, 50, seed=3)
    moving = replace(recording, resting=np.zeros_like(recording.resting))
    odometry = ErrorStateFilter(config)
    for sample in samples_of(moving):
        odometry.push(sample)
    smoothed = smooth(config, moving)
    # The last sample has no future.  Rounding, of a covariance that spans 12 decades.
    assert_allclose(smoothed.state[-1], odometry.state, atol=1e-9)
    assert_allclose(smoothed.P[-1], odometry.P, rtol=1e-6, atol=1e-12)


def test_marks_do_not_matter(monkeypatch, rng):
    rate, force = 0.1 * rng.standard_normal((60, 3)), UP + rng.standard_normal((60, 3))
    recording = recorded(rate, force)
    recording.still[20:30] = recording.still[45:] = True
    _, _, odometry = filters('foot')
    whole = smooth(odometry._config, recording)
    monkeypatch.setattr(smoother, 'SEGMENT', 7)
    marked = Smoother(odometry._config, recording)
    assert sum(1 for _ in marked.solve()) == 2 * marked.segments == 18
    parts = list(marked.blocks())
    # Kernels that run twice give the same numbers.
    for name in ('rows', 'state', 'R_nb', 'P'):
        joined = np.concatenate([getattr(block, name) for block in parts])
        assert (joined == getattr(whole, name)).all()
    assert (whole.rows == np.arange(60)).all()


@given(
    pattern=st.lists(st.sampled_from(['move', 'still', 'rest']), min_size=2, max_size=40),
    lag=st.sampled_from([0.0, 0.025, 0.095]),
)
def test_rest_is_believed_as_the_buffer_believes_it(pattern, lag):
    resting = np.array([word == 'rest' for word in pattern] + [False])
    still = resting | np.array([word == 'still' for word in pattern] + [False])
    buffer, said = RestBuffer(lag), []
    for k in range(len(still)):
        sample = Sample(0.01, UP, UP, UP, UP, bool(still[k]), bool(resting[k]))
        said += [(late.still, late.resting) for late in buffer.push(sample)]
    assert believe_rest(np.full(len(still), 0.01), still, resting, lag).tolist() == [
        list(pair) for pair in said
    ]


@pytest.mark.slow  # where nothing is compiled
def test_a_smoothed_walk_is_nearer_to_the_truth():
    squares = np.zeros((2, 2))
    for seed in range(4):
        # An IMU so poor that its noise, which differs from seed to seed, makes most of the error.
        motion, recording, config, _, track = live('foot', 'foot', 30.0, 100, seed, 20.0)
        _, position, velocity = to_start_frame(motion)
        smoothed = smooth(config, recording)
        for row, state in enumerate((track, smoothed.state)):
            squares[row, 0] += np.mean((state[:, :3] - position) ** 2)
            squares[row, 1] += np.mean((state[:, 3:6] - velocity) ** 2)
    gain_p, gain_v = np.sqrt(squares[1] / squares[0])
    # A swing tied at both ends: its velocity errs by t (T - t) / T in place of t, which is
    # 1 / sqrt(3) of it in the mean; what heading adds does not become less.
    assert gain_v < 0.75
    # The path errs mostly by heading; the second rest tells of that as much as the first did.
    assert gain_p < 0.9


@pytest.mark.long
@pytest.mark.slow  # where nothing is compiled
def test_uncertainty_is_what_the_smoothed_error_is():
    scores, gains = [], []
    for seed in range(6):
        motion, recording, config, biases, track = live('hand', 'hand', 30.0, 100, seed)
        true_R, true_p, true_v = to_start_frame(motion)
        smoothed = smooth(config, recording)
        for k in range(100, len(true_p), 100):
            theta = log_so3(np.ascontiguousarray(smoothed.R_nb[k].T @ true_R[k]))
            truth = np.concatenate((true_p[k], true_v[k], np.zeros(3), biases[0][k], biases[1][k]))
            error = truth - smoothed.state[k]
            error[6:9] = theta
            P = smoothed.P[k]
            cut = [slice(i, i + 3) for i in range(0, 15, 3)]
            scores.append([nees(error[part], P[part, part]) for part in cut])
        errors = [np.linalg.norm(p - true_p) for p in (track[:, :3], smoothed.position_n)]
        gains.append(errors[0] / errors[1])
    # Errors last for a whole run: 6 runs of 3 axes have a standard error of sqrt(2/18) = 0.33.
    assert_allclose(np.mean(scores, axis=0), 1.0, atol=0.66)
    # What stood at the end did not move: the velocity's drift, and most of the path's, is undone.
    assert np.median(gains) > 1.5


@pytest.mark.compiled
def test_a_standing_rig_has_stood_all_the_time(rng):
    still = make_motion('static', 20.0, 50)
    rate, force, *_ = read(still, rng, 50)
    recording = recorded(rate, force, 0.02, still=True)
    recording.resting[50:] = True
    _, _, odometry = filters('hand')
    smoothed = smooth(odometry._config, recording)
    # 5 mm/s for a second, at most: the live filter had to believe in motion at first.
    assert np.abs(smoothed.position_n).max() < 5e-3
    assert np.isfinite(smoothed.P).all()
    assert (smoothed.position_n[0] == 0.0).all()
    yaw = np.einsum('i,nij,j->n', UP / G, smoothed.R_nb @ smoothed.P[:, 6:9, 6:9], UP / G)
    assert abs(yaw[0]) < 1e-12


def test_gaps_and_rubbish_are_bridged():
    rate, force = np.zeros((200, 3)), np.tile(UP, (200, 1))
    recording = recorded(rate, force, still=True)
    recording.still[80:120] = False
    recording.dt[100] = 1.5
    recording.angular_rate[90] = np.nan
    _, _, odometry = filters('hand')
    smoothed = smooth(odometry._config, recording)
    assert smoothed.rows.tolist() == [k for k in range(200) if k != 90]
    assert np.isfinite(smoothed.state).all()
    assert np.isfinite(smoothed.P).all()
    sigma = np.sqrt(smoothed.P[:, 0, 0])
    # 0.5 m/s^2 unseen for 1.5 s and zero velocity at both ends: a bridge of some 0.2 m.
    assert 0.02 < sigma[-1] - sigma[70] < 0.5
    assert np.abs(smoothed.position_n).max() < 0.01


def test_what_rested_up_to_a_hole_rested():
    dt, resting = np.full(10, 0.1), np.arange(10) < 6
    assert believe_rest(dt, resting, resting, 0.25)[:, 1].sum() == 4  # two younger than the lag
    dt[6] = 2.0
    assert believe_rest(dt, resting, resting, 0.25)[:, 1].sum() == 6


def test_a_lost_sample_is_admitted():
    _, _, odometry = filters('foot')
    config = odometry._config
    dt = np.array([0.01, 0.01, 0.013, 0.02, 0.01, 1.0, 0.01])  # jitter, one lost, a gap
    density = np.full((7, 3), 0.003)
    rate, force = admit_losses(dt, density, density, config)
    assert (rate[[0, 1, 2, 4]] == 0.003).all()
    # What was not seen for 10 ms may have changed the velocity by 10 ms of a swing's force.
    added = (force[3] ** 2 - 0.003**2) * dt[3]
    assert_allclose(np.sqrt(added), 0.01 * config.motion_sigma, rtol=1e-9)
    added = (rate[5] ** 2 - 0.003**2) * dt[5]  # the filter itself counts from 50 ms on
    assert_allclose(np.sqrt(added), 0.04 * config.motion_rate_sigma, rtol=1e-9)


@pytest.mark.compiled
def test_a_walk_that_is_known_to_end_where_it_began_does():
    _, recording, config, _, _ = live('hand', 'hand', 10.0, 50, seed=2)
    open_, closed = smooth(config, recording), smooth(config, recording, closed_sigma=1e-3)
    assert np.abs(closed.position_n[-1]).max() < 3e-3
    spread = [np.trace(s.P[:, :3, :3], axis1=1, axis2=2) for s in (open_, closed)]
    # More is known, so no variance is larger but by rounding.
    assert (spread[1] <= spread[0] + 1e-12).all()


def test_a_path_that_cannot_have_closed_is_a_surprise():
    _, _, odometry = filters('hand')
    rate, force = np.zeros((60, 3)), np.tile(UP, (60, 1))
    force[20:30, 0], force[30:40, 0] = 5.0, -5.0  # 5 cm aside, from rest to rest
    recording = recorded(rate, force, 0.01, still=True)
    recording.still[19:41] = False
    away, back = (Smoother(odometry._config, recording, sigma) for sigma in (1e-4, 1.0))
    assert away.closure is None
    for each in (away, back):
        for _ in each.solve():
            pass
        assert each.closure.gap == pytest.approx(0.05, rel=0.1)
    assert back.closure.surprise < 0.1 < away.closure.surprise


def test_one_sample_is_a_recording():
    _, _, odometry = filters('hand')
    smoothed = smooth(odometry._config, recorded(np.zeros((1, 3)), UP[np.newaxis]))
    assert smoothed.rows.tolist() == [0]
    assert (smoothed.position_n == 0.0).all()


def test_bad_input_is_named():
    rate, force = np.zeros((5, 3)), np.tile(UP, (5, 1))
    with pytest.raises(ValueError, match='`still` must have 5 rows as `dt`, got 4'):
        replace(recorded(rate, force), still=np.zeros(4, bool))
    with pytest.raises(ValueError, match=r'`dt` must be positive, got 0\.0'):
        recorded(rate, force, dt=0.0)
    _, _, odometry = filters('hand')
    with pytest.raises(ValueError, match='No sample of the recording is finite'):
        smooth(odometry._config, recorded(rate, np.full((5, 3), np.nan)))
