"""Faults put into one topic are found, named and given a remedy; a healthy topic is left alone."""

from heard_imus import heard_imu, N, RATE_HZ, readings
from hypothesis import given, strategies as st
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.cli.symptoms import examine, name_axis

STEP_NS = 10**9 // RATE_HZ
STAMPS = 10**18 + STEP_NS * np.arange(N)
DEG = 180 / np.pi


def said(imu, **context):
    return ' '.join(f'{level}: {text}' for level, _, text in examine(imu, **context)[1])


def turning(*rate):
    return readings() + np.array([*rate, 0.0, 0.0, 0.0])


def spoiled(rows, columns, value):
    values = readings()
    values[rows, columns] = value
    return values


def with_covariance(field, matrix, **fields):
    covariances = heard_imu().covariances.copy()
    covariances[:, field] = matrix
    return heard_imu(covariances=covariances, **fields)


def test_a_healthy_topic_is_left_alone():
    assert said(heard_imu()) == ''


@pytest.mark.parametrize(
    ('values', 'complaint'),
    [
        (readings() / [1, 1, 1, 9.81, 9.81, 9.81], 'error: the force is 1: that is g'),
        (readings() * 100, 'milli-g'),
        (readings() / 7.5, 'error: the force is 1.3: that is g'),
        (readings() - [0, 0, 0, 0, 0, 9.81], 'error: the force is 0.016 m/s^2: gravity was taken'),
        (readings() / [1, 1, 1, 2, 2, 2], 'warning: at rest it reads 4.9 m/s^2, not 9.81'),
        (turning(3.0, 0, 0), 'error: the rate is 3, which the force does not'),
        (turning(0, 0, 45.0), 'error: the rate is 45, which the force does not'),
        (spoiled(7, 1, np.nan), 'error: 1 messages hold a NaN'),
        (spoiled([7, 8], 5, np.inf), 'error: 2 messages hold a NaN'),
        (np.ones((N, 6)) * 9, 'error: every message says the same'),
    ],
)
def test_wrong_numbers_are_found(values, complaint):
    assert complaint in said(heard_imu(values=values))


def test_readings_that_end_the_range_are_found_in_motion_only():
    swing = np.sin(np.arange(N) / 5)[:, None] * np.ones(6) + [0, 0, 0, 0, 0, 9.81]
    assert said(heard_imu(values=swing)) == ''
    assert 'readings end the range' in said(heard_imu(values=np.clip(swing, -0.5, 9.9)))


def test_turning_about_the_vertical_is_no_fault():
    assert said(heard_imu(values=turning(0, 0, 3.0))) == ''


@pytest.mark.parametrize(
    ('stamp_ns', 'complaint'),
    [
        (np.zeros(N, int), f'error: {N} messages carry no stamp'),
        (STAMPS - 9 * STEP_NS * (np.arange(N) == 50), 'error: 1 stamps go back'),
        (STAMPS - STEP_NS * (np.arange(N) == 50), 'warning: 1 stamps repeat'),
        (STAMPS + 10**8 * (np.arange(N) > 50), 'warning: 1 gaps, the longest 0.1 s'),
        # Steps of 3 and 7 ms by turns: they scatter by 2 ms around 5 ms.
        (
            STAMPS + 2_000_000 * (np.arange(N) % 2),
            'warning: steps between stamps scatter by 0.002',
        ),
    ],
)
def test_wrong_stamps_are_found(stamp_ns, complaint):
    assert complaint in said(heard_imu(stamp_ns=stamp_ns))


def test_readings_without_stamps_are_judged_all_the_same():
    assert 'that is g' in said(heard_imu(values=readings() / 9.81, stamp_ns=np.zeros(N, int)))


def test_the_age_of_stamps_is_judged_on_the_same_clock_only():
    old, ahead = heard_imu(late_ns=3 * 10**9), heard_imu(late_ns=-(10**8))
    assert 'warning: stamps are 3 s old' in said(old)
    assert 'warning: stamps lie 0.1 s in the future' in said(ahead)
    assert said(old, simulated_time=True) + said(ahead, simulated_time=True) == ''


@pytest.mark.parametrize(
    ('fields', 'complaint'),
    [
        ({'malformed': 3}, 'error: 3 messages are no sensor_msgs/Imu'),
        ({'frame_id': ''}, 'warning: its frame_id is empty'),
        ({'frame_id': '/imu'}, 'warning: its frame_id `/imu` begins with a slash'),
        ({'frames': frozenset('ab')}, 'error: it carries 2 frames'),
        ({'publishers': ('/a', '/b')}, 'error: 2 nodes publish it'),
    ],
)
def test_wrong_headers_and_ends_are_found(fields, complaint):
    assert complaint in said(heard_imu(**fields))


def test_a_silent_topic_has_only_its_reason():
    nothing = np.empty((0, 6))
    imu = heard_imu(values=nothing, stamp_ns=np.empty(0, int), silence='look there.')
    assert said(imu) == 'error: look there.'
    assert said(heard_imu(values=nothing, stamp_ns=np.empty(0, int))) == ''  # it is just new


@pytest.mark.parametrize(
    ('field', 'matrix', 'complaint'),
    [
        (1, np.diag([1, -1, 1]), 'error: angular_velocity_covariance has a negative variance'),
        (1, np.full((3, 3), np.nan), 'error: angular_velocity_covariance holds a NaN'),
        (2, [[1, 2e-9, 0], [0, 1, 0], [0, 0, 1]], 'linear_acceleration_covariance is not symm'),
        (2, np.ones((3, 3)) - np.eye(3) / 2, 'linear_acceleration_covariance is not positive'),
        (2, np.diag([-1, 0, 0]), 'warning: linear_acceleration_covariance[0] is -1'),
    ],
)
def test_covariances_that_no_filter_should_trust_are_named(field, matrix, complaint):
    assert complaint in said(with_covariance(field, matrix))


def test_zero_covariances_are_fine_from_a_driver_and_not_from_a_filter():
    assert said(with_covariance(1, 0.0)) == ''
    for topic in ('/imu0/data_calibrated', '/imu0/data_registered', '/imu/data'):
        text = said(with_covariance(1, 0.0, topic=topic))
        assert 'warning: the covariance of angular_velocity is zero' in text


def test_an_orientation_that_is_none_must_say_so():
    zeros = with_covariance(0, 0.0, orientation=np.zeros((N, 4)))
    assert 'set orientation_covariance[0] to -1' in said(zeros)
    assert said(with_covariance(0, 0.0)) == ''  # unknown uncertainty of a true orientation
    assert 'orientation_covariance[0] is -1' in said(heard_imu('/imu/data'))


@pytest.mark.parametrize('axis', range(3))
@pytest.mark.parametrize(('sign', 'way'), [(1, 'up'), (-1, 'down')])
def test_the_axis_that_points_up_reads_plus_g(axis, sign, way):
    values = readings() - [0, 0, 0, 0, 0, 9.81]
    values[:, 3 + axis] += sign * 9.81
    up = np.array(examine(heard_imu(values=values))[0]['up'])
    assert name_axis(up) == f'{"xyz"[axis]} {way}'


def test_between_the_axes_it_is_tilted():
    assert name_axis(np.array([0.6, 0.0, 0.8])) == 'tilted'


@given(seed=st.integers(0, 2**32 - 1), unit=st.sampled_from([1.0, 1 / 9.81, 100.0]))
def test_up_turns_with_the_sensor_and_does_not_depend_on_the_unit(seed, unit):
    turn = Rotation.random(rng=np.random.default_rng(seed))
    values = readings()
    values[:, 3:] = unit * turn.apply(values[:, 3:])
    up = examine(heard_imu(values=values))[0]['up']
    # The mean of N readings is within 5 standard errors, 5 * 0.01 / 9.81 / sqrt(N), of up.
    np.testing.assert_allclose(up, turn.apply([0.0, 0.0, 1.0]), atol=5 * 0.01 / 9.81 / 20)


def test_a_moving_rig_says_nothing_of_up():
    swing = readings() + np.sin(np.arange(N) / 20)[:, None]
    figures, found = examine(heard_imu(values=swing))
    assert (figures['up'], found) == (None, [])


def test_degrees_per_second_are_told_from_a_bias():
    assert said(heard_imu(values=turning(0.05, 0, 0))) == ''  # 3 deg/s, a bad unit
    assert 'deg/s' in said(heard_imu(values=turning(0.05 * DEG, 0, 0)))
