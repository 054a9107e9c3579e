"""Poses from a drawing: four ways to say one rotation, and slips that are named by their key."""

from itertools import permutations, product

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation
import yaml

from multiimu_ros.errors import ConfigError
from multiimu_ros.registration.cad import DIRECTIONS, load_cad

WORDS = {v: k for k, v in DIRECTIONS.items()}


@pytest.fixture
def load(tmp_path):
    def write_and_load(orientation, **keys):
        imu = {'position': [0.04, -0.01, 0.005]} | orientation
        content = {'version': 1, 'imus': {'imu0': imu}} | keys
        (tmp_path / 'cad.yaml').write_text(yaml.safe_dump(content))
        return load_cad(tmp_path / 'cad.yaml')['imu0']

    return write_and_load


@pytest.mark.parametrize(
    'orientation',
    [
        {'rotation': [0.0, 0.0, 2**-0.5, 2**-0.5]},
        {'matrix': [[0, -1, 0], [1, 0, 0], [0, 0, 1]]},
        {'euler_deg': {'order': 'ZYX', 'angles': [90, 0, 0]}},
        {'euler_deg': {'order': 'xyz', 'angles': [0, 0, 90]}},
        {'axes': {'x': 'left', 'y': 'backward'}},
        {'axes': {'x': 'left', 'z': 'up'}},
        {'axes': {'y': 'backward', 'z': 'up'}},
        {'axes': {'x': 'left', 'y': 'backward', 'z': 'up'}},
    ],
)
def test_a_quarter_turn_to_the_left_can_be_said_in_every_way(load, orientation):
    extrinsics = load(orientation)
    # The sensor's x axis points left, +y of the base frame (REP-103).
    assert_allclose(extrinsics.R_bs @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    assert_allclose(extrinsics.R_bs, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)
    assert extrinsics.lever_arm == (0.04, -0.01, 0.005)
    assert extrinsics.rotation_sigma is None
    assert extrinsics.lever_arm_sigma is None


def test_at_rest_an_upside_down_sensor_reads_minus_g_on_its_z_axis(load):
    R_bs = load({'axes': {'x': 'forward', 'z': 'down'}}).R_bs
    # At rest specific_force_n = [0, 0, +9.81], for gravity_n = [0, 0, -9.81].
    assert_allclose(R_bs.T @ [0, 0, 9.81], [0, 0, -9.81], atol=1e-12)
    assert_allclose(R_bs @ [0, 1, 0], [0, -1, 0], atol=1e-15)  # y: right


def test_each_order_of_angles_is_the_product_of_its_turns(load):
    a, b, c = np.deg2rad([10.0, -20.0, 30.0])
    Z, Y = Rotation.from_rotvec([0, 0, a]), Rotation.from_rotvec([0, b, 0])
    X = Rotation.from_rotvec([c, 0, 0])
    yaw_pitch_roll = load({'euler_deg': {'order': 'ZYX', 'angles': [10, -20, 30]}})
    assert_allclose(yaw_pitch_roll.R_bs, (Z * Y * X).as_matrix(), atol=1e-15)
    about_fixed = load({'euler_deg': {'order': 'zyx', 'angles': [10, -20, 30]}})
    assert_allclose(about_fixed.R_bs, (X * Y * Z).as_matrix(), atol=1e-15)


def test_of_all_three_word_frames_the_24_rotations_are_taken_and_no_other(load):
    taken = 0
    for words in product(DIRECTIONS, repeat=3):
        R = np.array([DIRECTIONS[w] for w in words]).T
        axes = {'axes': dict(zip('xyz', words, strict=True))}
        if round(np.linalg.det(R)) == 1:
            assert_allclose(load(axes).R_bs, R, atol=1e-15)
            taken += 1
        else:
            with pytest.raises(
                ConfigError, match=r'`imus\.imu0\.axes`: must (be right-h|have col)'
            ):
                load(axes)
    assert taken == 24  # of a cube


@pytest.mark.parametrize('pair', list(permutations('xyz', 2)))
def test_two_axes_are_completed_to_a_right_handed_frame(load, pair):
    R = load({'axes': {pair[0]: 'up', pair[1]: 'right'}}).R_bs
    assert_allclose(R[:, 'xyz'.index(pair[0])], [0, 0, 1], atol=1e-15)
    assert_allclose(R[:, 'xyz'.index(pair[1])], [0, -1, 0], atol=1e-15)
    assert_allclose(np.linalg.det(R), 1.0, rtol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_a_matrix_that_was_typed_with_four_digits_is_the_nearest_rotation(tmp_path_factory, seed):
    R = Rotation.random(random_state=seed)
    typed = R.as_matrix().round(4).tolist()
    path = tmp_path_factory.mktemp('cad') / 'cad.yaml'
    imu = {'position': [0, 0, 0], 'matrix': typed}
    path.write_text(yaml.safe_dump({'version': 1, 'imus': {'a': imu}}))
    found = Rotation.from_matrix(load_cad(path)['a'].R_bs)
    assert (found * R.inv()).magnitude() < 2e-4  # 5e-5 in each of nine numbers


def test_the_accuracy_of_the_drawing_becomes_sigmas(load):
    fit = load({'axes': {'x': 'up', 'y': 'left'}}, position_sigma=5e-4, angle_sigma_deg=1.0)
    assert fit.lever_arm_sigma == (5e-4,) * 3
    assert_allclose(fit.rotation_sigma, np.pi / 180, rtol=1e-12)


@pytest.mark.parametrize(
    ('orientation', 'message'),
    [
        ({}, r'`imus\.imu0`: must have one of rotation, matrix, euler_deg, axes, got none'),
        (
            {'rotation': [0, 0, 0, 1], 'axes': {'x': 'up', 'y': 'left'}},
            r'`imus\.imu0`: must have one of .*, got rotation and axes',
        ),
        (
            {'matrix': [[1, 0, 0], [0, 1, 0], [0, 0, -1]]},
            r'`imus\.imu0\.matrix`: must be right-handed',
        ),
        (
            {'matrix': [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]},
            r'`imus\.imu0\.matrix`: .* axes x and y are not orthogonal',
        ),
        (
            {'matrix': [[1, 0, 0], [0, 1, 0], [0, 0, 2]]},
            r'`imus\.imu0\.matrix`: .* axis z has length 2',
        ),
        ({'axes': {'x': 'left', 'y': 'right'}}, r'`imus\.imu0\.axes`: .* x and y are on one line'),
        ({'axes': {'x': 'left'}}, r'`imus\.imu0\.axes`: must name two or three axes, got 1'),
        ({'axes': {'x': 'north', 'y': 'left'}}, r'`imus\.imu0\.axes\.x`: .*forward.*north'),
        ({'rotation': [0, 0, 0, 2]}, r'`imus\.imu0\.rotation`: must be a unit quaternion'),
        (
            {'euler_deg': {'order': 'ZZX', 'angles': [0, 0, 0]}},
            r'`imus\.imu0\.euler_deg\.order`: must not turn about one axis twice',
        ),
        (
            {'euler_deg': {'order': 'ZYx', 'angles': [0, 0, 0]}},
            r'`imus\.imu0\.euler_deg\.order`: String should match',
        ),
        (
            {'euler_deg': {'order': 'ZYX', 'angles': [0, 0]}},
            r'`imus\.imu0\.euler_deg\.angles\[2\]`: Field required',
        ),
        ({'rotatoin': [0, 0, 0, 1]}, r'`imus\.imu0\.rotatoin`: Extra inputs'),
    ],
)
def test_a_slip_of_the_drawing_is_named_by_its_key(load, orientation, message):
    with pytest.raises(ConfigError, match=message):
        load(orientation)


def test_a_negative_accuracy_is_refused(load):
    with pytest.raises(ConfigError, match=r'`position_sigma`: Input should be greater than 0'):
        load({'rotation': [0, 0, 0, 1]}, position_sigma=-1.0)
