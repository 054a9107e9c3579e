"""One filter per IMU: the virtual IMU's answer, honest, and without the IMU that fails."""

from federated_runs import (
    ARMS,
    BIAS,
    board,
    configs,
    errors,
    flags,
    ONE,
    run_federated,
    run_virtual,
    WALK,
)
import numpy as np
from numpy.testing import assert_allclose
from odometry_runs import nees, to_start_frame
import pytest

from multiimu_ros.odometry.error_state import ErrorStateFilter
from multiimu_ros.odometry.federated_odometry import FederatedOdometry
from multiimu_ros.odometry.rest import Sample
from multiimu_ros.rotations import log_so3
from multiimu_ros.simulation.gait import duration_of

STANDING = np.tile(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.80665]), (3, 1))
DENSITY = np.tile(ONE, (3, 1))


def standing(odometry, count, values=STANDING, dt=0.01):
    """Push `count` scans of a rig that is still, but not at rest."""
    for _ in range(count):
        odometry.push_scan(dt, values, DENSITY[: len(values)], still=True, resting=False)


def three():
    """Return an odometry of three IMUs on a foot."""
    return FederatedOdometry(
        configs('foot', 3)[2], ARMS, np.tile(BIAS, (3, 1)), np.tile(WALK, (3, 1)), DENSITY
    )


def without(missing):
    """Return a scan of a standing rig in which some IMUs are missing."""
    values = STANDING.copy()
    values[missing] = np.nan
    return values


@pytest.mark.compiled
def test_a_single_imu_at_the_base_is_the_error_state_filter():
    some = board('hand', 6.0, 100, seed=1, arms=np.zeros((1, 3)))
    odometry = FederatedOdometry(
        configs('hand', 1)[2], np.zeros((1, 3)), BIAS[np.newaxis], WALK[np.newaxis], some.density
    )
    alone = ErrorStateFilter(configs('hand', 1)[2])
    seen = [(k % 200 > 100, k % 200 > 150) for k in range(len(some.values))]
    for row, (still, resting) in zip(some.values, seen, strict=True):
        odometry.push_scan(0.01, row, some.density, still=still, resting=resting)
        rate, force = row[0, :3], row[0, 3:]
        alone.push(Sample(0.01, rate, force, ONE[:3], ONE[3:], still, resting))
    # The master goes through a logarithm and an exponential: 1e-9 of the few seconds' errors.
    assert_allclose(odometry.state, alone.state, rtol=1e-9, atol=1e-9)
    assert_allclose(odometry.R_nb, alone.R_nb, atol=1e-9)
    assert_allclose(odometry.P, alone.P, rtol=1e-9, atol=1e-15)


def test_a_base_that_only_turns_stays_while_its_imu_circles():
    arm, dt = 0.1, 0.01
    odometry = FederatedOdometry(
        configs('hand', 1)[2], np.array([[arm, 0.0, 0.0]]), BIAS[np.newaxis], WALK[np.newaxis],
        DENSITY[:1],
    )  # fmt: skip
    for t in dt * np.arange(200):
        rate, acceleration = 1.0 - np.cos(np.pi * t), np.pi * np.sin(np.pi * t)
        row = [0.0, 0.0, rate, -arm * rate**2, arm * acceleration, 9.80665]
        odometry.push_scan(dt, np.array([row]), DENSITY[:1], still=False, resting=False)
        # A tenth of a millimetre of integration error; the IMU itself is up to 2 * 0.1 m away.
        assert_allclose(odometry.position_n, 0.0, atol=1e-4)
        assert_allclose(odometry.velocity_n, 0.0, atol=1e-3)


@pytest.mark.compiled
def test_three_like_imus_are_one_virtual_imu():
    some = board('hand', 8.0, 100, seed=2)
    seen = flags(some, 'hand')
    (_, ours), (_, theirs) = run_federated(some, 'hand', seen), run_virtual(some, 'hand', seen)
    sigma = np.sqrt(np.diag(theirs[-1][3]))
    # What is left is how the swing of the lever arms is integrated between samples.
    assert (np.abs(ours[-1][0] - theirs[-1][0]) < 0.05 * sigma[:3]).all()
    assert_allclose(np.sqrt(np.diag(ours[-1][3])), sigma, rtol=0.02)


@pytest.mark.long
@pytest.mark.slow  # where nothing is compiled
def test_the_masters_uncertainty_is_what_its_error_is():
    scores = []
    for seed in range(6):
        some = board('hand', 30.0, 200, seed)
        _, states = run_federated(some, 'hand', flags(some, 'hand'))
        R, p, v = to_start_frame(some.motion)
        for k in range(1400, len(p), 200):
            position, velocity, attitude, P = states[k]
            theta = log_so3(np.ascontiguousarray(attitude.T @ R[k]))
            each = (p[k] - position, v[k] - velocity, theta)
            scores.append(
                [nees(e, P[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]) for i, e in enumerate(each)]
            )
    # Errors last for a whole run: 6 runs of 3 axes have a standard error of sqrt(2/18) = 0.33.
    assert_allclose(np.mean(scores, axis=0), 1.0, atol=0.66)


@pytest.mark.long
@pytest.mark.slow  # where nothing is compiled
@pytest.mark.parametrize('gain', [(1.0, 1.0, 1.0), (1.0, 1.0, 2.45)])  # one of six times R
def test_isolation_costs_at_most_15_percent_of_error(gain):
    squares = np.zeros(2)
    for seed in range(2):
        some = board('foot', duration_of(60.0), 200, seed, gain=gain)
        seen = flags(some, 'foot')
        for k, run in enumerate((run_federated, run_virtual)):
            squares[k] += np.mean(np.sum(errors(some, run(some, 'foot', seen)[1]) ** 2, axis=1))
    assert squares[0] < 1.15**2 * squares[1]


@pytest.mark.slow  # where nothing is compiled
def test_a_gyroscope_that_fails_in_a_walk_takes_its_error_along():
    some = board('foot', duration_of(40.0), 200, seed=0)
    seen = flags(some, 'foot')
    healthy = np.linalg.norm(errors(some, run_federated(some, 'foot', seen)[1])[-1])
    # The second of three, 20 s into the walk.  The profile expects errors of 4 % of a swing, which
    # turns at 5 rad/s; by less than that, 0.2 rad/s, a real foot could be misjudged.
    some.values[4000:, 1, 2] += np.deg2rad(20.0)
    odometry, states = run_federated(some, 'foot', seen)
    left = np.linalg.norm(errors(some, states)[-1])
    fused = np.linalg.norm(errors(some, run_virtual(some, 'foot', seen)[1])[-1])
    assert odometry.shares[1] == 0.0
    # Two of three: sqrt(3/2) of the noise; but two draws of it are compared, so allow 3 cm more.
    assert left < 1.23 * healthy + 0.03
    assert fused > 10 * left  # a third of 20 deg/s for the virtual IMU, if nobody guards it


@pytest.mark.compiled
def test_a_lost_sample_does_not_move_the_master():
    some = board('hand', 6.0, 100, seed=4)
    seen = flags(some, 'hand')
    full, states = run_federated(some, 'hand', seen)
    holes = some.values.copy()
    holes[np.random.default_rng(0).random(holes.shape[:2]) < 0.05] = np.nan
    _, patched = run_federated(some, 'hand', seen, holes)
    there, here = (np.array([state[0] for state in run]) for run in (states, patched))
    sigma = np.sqrt(np.trace(full.P[:3, :3]))
    assert np.linalg.norm(here - there, axis=1).max() < 0.5 * sigma
    # The three are 0.5 sigma apart by then: a mean of whoever is there would jump by as much.
    jump = np.linalg.norm(np.diff(here - there, axis=0), axis=1).max()
    assert jump < 0.1 * sigma


def test_who_is_silent_leaves_and_is_watched_when_it_returns():
    odometry = three()
    standing(odometry, 100)
    before = odometry.P[11, 11]
    standing(odometry, 30, without([0]))
    assert_allclose(odometry.shares, [0.0, 0.5, 0.5])
    # The bias about the vertical, of which standing tells nothing: a mean of two, then of three.
    assert_allclose(odometry.P[11, 11] / before, 1.5, rtol=1e-3)
    standing(odometry, 190)
    assert odometry.shares[0] == 0.0
    standing(odometry, 20)  # 2 s after it came
    assert_allclose(odometry.shares, 1 / 3)


def test_where_all_members_fall_silent_another_takes_over():
    odometry = three()
    standing(odometry, 50)
    standing(odometry, 50, without([2]))
    before = odometry.P
    standing(odometry, 25, without([0, 1, 2]))
    assert_allclose(odometry.position_n, 0.0, atol=1e-3)
    standing(odometry, 2, without([0, 1]))
    assert_allclose(odometry.shares, [0.0, 0.0, 1.0])
    assert np.sqrt(odometry.P[0, 0]) > np.sqrt(before[0, 0]) + 0.1  # 0.25 s at 5 m/s^2
    assert np.isfinite(odometry.state).all()


def test_two_that_differ_are_both_kept():
    odometry = FederatedOdometry(
        configs('foot', 2)[2], ARMS[:2], np.tile(BIAS, (2, 1)), np.tile(WALK, (2, 1)), DENSITY[:2]
    )
    standing(odometry, 50, STANDING[:2])
    wrong = STANDING[:2].copy()
    wrong[0, 0] = 1.0
    for _ in range(100):
        odometry.push_scan(0.01, wrong, DENSITY[:2], still=False, resting=False)
    assert_allclose(odometry.shares, 0.5)


@pytest.mark.compiled
def test_a_standing_rig_stays_where_it_is(rng):
    odometry, positions = three(), []
    noise = DENSITY * np.sqrt(100) * rng.standard_normal((1000, 3, 6))
    for row in STANDING + noise:
        odometry.push_scan(0.01, row, DENSITY, still=True, resting=True)
        positions.append(odometry.position_n)
    assert np.abs(np.array(positions) - positions[200]).max() < 1e-3


def test_saved_biases_and_a_reset():
    odometry = three()
    bias, sigma = np.tile([0.01] * 3 + [0.1] * 3, (3, 1)), np.tile([1e-4] * 3 + [0.01] * 3, (3, 1))
    odometry.restore_each(bias, sigma)
    standing(odometry, 20, STANDING + bias)
    assert_allclose(odometry.gyro_bias, 0.01, atol=1e-5)
    assert_allclose(odometry.local_biases[:, 3:], 0.1, atol=1e-3)
    assert_allclose(np.sqrt(odometry.P[9, 9]), 1e-4 / np.sqrt(3), rtol=0.01)  # of a mean of three
    R = odometry.R_nb
    odometry.reset_motion()
    assert_allclose(odometry.state[:6], 0.0)
    assert_allclose(odometry.R_nb, R)
    standing(odometry, 20, STANDING + bias)
    assert_allclose(odometry.position_n, 0.0, atol=1e-3)
    fresh = three()
    fresh.align(STANDING[0, 3:], 0.1, 0.0)
    fresh.restore_biases(np.full(3, 0.01), np.full(3, 1e-4), np.full(3, 0.1), np.full(3, 0.01))
    assert_allclose(fresh.gyro_bias, 0.01)
    # The mean of the three is as good as it was saved, and as what each may differ by.
    expected = 1e-8 + BIAS[0] ** 2 / 3
    assert_allclose(fresh.P[9, 9], expected, rtol=1e-9)


def test_rows_must_match_the_lever_arms():
    with pytest.raises(ValueError, match=r'`bias_sigma` must be \(3, 6\).*got \(2, 6\)'):
        FederatedOdometry(configs('foot', 3)[2], ARMS, np.ones((2, 6)), DENSITY, DENSITY)
