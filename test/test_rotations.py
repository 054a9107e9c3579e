"""Small rotations against scipy, against exact series, and at the edges."""

from fractions import Fraction
from math import factorial

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros import rotations

BELOW = np.nextafter(rotations.SERIES_BELOW, 0.0)  # the last angle on the series' side


def turns(largest):
    """Return a strategy of rotation vectors (3,) of an angle up to `largest` [rad]."""
    direction = st.integers(0, 2**32 - 1).map(
        lambda seed: np.random.default_rng(seed).standard_normal(3)
    )
    angle = st.one_of(st.floats(0.0, largest), st.floats(-14.0, 0.0).map(lambda e: 10.0**e))
    return st.builds(lambda d, a: a * d / np.linalg.norm(d), direction, angle)


def exact_coefficients(angle):
    """Return sum (-1)^k x^2k / (2k + n)! for n = 1, 2, 3, in fractions: no cancellation."""
    square = -(Fraction(angle) ** 2)
    return [
        float(sum(square**k / factorial(2 * k + n) for k in range(25)))  # 3.2^50 / 50! = 6e-40
        for n in (1, 2, 3)
    ]


@pytest.mark.parametrize('angle', [0.0, 1e-9, 1e-3, 0.1, BELOW, rotations.SERIES_BELOW, 1.0, 3.1])
def test_coefficients_keep_fourteen_digits_on_both_sides_of_the_switch_over(angle):
    # 150 eps: at 0.2 rad, angle - sin(angle) is 150 times smaller than angle.
    assert_allclose(
        rotations._coefficients(angle), exact_coefficients(angle), rtol=150 * np.finfo(float).eps
    )


def test_skew_is_the_cross_product(rng):
    v, u = rng.standard_normal((2, 3))
    assert_allclose(rotations.skew(v) @ u, np.cross(v, u), rtol=1e-12)


@given(theta=turns(50.0))
def test_exponential_is_that_of_scipy(theta):
    expected = Rotation.from_rotvec(theta).as_matrix()
    assert_allclose(rotations.exp_so3(theta), expected, atol=1e-13)  # 50 rad has an ulp of 7e-15


@given(theta=turns(3.14))
def test_logarithm_undoes_the_exponential(theta):
    # Up to 1.6 mrad from pi, where the sine that divides is 1/600: 600 eps is 1.3e-13.
    assert_allclose(rotations.log_so3(rotations.exp_so3(theta)), theta, rtol=1e-11, atol=1e-15)


def test_logarithm_of_the_identity_is_zero():
    assert_allclose(rotations.log_so3(np.eye(3)), np.zeros(3), atol=0.0)


@pytest.mark.parametrize('angle', [0.9e-6, 1.1e-6, 9e-3])
def test_logarithm_agrees_on_both_sides_of_its_switch_over(angle):
    theta = np.array([0.0, angle, 0.0])
    assert_allclose(rotations.log_so3(rotations.exp_so3(theta)), theta, rtol=1e-12)


@given(theta=turns(3.0), seed=st.integers(0, 2**32 - 1))
def test_right_jacobian_is_the_derivative_of_the_exponential(theta, seed):
    d = 1e-6 * np.random.default_rng(seed).standard_normal(3)
    there, back = (rotations.exp_so3(theta + sign * d) for sign in (1.0, -1.0))
    measured = rotations.log_so3(back.T @ there) / 2.0
    # A central difference is right to |d|^2 = 1e-12 of d, and to rounding, 1e-16 / 1e-6 of it.
    assert_allclose(measured, rotations.right_jacobian(theta) @ d, atol=1e-15)


@given(theta=turns(3.0), seed=st.integers(0, 2**32 - 1))
def test_renormalise_squares_the_error(theta, seed):
    off = 1e-5 * np.random.default_rng(seed).standard_normal((3, 3))
    R = rotations.renormalise(rotations.exp_so3(theta) + off)
    # A defect of e leaves 3/4 e^2; e is at most 2 * 5 sigma * 3 * 1e-5 = 3e-4 in the worst draw.
    assert_allclose(R.T @ R, np.eye(3), atol=1e-7)


def test_renormalise_leaves_a_rotation_alone():
    R = rotations.exp_so3(np.array([0.4, -1.2, 2.0]))
    assert_allclose(rotations.renormalise(R), R, atol=1e-15)


@given(theta=turns(50.0))
def test_quaternion_turns_as_the_matrix_does(theta):
    q = rotations.as_quaternion(rotations.exp_so3(theta))
    assert q[3] >= 0.0
    assert_allclose(np.linalg.norm(q), 1.0, rtol=1e-15)
    assert_allclose(Rotation.from_quat(q).as_matrix(), rotations.exp_so3(theta), atol=1e-13)


@pytest.mark.parametrize('axis', [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0.8, 0.0)])
@pytest.mark.parametrize('angle', [0.0, 1e-9, np.pi - 1e-9, np.pi])
def test_quaternion_keeps_its_digits_where_an_element_vanishes(axis, angle):
    q = rotations.as_quaternion(Rotation.from_rotvec(angle * np.array(axis)).as_matrix())
    expected = [*(np.sin(0.5 * angle) * np.array(axis)), np.cos(0.5 * angle)]
    # At half a turn an axis and its opposite are the same rotation.
    assert_allclose(q * np.sign(q @ expected), expected, atol=1e-15)


def test_product_is_the_matrix_product_in_any_layout(rng):
    A, B = rng.standard_normal((4, 3)).T, rng.standard_normal((5, 4)).T
    assert_allclose(rotations.product(A, B), A @ B, rtol=1e-12, atol=1e-14)
