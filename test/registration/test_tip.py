"""Tip calibration: poses to rounding, honest sigmas, mix-ups named, and the file."""

from itertools import permutations
from textwrap import dedent

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import CalibrationError, ConfigError
from multiimu_ros.registration.tip import fit_tip, load_tip, TipBoard, TipSurvey

# Four corners of a 20 x 15 mm board, one of them cut off, the sensor 1.2 mm below the edge plane.
CORNERS = {
    'pin1': (-0.010, -0.0075, 0.0012),
    'pin8': (0.010, -0.0075, 0.0012),
    'usb': (0.010, 0.0075, 0.0012),
    'cut': (-0.004, 0.0075, 0.0012),
}
RECTANGLE = CORNERS | {'cut': (-0.010, 0.0075, 0.0012)}
SIGMA = 2e-4  # [m] a good optical tracker with a pointer
POSES = {
    'imu0': (Rotation.from_rotvec([0.3, -2.0, 0.5]), np.array([0.4, -0.2, 1.1])),
    'imu1': (Rotation.from_rotvec([-1.2, 0.4, 0.9]), np.array([0.45, -0.16, 1.12])),
    'imu2': (Rotation.from_rotvec([0.1, 3.0, -0.2]), np.array([0.37, -0.25, 1.05])),
}


def survey_of(rng=None, corners=CORNERS, sigma=0.0, **keys):
    """Return what a pointer with `sigma` [m] measures on the boards at POSES."""
    imus = {}
    for name, (R_ws, place) in POSES.items():
        points = R_ws.apply(list(corners.values())) + place
        if sigma:
            points = points + sigma * rng.standard_normal(points.shape)
        measured = dict(zip(corners, points.tolist(), strict=True))
        imus[name] = TipBoard(corners=corners, points=measured)
    return TipSurvey(version=1, main='imu0', imus=imus, **keys)


def relative(name, main='imu0'):
    """Return the truth R_main' R_i and R_main' (p_i - p_main)."""
    (R_m, p_m), (R_i, p_i) = POSES[main], POSES[name]
    return R_m.inv() * R_i, R_m.inv().apply(p_i - p_m)


def errors_of(fit, name):
    R, lever_arm = relative(name)
    found = fit.extrinsics[name]
    theta = (Rotation.from_quat(found.rotation).inv() * R).as_rotvec()
    return theta, found.lever_arm_b - lever_arm


@pytest.mark.parametrize('corners', [CORNERS, RECTANGLE])
def test_perfect_points_give_the_poses_to_rounding(corners):
    fit = fit_tip(survey_of(corners=corners))
    for name in POSES:
        theta, place = errors_of(fit, name)
        # Points a metre away carry 1e-16, boards of a centimetre turn that into 1e-14.
        assert_allclose(theta, 0.0, atol=1e-12)
        assert_allclose(place, 0.0, atol=1e-14)
        assert fit.residual_rms[name] < 1e-15
    assert np.array_equal(fit.extrinsics['imu0'].R_bs, np.eye(3))
    assert fit.extrinsics['imu0'].rotation_sigma == (0.0, 0.0, 0.0)


@given(st.integers(0, 2**32 - 1))
def test_moving_the_tracker_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    survey = survey_of(rng, sigma=SIGMA)
    turn, shift = Rotation.random(random_state=rng), rng.standard_normal(3)
    moved = {
        name: TipBoard(
            corners=board.corners,
            points={k: (turn.apply(v) + shift).tolist() for k, v in board.points.items()},
        )
        for name, board in survey.imus.items()
    }
    one, two = fit_tip(survey), fit_tip(survey.model_copy(update={'imus': moved}))
    for name in POSES:
        a, b = one.extrinsics[name], two.extrinsics[name]
        assert_allclose(a.R_bs, b.R_bs, atol=1e-11)
        assert_allclose(a.lever_arm, b.lever_arm, atol=1e-13)
        assert_allclose(a.rotation_sigma, b.rotation_sigma, rtol=1e-9)
        assert_allclose(a.lever_arm_sigma, b.lever_arm_sigma, rtol=1e-9)


def test_sigmas_are_what_errors_of_single_coordinates_add_up_to():
    corners = {k: (x + 0.02, y - 0.03, z) for k, (x, y, z) in CORNERS.items()}
    survey, h = survey_of(corners=corners, pointer_sigma=SIGMA), 1e-7
    variance = np.zeros((2, 3))
    for name in ('imu0', 'imu1'):
        for corner in corners:
            for axis in np.eye(3):
                points = dict(survey.imus[name].points)
                points[corner] = tuple(points[corner] + h * axis)
                board = TipBoard(corners=corners, points=points)
                moved = survey.model_copy(update={'imus': dict(survey.imus) | {name: board}})
                variance += (SIGMA / h * np.array(errors_of(fit_tip(moved), 'imu1'))) ** 2
    fit = fit_tip(survey).extrinsics['imu1']
    # One-sided differences over 1e-7 of boards of 1e-2, in numbers of 1: 1e-5 and 1e-7.
    assert_allclose([fit.rotation_sigma, fit.lever_arm_sigma], np.sqrt(variance), rtol=1e-4)


@pytest.mark.long
@pytest.mark.parametrize('known', [True, False])
def test_sigmas_are_honest(rng, known):
    squares, variances, found = [], [], []
    for _ in range(300):
        fit = fit_tip(survey_of(rng, sigma=SIGMA, pointer_sigma=SIGMA if known else None))
        for name in ('imu1', 'imu2'):
            extrinsics = fit.extrinsics[name]
            squares.append(np.square(errors_of(fit, name)).ravel())
            variances.append(
                np.square([extrinsics.rotation_sigma, extrinsics.lever_arm_sigma]).ravel()
            )
        found.append(fit.pointer_sigma**2)
    # 600 draws that share imu0, so at worst 300 free ones: sqrt(2 / 300) = 8.2 %.
    assert_allclose(np.mean(squares, axis=0) / np.mean(variances, axis=0), 1.0, atol=4 * 0.082)
    # Three boards of 4 corners leave 18 degrees of freedom, 300 times: sqrt(2 / 5400) = 1.9 %.
    assert_allclose(np.mean(found), SIGMA**2, rtol=4 * 0.019)


def test_three_corners_suffice():
    corners = {k: CORNERS[k] for k in ('pin1', 'pin8', 'usb')}
    theta, place = errors_of(fit_tip(survey_of(corners=corners)), 'imu2')
    assert_allclose([theta, place], 0.0, atol=1e-12)


@pytest.mark.parametrize('sigma', [None, SIGMA])
@pytest.mark.parametrize('swap', [('pin1', 'pin8'), ('usb', 'cut'), ('pin8', 'usb')])
def test_corners_that_were_swapped_are_named(rng, swap, sigma):
    survey = survey_of(rng, sigma=SIGMA, pointer_sigma=sigma)
    points = dict(survey.imus['imu1'].points)
    points[swap[0]], points[swap[1]] = points[swap[1]], points[swap[0]]
    imus = dict(survey.imus) | {'imu1': TipBoard(corners=CORNERS, points=points)}
    pattern = r'corners .*`imu1` look swapped.* [\d.]+ mm'
    with pytest.raises(CalibrationError, match=pattern) as caught:
        fit_tip(survey.model_copy(update={'imus': imus}))
    assert {name for name in CORNERS if f'`{name}`' in str(caught.value)} == set(swap)


def test_a_mirrored_drawing_in_space_is_refused():
    corners = CORNERS | {'post': (0.001, -0.002, 0.011)}
    survey = survey_of(corners=corners)
    mirrored = {k: (-x, y, z) for k, (x, y, z) in corners.items()}
    imus = {'imu0': TipBoard(corners=mirrored, points=survey.imus['imu0'].points)}
    with pytest.raises(CalibrationError, match=r'points of `imu0` miss the drawing by [\d.]+ mm'):
        fit_tip(TipSurvey(version=1, main='imu0', imus=imus))


def test_only_a_mix_up_along_the_symmetry_of_the_drawing_goes_unseen():
    points = list(survey_of(corners=RECTANGLE).imus['imu0'].points.values())
    unseen = 0
    for order in permutations(range(4)):
        mixed = dict(zip(RECTANGLE, [points[k] for k in order], strict=True))
        board = TipBoard(corners=RECTANGLE, points=mixed)
        try:
            fit = fit_tip(TipSurvey(version=1, main='imu0', imus={'imu0': board}))
        except CalibrationError:
            continue
        unseen += 1
        assert fit.symmetric == ('imu0',)
    assert unseen == 4  # the rotations of a rectangle in space: none, and half turns about x, y, z
    assert fit_tip(survey_of()).symmetric == ()


def test_a_point_that_was_measured_badly_is_named(rng):
    survey = survey_of(rng, sigma=SIGMA, pointer_sigma=SIGMA)
    bad = np.add(survey.imus['imu2'].points['usb'], [0.0, 0.003, 0.0]).tolist()
    board = TipBoard(corners=CORNERS, points=dict(survey.imus['imu2'].points) | {'usb': bad})
    with pytest.raises(CalibrationError, match=r'`imu2` miss the drawing by .*`usb` most'):
        fit_tip(survey.model_copy(update={'imus': dict(survey.imus) | {'imu2': board}}))


@pytest.mark.long
def test_a_good_board_is_refused_as_rarely_as_promised(rng):
    # 3 boards, 300 times, at 1e-4 each: the chance of two refusals is 0.4 %.
    refused = 0
    for _ in range(300):
        try:
            fit_tip(survey_of(rng, sigma=SIGMA, pointer_sigma=SIGMA))
        except CalibrationError:
            refused += 1
    assert refused < 2


def test_collinear_corners_are_refused():
    line = {k: (x, 0.5 * x, 0.0) for k, x in zip('abcd', (0.0, 0.01, 0.02, 0.03), strict=True)}
    with pytest.raises(CalibrationError, match='`corners` of `imu0` lie on a line'):
        fit_tip(survey_of(corners=line))
    board = TipBoard(corners=CORNERS, points=dict(zip(CORNERS, line.values(), strict=True)))
    with pytest.raises(CalibrationError, match='`points` of `imu0` lie on a line'):
        fit_tip(TipSurvey(version=1, main='imu0', imus={'imu0': board}))


SHEET = """
    version: 1
    main: imu0
    pointer_sigma: 0.0002
    imus:
      imu0:
        corners: {a: [0, 0, 0], b: [0.02, 0, 0], c: [0.02, 0.015, 0]}
        points: {a: [1, 0, 0], b: [1, 0.02, 0], c: [0.985, 0.02, 0]}
      imu1:
        corners: {a: [0, 0, 0], b: [0.02, 0, 0], c: [0.02, 0.015, 0]}
        points: {a: [1, 0, 0.1], c: [1.015, 0.02, 0.1], b: [1, 0.02, 0.1]}
    """


def test_the_file_is_read_and_corners_go_by_name(tmp_path):
    path = tmp_path / 'tip.yaml'
    path.write_text(dedent(SHEET))
    fit = fit_tip(load_tip(path))
    # imu0: x along the tracker's y, y along -x. imu1: y along +x, so it lies on its back.
    assert_allclose(fit.extrinsics['imu1'].R_bs, np.diag([1, -1, -1]), atol=1e-12)
    assert_allclose(fit.extrinsics['imu1'].lever_arm, [0.0, 0.0, 0.1], atol=1e-12)
    assert fit.pointer_sigma == 0.0002


@pytest.mark.parametrize(
    ('old', 'new', 'message'),
    [
        ('main: imu0', 'main: imu7', r'`main` must be one of imu0, imu1, got `imu7`'),
        ('a: [1, 0, 0],', '', r'`imus.imu0`: .* `a` is in one only'),
        ('[0.985, 0.02, 0]', '[0.985, 0.02]', r'`imus.imu0.points.c\[2\]`: Field required'),
        ('0.0002', '-1', r'`pointer_sigma`: Input should be greater than 0, got -1'),
        ('version: 1', 'versoin: 1', r'`version`: Field required'),
        ('main: imu0', 'main: imu0\n    mian: 2', r'`mian`: Extra inputs'),
        ('imus:', 'imus: [', r'is not YAML'),
    ],
)
def test_a_mistake_in_the_file_is_named_by_its_key(tmp_path, old, new, message):
    path = tmp_path / 'tip.yaml'
    path.write_text(dedent(SHEET.replace(old, new, 1)))
    with pytest.raises(ConfigError, match=message):
        load_tip(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r'Cannot read the tip calibration file .*none\.yaml'):
        load_tip(tmp_path / 'none.yaml')
