"""What poses and turns can tell: against counting, finite differences, and simulated fits."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.calibration import coverage as cv

FACES, EDGES = cv.CANDIDATES[:6], cv.CANDIDATES[6:]
GRAVITY = 9.80665


def circle(count):
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)


def within(tilt_deg, count, rng):
    """Return directions (count, 3) spread over a cap about z."""
    z = rng.uniform(np.cos(np.deg2rad(tilt_deg)), 1.0, count)
    turn = rng.uniform(0, 2 * np.pi, count)
    return np.stack([*(np.sqrt(1 - z**2) * [np.cos(turn), np.sin(turn)]), z], axis=1)


def directions(seed, count=20):
    vectors = np.random.default_rng(seed).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def model_norm(parameters, raw):
    """Return |M S (raw - b)| of each row, written out."""
    scale, (xy, xz, yz), bias = parameters.reshape(3, 3)
    M = np.array([[1.0, xy, xz], [0.0, 1.0, yz], [0.0, 0.0, 1.0]])
    return np.linalg.norm((raw - bias) * scale @ M.T, axis=1)


NOMINAL = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])


def test_jacobian_agrees_with_finite_differences():
    up, step = directions(1), 1e-6
    numeric = [
        (model_norm(NOMINAL + d, GRAVITY * up) - model_norm(NOMINAL - d, GRAVITY * up))
        / (2 * step)
        for d in step * np.eye(9)
    ]
    # Central differences: step^2 from the third derivative, 1e-15 / step from rounding.
    assert_allclose(cv.pose_jacobian(up, GRAVITY), np.transpose(numeric), atol=1e-8)


@pytest.mark.parametrize(
    ('up_s', 'told'),
    [
        (FACES, [1, 1, 1, 0, 0, 0, 1, 1, 1]),  # six equations, none mixes two axes: rank 6
        (circle(20), [1, 1, 0, 1, 0, 0, 1, 1, 0]),  # nothing along z: rank 5
        (cv.CANDIDATES, [1, 1, 1, 1, 1, 1, 1, 1, 1]),
        (FACES[:1], [0, 0, 0, 0, 0, 0, 0, 0, 0]),  # scale and bias cannot be told apart
        (np.empty((0, 3)), [0, 0, 0, 0, 0, 0, 0, 0, 0]),
    ],
)
def test_sigma_is_infinite_exactly_where_the_poses_do_not_tell(up_s, told):
    sigmas = cv.pose_sigmas(up_s, 1e-3, GRAVITY)
    assert np.isfinite(sigmas).tolist() == [bool(t) for t in told]


def test_rank_of_the_jacobian_is_six_for_faces_and_five_for_a_circle():
    assert np.linalg.matrix_rank(cv.pose_jacobian(FACES, 1.0)) == 6
    assert np.linalg.matrix_rank(cv.pose_jacobian(circle(20), 1.0)) == 5


def test_sigmas_are_those_of_repeated_fits(rng):
    up, sigma, runs = cv.CANDIDATES, 2e-3, 4000
    jacobian = cv.pose_jacobian(up, GRAVITY)
    noise = sigma * rng.standard_normal((len(up), runs))
    scatter = np.linalg.lstsq(jacobian, noise, rcond=None)[0].std(axis=1)
    # The standard error of a standard deviation of 4000 runs is 1/sqrt(8000) = 1.1 %; four of it.
    assert_allclose(cv.pose_sigmas(up, sigma, GRAVITY), scatter, rtol=0.045)


def test_faces_and_edges_are_good_and_a_cap_is_hopeless(rng):
    # 18 poses for 9 parameters: a scale no worse than the mean of two poses, shear than one pose.
    good = cv.pose_sigmas(cv.CANDIDATES, 1.0, 1.0)
    assert good.max() <= 1.0 + 1e-12
    # Within 30 deg of vertical, scale and bias of z differ by cos^2 - cos only.
    assert cv.pose_sigmas(within(30.0, 18, rng), 1.0, 1.0).max() > 100.0


@given(seed=st.integers(0, 2**32 - 1))
def test_more_poses_never_tell_less(seed):
    up = directions(seed)
    fewer, more = cv.pose_sigmas(up[:12], 1.0, 1.0), cv.pose_sigmas(up, 1.0, 1.0)
    assert (more <= fewer * (1 + 1e-9)).all()  # rounding


def test_nothing_is_missing_from_faces_and_edges():
    assert cv.missing_poses(cv.CANDIDATES) == ()


def test_all_is_missing_from_nothing_and_faces_come_first():
    missing = cv.missing_poses(np.empty((0, 3)))
    faces = {f'{sign}{axis} up' for sign in '+-' for axis in 'xyz'}
    assert len(missing) == len(set(missing)) == 18
    assert set(missing[:6]) == faces


def test_each_named_pose_gains_most_of_all_that_are_left():
    up = [FACES[0], EDGES[3]]
    named = {f'{cv.name_direction(v, signed=True)} up': v for v in cv.CANDIDATES}
    first = cv.missing_poses(np.array(up))[0]
    prior = np.diag(np.r_[[0.01] * 6, [0.4] * 3] ** -2.0)  # the package's nominal sensor

    def information(poses):
        rows = cv.pose_jacobian(np.array(poses), GRAVITY) / 2e-3
        return np.linalg.slogdet(prior + rows.T @ rows)[1]

    gains = {name: information([*up, v]) for name, v in named.items()}
    left = {name: gains[name] for name in cv.missing_poses(np.array(up))}
    assert gains[first] == pytest.approx(max(left.values()), rel=1e-12)  # a tie may win


@pytest.mark.parametrize(('tilt_deg', 'covered'), [(34.0, True), (36.0, False)])
def test_a_pose_within_35_deg_stands_for_a_face(tilt_deg, covered):
    # Tilted towards a corner of the cube, away from the edges.
    tilt = np.deg2rad(tilt_deg)
    up = [[np.cos(tilt), np.sin(tilt) / np.sqrt(2), np.sin(tilt) / np.sqrt(2)]]
    assert ('+x up' not in cv.missing_poses(up)) == covered


@pytest.mark.parametrize(('tilt_deg', 'covered'), [(24.0, True), (26.0, False)])
def test_a_pose_within_25_deg_stands_for_an_edge(tilt_deg, covered):
    tilt = np.deg2rad(tilt_deg)
    up = [[np.cos(tilt) / np.sqrt(2), np.cos(tilt) / np.sqrt(2), np.sin(tilt)]]
    assert ('+x+y up' not in cv.missing_poses(up)) == covered


def test_a_rank_deficient_set_is_completed_by_the_poses_it_is_told():
    named = {f'{cv.name_direction(v, signed=True)} up': v for v in cv.CANDIDATES}
    up = np.vstack([FACES, [named[name] for name in cv.missing_poses(FACES)[:6]]])
    assert np.isfinite(cv.pose_sigmas(up, 1.0, 1.0)).all()


def test_turns_about_the_vertical_do_not_count():
    turns = [[0.0, 0.0, 2.0], [0.5, 0.0, 7.0]]
    coverage = cv.rotation_coverage(turns, [[0.0, 0.0, 1.0], [0.0, 0.0, 1.0]])
    assert_allclose(coverage.turned, [0.5, 0.0, 0.0], atol=1e-15)


def test_three_quarter_turns_about_three_axes_lack_nothing():
    turns = np.deg2rad(80.0) * np.eye(3)  # as hands do it
    coverage = cv.rotation_coverage(turns, np.roll(np.eye(3), 1, axis=0))
    assert coverage.lacking == ()
    assert_allclose(coverage.principal, np.deg2rad(80.0), rtol=1e-12)


@pytest.mark.parametrize(
    ('turns', 'up_s', 'lacking'),
    [
        ([[2.0, 0, 0], [0, 2.0, 0]], [[0, 0, 1], [0, 0, 1]], ('z',)),
        ([[0, 3.0, 0]], [[1, 0, 0]], ('x', 'z')),
        ([[0, 0.1, 0]], [[1, 0, 0]], ('x', 'y', 'z')),
        (np.empty((0, 3)), np.empty((0, 3)), ('x', 'y', 'z')),
        ([[2, 2, 0], [0, 0, 2.0]], [[1, -1, 0], [1, 1, 0]], ('x-y',)),
    ],
)
def test_axes_without_rotation_are_named(turns, up_s, lacking):
    assert cv.rotation_coverage(turns, up_s).lacking == lacking


def test_lever_information_agrees_with_the_cross_products(rng):
    rate, acceleration = rng.standard_normal((2, 50, 3))
    columns = [np.cross(acceleration, r) + np.cross(rate, np.cross(rate, r)) for r in np.eye(3)]
    naive = np.einsum('ink,jnk->ij', columns, columns) * 0.005
    information = cv.lever_arm_information(rate, acceleration, np.full(50, 0.005))
    assert_allclose(information, naive, rtol=1e-12)


def test_a_lever_arm_along_the_only_axis_of_rotation_is_not_told(rng):
    rate = np.outer(rng.standard_normal(1000), [0.0, 1.0, 0.0])
    information = cv.lever_arm_information(rate, 3 * rate, np.full(1000, 0.01))
    coverage = cv.lever_arm_coverage(information)
    assert coverage.weakest == 'y'
    assert np.isinf(coverage.sigmas(1e-3)[0])
    assert np.isfinite(coverage.sigmas(1e-3)[1:]).all()


def test_predicted_sigma_is_that_of_repeated_lever_arm_fits(rng):
    rate, acceleration = 3.0 * rng.standard_normal((2, 200, 3))
    dt, density, runs = 0.01, 2e-3, 3000
    lever = np.concatenate(
        [
            np.transpose([np.cross(a, r) + np.cross(w, np.cross(w, r)) for r in np.eye(3)])
            for w, a in zip(rate, acceleration, strict=True)
        ]
    )
    noise = np.sqrt(2 / dt) * density * rng.standard_normal((len(lever), runs))
    errors = np.linalg.lstsq(lever, noise, rcond=None)[0]
    information = cv.lever_arm_information(rate, acceleration, np.full(200, dt))
    scatter = np.sqrt(np.linalg.eigvalsh(np.cov(errors)))[::-1]
    # The standard error of a standard deviation of 3000 runs is 1.3 %; four of it.
    assert_allclose(cv.lever_arm_coverage(information).sigmas(density), scatter, rtol=0.053)


@pytest.mark.parametrize(
    ('vector', 'name', 'signed'),
    [
        ([0, 0, -1], 'z', '-z'),
        ([-1, 1, 0.1], 'x-y', '-x+y'),
        ([0.1, 0.9, -0.5], 'y-z', '+y-z'),
        ([1, 1, 1], 'x+y+z', '+x+y+z'),
    ],
)
def test_directions_are_named_by_their_axes(vector, name, signed):
    assert cv.name_direction(vector) == name
    assert cv.name_direction(vector, signed=True) == signed


def test_bad_shapes_are_named():
    with pytest.raises(ValueError, match=r'`up_s` must have shape \(N, 3\)'):
        cv.missing_poses(np.zeros(3))
