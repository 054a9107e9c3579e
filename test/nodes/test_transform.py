"""The transform against a buffer of tf2_ros where there is one, and what is said where not."""

from copy import deepcopy
from itertools import pairwise
import os
import sys
from types import SimpleNamespace

from geometry_msgs.msg import TransformStamped
from live_chain import started
from nav_msgs.msg import Odometry
import numpy as np
from numpy.testing import assert_allclose
import pytest
from rclpy.duration import Duration
from rclpy.time import Time
from ros_helpers import node_process, ros_peer
from scipy.spatial.transform import Rotation, Slerp
from walk_bags import IMUS, write_walk

from multiimu_ros.errors import ConfigError
from multiimu_ros.fused_frame import FusedFrame, SIZE
from multiimu_ros.nodes import convert
from multiimu_ros.nodes.transform import TransformOutput

pytestmark = pytest.mark.ros

SECONDS, RATE_HZ = 12.0, 100.0  # it rests first
LEVER = [0.03, -0.02, 0.01]
VIRTUAL = {'virtual_imu': str(LEVER), 'virtual_imu_frame': 'toe'}


def pose(message):
    """Return position and [x, y, z, w] of a pose or a transform."""
    if isinstance(message, Odometry):
        p, q = message.pose.pose.position, message.pose.pose.orientation
    else:
        p, q = message.transform.translation, message.transform.rotation
    return np.array([p.x, p.y, p.z]), Rotation.from_quat([q.x, q.y, q.z, q.w])


def assert_same(transform, position, rotation, atol=1e-9):
    p, q = pose(transform)
    assert_allclose(p, position, rtol=0, atol=atol)
    assert (q.inv() * rotation).magnitude() < atol  # q and -q are one rotation


@pytest.fixture
def broadcast(monkeypatch):
    """Return the list of what a stand-in for tf2_ros was given."""
    sent = []

    class TransformBroadcaster:
        def __init__(self, node):
            assert node == 'node'

        def sendTransform(self, message):
            sent.append(deepcopy(message))

    module = SimpleNamespace(TransformBroadcaster=TransformBroadcaster)
    monkeypatch.setitem(sys.modules, 'tf2_ros', module)
    return sent


def test_what_is_broadcast_is_the_pose_that_odom_says(broadcast, rng):
    output = TransformOutput('node', 'odom', 'base_link', np.zeros(3))
    frames = [
        FusedFrame(10**18 + k, False, False, np.ones(1), rng.standard_normal(SIZE))
        for k in (0, 999_999_999)
    ]
    for frame in frames:
        output.send(frame)
    for frame, message in zip(frames, broadcast, strict=True):
        assert (message.header.frame_id, message.child_frame_id) == ('odom', 'base_link')
        assert Time.from_msg(message.header.stamp).nanoseconds == frame.stamp_ns
        t, q = message.transform.translation, message.transform.rotation
        numbers = [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
        assert numbers == convert.odometry_numbers(frame)[:7].tolist()


def test_the_base_frame_is_broadcast_though_the_odometry_follows_another_point(broadcast, rng):
    record = rng.standard_normal(SIZE)
    turned = Rotation.random(rng=rng)
    frame = FusedFrame(10**18, False, False, np.ones(1), record)
    frame.odom_orientation[:] = turned.as_quat()
    TransformOutput('node', 'odom', 'base_link', np.array(LEVER)).send(frame)
    assert_same(broadcast[0], frame.position_n - turned.apply(LEVER), turned, atol=1e-12)


def test_without_tf2_ros_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, 'tf2_ros', None)  # the import fails, installed or not
    said = r'^`publish_tf` needs tf2_ros \(.*tf2_ros.*\); install ros-jazzy-tf2-ros-py\.$'
    with pytest.raises(ConfigError, match=said):
        TransformOutput('node', 'odom', 'base_link', np.zeros(3))


@pytest.fixture(params=[{}, VIRTUAL], ids=['base', 'virtual'])
def walk(request, tmp_path):
    """Play a walk; return odometry, the point it follows, and a tf2_ros.Buffer that listened."""
    tf2_ros = pytest.importorskip('tf2_ros', reason='tf2_ros comes with ROS 2, not from PyPI')
    scans = write_walk(tmp_path, SECONDS, RATE_HZ)
    told = {'rig_file': tmp_path / 'rig.yaml', 'profile': 'foot', 'publish_tf': 'true'}
    buffer = tf2_ros.Buffer(cache_time=Duration(seconds=60))
    domain = os.environ['ROS_DOMAIN_ID']
    with node_process('pipeline', **told, **request.param) as process, ros_peer() as peer:
        heard = peer.collect(Odometry, 'odom')
        listener = tf2_ros.TransformListener(buffer, peer.node)
        count = peer.node.count_subscribers
        peer.wait_until(lambda: all(count(f'imu{k}/data_raw') for k in range(IMUS)), 30)
        peer.wait_until(lambda: peer.node.count_publishers('/tf') == 1)
        peer.spin(0.7)  # the far side learns of the match a little later
        with started(
            'play', tmp_path / 'bag', '--wait', '20', '--rate', '2', domain=domain
        ) as play:
            peer.wait_until(lambda: play.poll() is not None, 60)
            assert play.returncode == 0
        peer.spin(0.5)
        listener.unregister()
        assert process.end()[0] == 0
    assert len(heard) > scans - 5
    return heard, np.array(LEVER if request.param else [0.0] * 3), buffer


def between(before, after):
    """Return the instant [ns] halfway between two poses, and the pose on the way."""
    ends = [Time.from_msg(message.header.stamp).nanoseconds for message in (before, after)]
    middle_ns = sum(ends) // 2
    share = (middle_ns - ends[0]) / (ends[1] - ends[0])
    (p0, q0), (p1, q1) = pose(before), pose(after)
    turn = Slerp([0, 1], Rotation.concatenate([q0, q1]))(share)
    return middle_ns, p0 + share * (p1 - p0), turn


@pytest.mark.slow
def test_tf2_looks_up_the_base_frame_of_what_odom_says(walk):
    heard, lever, buffer = walk
    followed = 'toe' if lever.any() else 'base_link'
    if lever.any():  # as the description of a robot would have it
        static = TransformStamped(child_frame_id=followed)
        static.header.frame_id, t = 'base_link', static.transform.translation
        t.x, t.y, t.z = lever.tolist()
        buffer.set_transform_static(static, 'test')
    assert max(np.linalg.norm(pose(message)[0]) for message in heard) > 0.5  # it walked
    for message in heard:
        stamp, (position, rotation) = Time.from_msg(message.header.stamp), pose(message)
        found = buffer.lookup_transform('odom', 'base_link', stamp)
        assert found.header == message.header
        assert message.child_frame_id == followed
        assert_same(found, position - rotation.apply(lever), rotation)
        assert_same(buffer.lookup_transform('odom', followed, stamp), position, rotation)
    if lever.any():
        return
    for pair in pairwise(heard):
        middle_ns, position, rotation = between(*pair)
        found = buffer.lookup_transform('odom', 'base_link', Time(nanoseconds=middle_ns))
        assert_same(found, position, rotation)
