"""The shipped rig files against the drawings, and the drawings against what they promise."""

from pathlib import Path

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.errors import ConfigError
from multiimu_ros.rig import load_rig
from multiimu_ros.simulation import placements

CONFIG = Path(__file__).parents[2] / 'config'
SHIPPED = {
    'ring8': placements.ring(8),
    'row3': placements.row(3),
    'cube3': placements.cube(3),
    'foot3': placements.foot(3),
}
PATTERNS = (placements.ring, placements.row, placements.cube, placements.foot)


def lever_arms(rig):
    return np.array([imu.extrinsics.lever_arm for imu in rig.imus])


@pytest.mark.parametrize('name', SHIPPED)
def test_the_shipped_file_holds_the_poses_of_the_drawing(name):
    shipped, drawn = load_rig(CONFIG / f'{name}.yaml'), SHIPPED[name]
    assert (shipped.rig, shipped.names) == (drawn.rig, drawn.names)
    for here, there in zip(shipped.imus, drawn.imus, strict=True):
        # The files are typed with 7 decimals.
        assert_allclose(here.extrinsics.R_bs, there.extrinsics.R_bs, atol=2e-7)
        assert_allclose(here.extrinsics.lever_arm_b, there.extrinsics.lever_arm_b, atol=1e-7)


@pytest.mark.parametrize('name', SHIPPED)
def test_the_shipped_file_holds_the_noise_of_the_data_sheet(name):
    shipped, drawn = load_rig(CONFIG / f'{name}.yaml').imus[0], SHIPPED[name].imus[0]
    for figure in ('noise_density', 'bias_instability', 'bias_random_walk'):
        here, there = getattr(shipped.noise, figure), getattr(drawn.noise, figure)
        # Five digits are typed.
        assert_allclose(here.accelerometer, there.accelerometer, rtol=1e-4)
        assert_allclose(here.gyroscope, there.gyroscope, rtol=1e-4)


@given(pattern=st.sampled_from(PATTERNS), n=st.integers(1, 16))
def test_no_two_imus_share_a_place(pattern, n):
    arms = lever_arms(pattern(n))
    apart = np.linalg.norm(arms[:, np.newaxis] - arms, axis=2) + np.eye(n)
    assert len(arms) == n
    assert apart.min() > 0.01  # [m] a breakout board is wider than that


def test_lever_arms_of_the_ring_cancel_in_the_mean():
    arms = lever_arms(placements.ring(8))
    # Coordinates are rounded to 1 nm.
    assert_allclose(arms.mean(axis=0), 0, atol=1e-9)
    assert_allclose(np.linalg.norm(arms, axis=1), 0.08, atol=1e-9)


def test_sensors_on_the_cube_look_outward():
    for imu in placements.cube(6).imus:
        normal = imu.extrinsics.R_bs @ [0, 0, 1]
        assert_allclose(imu.extrinsics.lever_arm_b, 0.03 * normal, atol=1e-9)


@pytest.mark.parametrize('n', [0, 17])
def test_too_few_and_too_many_imus_are_refused(n):
    with pytest.raises(ConfigError, match=f'`n` must be from 1 to 16 IMUs, got {n}'):
        placements.row(n)
