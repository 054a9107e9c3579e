"""The codec against rclpy's own serialisation, field by field."""

from geometry_msgs.msg import Twist, TwistWithCovarianceStamped
from hypothesis import given, strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import Imu

from multiimu_ros.fused_frame import FusedFrame, SIZE
from multiimu_ros.nodes import convert

FRAMES = st.text(st.characters(codec='utf-8', exclude_characters='\x00'), max_size=40)
STAMPS = st.integers(0, 2**31 * 10**9 - 1)
SIX = st.lists(st.floats(allow_nan=False), min_size=6, max_size=6)


def imu_message(frame_id, stamp_ns, six):
    msg = Imu()
    msg.header.frame_id = frame_id
    msg.header.stamp.sec, msg.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    w, f = msg.angular_velocity, msg.linear_acceleration
    w.x, w.y, w.z, f.x, f.y, f.z = six
    return msg


@given(frame_id=FRAMES, stamp_ns=STAMPS, six=SIX)
def test_decoding_agrees_with_rclpy(frame_id, stamp_ns, six):
    data = serialize_message(imu_message(frame_id, stamp_ns, six))
    assert convert._head(data) is not None  # by offsets, not by falling back to rclpy
    assert convert.decode_imu(data) == (stamp_ns, frame_id, tuple(six))


@given(frame_id=FRAMES, seed=st.integers(0, 99))
def test_all_numbers_come_back_as_they_went(frame_id, seed):
    numbers = np.random.default_rng(seed).standard_normal(37)
    data = convert.StampedEncoder(frame_id).encode(7, numbers)
    fast, slow = convert.decode_imu_numbers(data), convert._decode_slowly(data)
    assert fast[:2] == slow[:2] == (7, frame_id)
    assert fast[2].tolist() == slow[2].tolist() == numbers.tolist()


@given(frame_id=FRAMES, stamp_ns=STAMPS, seed=st.integers(0, 99))
def test_encoded_imu_is_read_by_rclpy(frame_id, stamp_ns, seed):
    numbers = np.random.default_rng(seed).standard_normal(37)
    data = convert.StampedEncoder(frame_id).encode(stamp_ns, numbers)
    msg = deserialize_message(data, Imu)
    q, w, f = msg.orientation, msg.angular_velocity, msg.linear_acceleration
    assert (msg.header.frame_id, msg.header.stamp.sec) == (frame_id, stamp_ns // 10**9)
    assert msg.header.stamp.nanosec == stamp_ns % 10**9
    read = [q.x, q.y, q.z, q.w, *msg.orientation_covariance, w.x, w.y, w.z]
    read += [*msg.angular_velocity_covariance, f.x, f.y, f.z, *msg.linear_acceleration_covariance]
    assert read == numbers.tolist()


@given(frame_id=FRAMES, child=FRAMES, seed=st.integers(0, 99))
def test_encoded_odometry_is_read_by_rclpy(frame_id, child, seed):
    numbers = np.random.default_rng(seed).standard_normal(85)
    msg = deserialize_message(convert.StampedEncoder(frame_id, child).encode(7, numbers), Odometry)
    assert (msg.header.frame_id, msg.child_frame_id) == (frame_id, child)
    p, q = msg.pose.pose.position, msg.pose.pose.orientation
    v, w = msg.twist.twist.linear, msg.twist.twist.angular
    read = [p.x, p.y, p.z, q.x, q.y, q.z, q.w, *msg.pose.covariance]
    read += [v.x, v.y, v.z, w.x, w.y, w.z, *msg.twist.covariance]
    assert read == numbers.tolist()


def test_big_endian_bytes_are_read_too():
    little = serialize_message(imu_message('a', 5, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
    doubles = np.frombuffer(little, '<f8', offset=20).astype('>f8').tobytes()
    big = b'\x00\x00\x00\x00' + bytes(7) + b'\x05' + b'\x00\x00\x00\x02a\x00\x00\x00' + doubles
    assert convert.decode_imu(big) == (5, 'a', (1, 2, 3, 4, 5, 6))


@given(st.binary(max_size=400))
def test_rubbish_is_none_and_never_an_exception(data):
    assert convert.decode_imu(data) is None


@pytest.mark.parametrize('cut', [1, 4, 200, 312])
def test_a_cut_message_is_none(cut):
    data = serialize_message(imu_message('imu0_link', 5, [0.0] * 6))
    assert convert.decode_imu(data[:-cut]) is None


def test_a_fused_frame_lies_in_the_messages_where_ros_expects_it(rng):
    frame = FusedFrame(1, True, False, np.ones(1), rng.standard_normal(SIZE))
    imu = deserialize_message(
        convert.StampedEncoder('a').encode(1, convert.fused_imu_numbers(frame)), Imu
    )
    q, w, f = imu.orientation, imu.angular_velocity, imu.linear_acceleration
    assert [q.x, q.y, q.z, q.w] == frame.orientation.tolist()
    assert [w.x, w.y, w.z, f.x, f.y, f.z] == [*frame.angular_rate, *frame.specific_force]
    assert list(imu.orientation_covariance) == [*frame.orientation_covariance.flat]
    assert list(imu.angular_velocity_covariance) == [*frame.angular_rate_covariance.flat]
    assert list(imu.linear_acceleration_covariance) == [*frame.specific_force_covariance.flat]


def test_a_fused_frame_lies_in_the_odometry_where_ros_expects_it(rng):
    frame = FusedFrame(1, True, False, np.ones(1), rng.standard_normal(SIZE))
    odom = deserialize_message(
        convert.StampedEncoder('a', 'b').encode(1, convert.odometry_numbers(frame)), Odometry
    )
    p, q = odom.pose.pose.position, odom.pose.pose.orientation
    v, w = odom.twist.twist.linear, odom.twist.twist.angular
    assert [p.x, p.y, p.z] == frame.position_n.tolist()
    assert [q.x, q.y, q.z, q.w] == frame.odom_orientation.tolist()
    assert list(odom.pose.covariance) == [*frame.pose_covariance.flat]
    assert [v.x, v.y, v.z, w.x, w.y, w.z] == [*frame.velocity_b, *frame.angular_rate]
    assert list(odom.twist.covariance) == [*frame.twist_covariance.flat]


def test_a_still_frame_is_a_twist_of_zero_with_its_covariance(rng):
    frame = FusedFrame(1, True, False, np.ones(1), rng.standard_normal(SIZE))
    data = convert.StampedEncoder('base_link').encode(1, convert.still_twist_numbers(frame))
    twist = deserialize_message(data, TwistWithCovarianceStamped).twist
    assert twist.twist == Twist()
    assert list(twist.covariance) == [*frame.twist_covariance.flat]
