"""A tracker's file: what it says comes through, and what is wrong with it is told."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import ConfigError
from multiimu_ros.registration.pose_file import load_poses

HEAD = 'time,name,x,y,z,qx,qy,qz,qw\n'


def written(tmp_path, text):
    (tmp_path / 'poses.csv').write_text(text)
    return tmp_path / 'poses.csv'


def test_poses_and_gaps_come_through(tmp_path):
    lines = '1.5,a,1,2,3,0,0,0.6,0.8\n1.51,a,,,,,,,\n1.52,a,nan,nan,nan,0,0,0,1\n'
    poses = load_poses(written(tmp_path, HEAD + lines))
    assert poses.stamp_ns.tolist() == [1_500_000_000, 1_510_000_000, 1_520_000_000]
    assert_allclose(poses.position_w[0], [1, 2, 3])
    assert_allclose(poses.R_wt[0], Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix())
    assert np.isnan(poses.position_w[1:]).all()
    assert np.isnan(poses.R_wt[1:]).all()


def test_nanoseconds_are_taken_as_they_are(tmp_path):
    text = 'stamp_ns,x,y,z,qx,qy,qz,qw\n1700000000000000000,0,0,0,0,0,0,1\n'
    assert load_poses(written(tmp_path, text)).stamp_ns.tolist() == [1_700_000_000_000_000_000]


@pytest.mark.parametrize(
    ('text', 'reason'),
    [
        ('time,x,y,z,qx,qy,qz\n0,0,0,0,0,0,0\n', 'must name a column `qw`'),
        (HEAD + '1,a,0,0,0,0,0,0,1\n1,a,0,0,0,0,0,0,1\n', '`time` must rise from line to line'),
        (HEAD + '1,a,0,0,0\n', 'Cannot read the poses'),
    ],
)
def test_a_wrong_file_is_refused_with_the_reason(tmp_path, text, reason):
    with pytest.raises(ConfigError, match=reason):
        load_poses(written(tmp_path, text))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r'Cannot read the poses .*none\.csv'):
        load_poses(tmp_path / 'none.csv')
