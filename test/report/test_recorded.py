"""What the nodes published, read back from a bag."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.bags import BagWriter
from multiimu_ros.bags.cdr import encode_imus, encode_odometry
from multiimu_ros.errors import ConfigError
from multiimu_ros.report.recorded import read_run
from multiimu_ros.samples import ImuSamples

N = 20
STAMPS = 1_700_000_000_000_000_000 + 5_000_000 * np.arange(N)
DELAY = 3_000_000  # ns


def header(stamp):
    seconds, rest = divmod(int(stamp), 10**9)
    return b'\x00\x01\x00\x00' + np.array([seconds, rest], '<u4').tobytes()


def write(path, *, odom=True):
    """Write two IMUs, what became of them, and a rest of five frames."""
    rng = np.random.default_rng(1)
    readings = ImuSamples(STAMPS, rng.normal(size=(N, 3)), rng.normal(size=(N, 3)))
    turns = Rotation.from_rotvec(rng.normal(size=(N, 3)))
    fused = encode_imus(
        'base_link', readings, orientation=turns.as_quat(), orientation_covariance=np.eye(3) * 4e-6
    )
    pose = readings.angular_rate, turns.as_quat(), np.zeros((6, 6))
    twist = readings.angular_rate, readings.specific_force, np.zeros((6, 6))
    poses = encode_odometry(('odom', 'base_link'), STAMPS, pose, twist)
    imu_type, still = 'sensor_msgs/msg/Imu', 'geometry_msgs/msg/TwistWithCovarianceStamped'
    streams = {f'/imu{k}/data_raw': (imu_type, encode_imus('imu', readings)) for k in range(2)}
    streams |= {'/imu/data': (imu_type, fused), '/zero_velocity': (still, map(header, STAMPS[:5]))}
    streams |= {'/odom': ('nav_msgs/msg/Odometry', poses[1:])} if odom else {}
    with BagWriter(path) as bag:
        for topic, (kind, messages) in streams.items():
            bag.add_topic(topic, kind)
            for stamp, data in zip(STAMPS, messages, strict=False):
                bag.write(topic, int(stamp) + DELAY, data)
    return readings, turns


def test_a_run_is_read_back_as_it_was_published(tmp_path):
    readings, turns = write(tmp_path / 'bag')
    run = read_run(tmp_path / 'bag', ['imu0', 'imu1'])
    # The odometry lacks the first message, so the track begins with the second.
    assert run.track.stamp_ns.tolist() == STAMPS[1:].tolist()
    assert_allclose(run.track.angular_rate, readings.angular_rate[1:])
    assert_allclose(run.track.position_n, readings.angular_rate[1:])
    assert_allclose(run.track.R_nb, turns.as_matrix()[1:], atol=1e-12)
    assert_allclose(run.track.attitude_sigma_n, 2e-3)
    assert run.track.still.tolist() == [True] * 4 + [False] * 15
    assert_allclose(run.ages, DELAY * 1e-9)
    assert [len(samples) for samples in run.raw] == [N, N]


def test_a_bag_without_odometry_is_refused_by_name(tmp_path):
    write(tmp_path / 'bag', odom=False)
    with pytest.raises(ConfigError, match='must hold `/odom`'):
        read_run(tmp_path / 'bag', ['imu0', 'imu1'])
