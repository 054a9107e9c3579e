"""A walk is played into the separate nodes: whoever listens to `odom` hears what `fuse` writes."""

import os
from threading import Thread

from live_chain import fuse, numbers, replay
from nav_msgs.msg import Odometry
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest
from ros_helpers import ros_peer
from walk_bags import write_walk

pytestmark = [pytest.mark.ros, pytest.mark.slow]

SECONDS, RATE_HZ = 12.0, 100.0


def test_a_listener_hears_the_walk_that_fuse_writes(tmp_path):
    scans = write_walk(tmp_path, SECONDS, RATE_HZ)
    bag, rig = tmp_path / 'bag', tmp_path / 'rig.yaml'
    fuse(bag, rig, tmp_path / 'fused', '--profile', 'foot')
    expected, offline = numbers(tmp_path / 'fused', '/odom')
    live = Thread(
        target=replay,
        args=(bag, rig, tmp_path / 'live'),
        kwargs={
            'domain': int(os.environ['ROS_DOMAIN_ID']),
            'seconds': SECONDS,
            'last': 'imu2',
            'profile': 'foot',
        },
    )
    with ros_peer() as peer:
        heard = peer.collect(Odometry, 'odom')
        live.start()
        while live.is_alive():
            peer.spin(0.05)
        live.join()
    assert len(heard) == len(expected) > scans - 5
    stamps = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in heard]
    assert_array_equal(stamps, expected)
    positions = [m.pose.pose.position for m in heard]
    # The same numbers in the same order: only compilers could make a difference.
    path = np.array([[p.x, p.y, p.z] for p in positions])
    assert_allclose(path, offline[:, :3], rtol=0, atol=1e-9)
    assert np.linalg.norm(path, axis=1).max() > 1.0  # it walked
    recorded, doubles = numbers(tmp_path / 'live', '/odom')
    assert_array_equal(recorded, expected)
    assert_allclose(doubles, offline, rtol=0, atol=1e-9)
