"""Real recordings of an 8-IMU board through `multiimu fuse` and through the live nodes.

data/README.md of the recordings says how the noise is measured: a plain mean of eight is 2.16 to
2.31 times quieter than the median IMU, optimal weights reach 2.5 to 2.8.
"""

import functools
import os

import kth
from live_chain import fuse, numbers, replay
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from multiimu_ros.registration.transform import register
from multiimu_ros.rig import save_rig

pytestmark = pytest.mark.realdata
RATE, FORCE, POSITION = slice(13, 16), slice(25, 28), slice(0, 3)  # in the doubles of a message
REST_S = 10  # the board rests that long before it is turned for the first time


@pytest.fixture(scope='module', params=['exp_3', 'exp_4'])
def fused(request, tmp_path_factory):
    """Fuse a whole recording; return the raw samples, the rig and the fused bag."""
    folder = tmp_path_factory.mktemp(request.param)
    samples = kth.load(request.param)
    rig = kth.rig(samples)
    save_rig(rig, folder / 'rig.yaml')
    kth.write_bag(request.param, folder / 'bag')
    fuse(folder / 'bag', folder / 'rig.yaml', folder / 'fused')
    return samples, rig, folder / 'fused'


def test_every_scan_is_fused_at_the_stamp_of_its_measurement(fused):
    samples, _, bag = fused
    for topic in ('/imu/data', '/odom'):
        stamps, doubles = numbers(bag, topic)
        assert_array_equal(stamps, samples[0].stamp_ns)
        assert np.isfinite(doubles).all()


def test_eight_imus_at_rest_are_quieter_than_the_median_one(fused):
    samples, rig, bag = fused
    mounted = [register(track, imu) for track, imu in zip(samples, rig.imus, strict=True)]
    starts, length = kth.still_blocks(mounted[0])
    assert len(starts) > 150  # of 300: the first half of the recording is still poses
    gain = functools.partial(kth.noise_gain, starts=starts, length=length)
    _, doubles = numbers(bag, '/imu/data')
    assert gain([track.angular_rate for track in mounted], doubles[:, RATE]) > 2.1
    assert gain([track.specific_force for track in mounted], doubles[:, FORCE]) > 2.1


def test_odometry_stays_within_a_centimetre_while_the_board_rests(fused):
    stamps, doubles = numbers(fused[2], '/odom')
    rest = stamps - stamps[0] < REST_S * 10**9
    path = doubles[rest, POSITION]
    assert np.linalg.norm(path - path[0], axis=1).max() < 0.01


@pytest.mark.ros
@pytest.mark.slow
def test_the_live_nodes_say_what_fuse_says(tmp_path):
    seconds = 25  # rest, and the first turn by hand
    scans = kth.write_bag('exp_3', tmp_path / 'bag', seconds=seconds)
    save_rig(kth.rig(kth.load('exp_3')), tmp_path / 'rig.yaml')
    fuse(tmp_path / 'bag', tmp_path / 'rig.yaml', tmp_path / 'fused')
    domain = int(os.environ['ROS_DOMAIN_ID'])
    replay(
        tmp_path / 'bag', tmp_path / 'rig.yaml', tmp_path / 'live', domain=domain, seconds=seconds
    )
    for topic in ('/imu/data', '/odom'):
        stamps, live = numbers(tmp_path / 'live', topic)
        expected, offline = numbers(tmp_path / 'fused', topic)
        assert len(stamps) == scans
        assert_array_equal(stamps, expected)
        # The same numbers in the same order: only compilers could make a difference.
        assert_allclose(live, offline, rtol=0, atol=1e-9)
