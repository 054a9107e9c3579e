"""Serialised Imu and Odometry messages, against rclpy's own serialisation and rosbags'."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_array_equal
import pytest
from rosbags.typesys import get_typestore, Stores

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.bags import cdr
from multiimu_ros.samples import ImuSamples

STORE = get_typestore(Stores.ROS2_JAZZY)  # a serialiser that is not ours
IMU, ODOMETRY = 'sensor_msgs/msg/Imu', 'nav_msgs/msg/Odometry'


def some_samples(rng, n=3):
    stamp_ns = rng.integers(0, 2**31 * NANOSECONDS, n)  # all that the 32-bit seconds hold
    return ImuSamples(stamp_ns, rng.standard_normal((n, 3)), rng.standard_normal((n, 3)))


@given(frame_id=st.text(st.characters(exclude_characters='\0', codec='utf-8'), max_size=20))
def test_imu_survives_the_round_trip_with_any_frame_name(frame_id):
    samples = some_samples(np.random.default_rng(1))
    decoded, frames = cdr.decode_imus(cdr.encode_imus(frame_id, samples))
    assert frames == {frame_id}
    for name in ('stamp_ns', 'angular_rate', 'specific_force'):
        assert_array_equal(getattr(decoded, name), getattr(samples, name))


@pytest.mark.parametrize('frame_id', ['', 'a', 'imu0_link', 'imu10_link', 'base_link_0'])
def test_imu_reads_the_same_field_by_field_elsewhere(rng, frame_id):
    samples, P = some_samples(rng), rng.standard_normal((3, 3, 3, 3))
    quaternions = rng.standard_normal((3, 4))
    encoded = cdr.encode_imus(
        frame_id,
        samples,
        rate_covariance=P[0],
        force_covariance=P[1],
        orientation=quaternions,
        orientation_covariance=P[2],
    )
    for k, data in enumerate(encoded):
        msg = STORE.deserialize_cdr(data, IMU)
        stamp = msg.header.stamp
        assert stamp.sec * NANOSECONDS + stamp.nanosec == samples.stamp_ns[k]
        assert msg.header.frame_id == frame_id
        w, f, q = msg.angular_velocity, msg.linear_acceleration, msg.orientation
        assert_array_equal([w.x, w.y, w.z], samples.angular_rate[k])
        assert_array_equal([f.x, f.y, f.z], samples.specific_force[k])
        assert_array_equal([q.x, q.y, q.z, q.w], quaternions[k])
        assert_array_equal(msg.angular_velocity_covariance, P[0, k].ravel())
        assert_array_equal(msg.linear_acceleration_covariance, P[1, k].ravel())
        assert_array_equal(msg.orientation_covariance, P[2, k].ravel())


def test_imu_without_orientation_says_so(rng):
    msg = STORE.deserialize_cdr(cdr.encode_imus('imu', some_samples(rng))[0], IMU)
    assert msg.orientation_covariance[0] == -1.0  # REP-145


@pytest.mark.parametrize('frames', [('odom', 'base_link'), ('o', ''), ('world', 'b')])
def test_odometry_reads_the_same_field_by_field_elsewhere(rng, frames):
    stamp_ns = np.array([1_700_000_000_000_000_001, 7])
    vectors, quaternions = rng.standard_normal((3, 2, 3)), rng.standard_normal((2, 4))
    P = rng.standard_normal((2, 2, 6, 6))
    encoded = cdr.encode_odometry(
        frames, stamp_ns, (vectors[0], quaternions, P[0]), (vectors[1], vectors[2], P[1])
    )
    for k, data in enumerate(encoded):
        msg = STORE.deserialize_cdr(data, ODOMETRY)
        assert (msg.header.frame_id, msg.child_frame_id) == frames
        p, q = msg.pose.pose.position, msg.pose.pose.orientation
        v, w = msg.twist.twist.linear, msg.twist.twist.angular
        assert_array_equal([[p.x, p.y, p.z], [v.x, v.y, v.z], [w.x, w.y, w.z]], vectors[:, k])
        assert_array_equal([q.x, q.y, q.z, q.w], quaternions[k])
        assert_array_equal(msg.pose.covariance, P[0, k].ravel())
        assert_array_equal(msg.twist.covariance, P[1, k].ravel())


def test_big_endian_and_padded_messages_are_read(rng):
    samples = some_samples(rng)
    little = cdr.encode_imus('imu0_link', samples)
    messages = [STORE.deserialize_cdr(data, IMU) for data in little]
    big = [bytes(STORE.serialize_cdr(msg, IMU, little_endian=False)) for msg in messages]
    assert big[0][:2] == b'\x00\x00'
    padded = [data + bytes(3) for data in little]
    decoded, _ = cdr.decode_imus([*big, *padded, *little])
    assert_array_equal(decoded.specific_force, np.tile(samples.specific_force, (3, 1)))
    assert_array_equal(decoded.stamp_ns, np.tile(samples.stamp_ns, 3))


@pytest.mark.parametrize(
    ('data', 'complaint'),
    [
        (b'', 'message 1 must be plain CDR'),
        (b'\x00\x03' + bytes(300), 'got the encapsulation `00 03`'),
        (b'\x00\x01' + bytes(10) + b'\xff' * 300, 'a frame name within its 312 bytes'),
        (b'\x00\x01' + bytes(300), 'must have the 316 bytes of a sensor_msgs/Imu, got 302'),
    ],
)
def test_what_is_no_imu_message_is_named(rng, data, complaint):
    whole = cdr.encode_imus('', some_samples(rng, 1))
    with pytest.raises(ValueError, match=complaint):
        cdr.decode_imus([*whole, data])
