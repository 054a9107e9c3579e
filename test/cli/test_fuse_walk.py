"""`multiimu fuse --smooth --report` on a walk."""

import json
import re

from live_chain import numbers
import numpy as np
from numpy.testing import assert_array_equal
import pytest
from typer.testing import CliRunner
from walk_bags import write_walk

from multiimu_ros.cli.fuse import app
from multiimu_ros.errors import ConfigError

pytestmark = pytest.mark.slow  # where nothing is compiled

SECONDS, RATE_HZ = 14.0, 100.0
POSE_P = slice(7, 43)  # in the doubles of an odometry


@pytest.fixture(scope='module')
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp('walk')
    write_walk(folder, SECONDS, RATE_HZ)
    return folder


@pytest.fixture(scope='module', autouse=True)
def live(folder):
    fuse(folder, 'live')


def fuse(folder, name, *options):
    command = [folder / 'bag', '--rig', folder / 'rig.yaml', '--profile', 'foot']
    command += ['-o', folder / name, '--json', *options]
    result = CliRunner().invoke(app, list(map(str, command)), catch_exceptions=False)
    assert result.exit_code == 0
    return json.loads(result.stdout)


def test_hindsight_changes_the_odometry_alone_and_is_surer(folder):
    summary = fuse(folder, 'smooth', '--smooth', '--report', str(folder / 'report'))
    for topic in ('/imu/data', '/odom'):
        (stamps, live), (same, smooth) = (
            numbers(folder / name, topic) for name in ('live', 'smooth')
        )
        assert_array_equal(stamps, same)
        if topic == '/imu/data':
            assert_array_equal(live, smooth)
    sigma, surer = (np.sqrt(rows[:, POSE_P].reshape(-1, 6, 6)[:, 2, 2]) for rows in (live, smooth))
    # In mid-swing the next stance is known; at the end nothing more is.
    assert np.mean(surer < sigma) > 0.9
    page = (folder / 'report' / 'fuse.html').read_text()
    assert summary['report'] == str(folder / 'report' / 'fuse.html')
    assert 'smoothed' in page


def test_a_walk_that_is_said_to_close_does_and_tells_how_far_off_it_was(folder):
    options = ['--smooth', '--closed', '0.001', '--report', str(folder / 'closed_report')]
    summary = fuse(folder, 'closed', *options)
    page = (folder / 'closed_report' / 'fuse.html').read_text()
    assert 'said to have ended where it began. Before it was closed, the path ended' in page
    assert 'that is the error' not in page
    _, rows = numbers(folder / 'closed', '/odom')
    assert np.linalg.norm(rows[-1, :3]) < min(0.003, summary['closure']['gap'])
    assert summary['closure']['surprise'] < 3
    command = [folder / 'bag', '--rig', folder / 'rig.yaml', '-o', folder / 'again']
    told = CliRunner().invoke(app, [*map(str, command), '--smooth', '--closed', '0.001'])
    # With the profile of a hand no stance is ever found.
    assert re.search(r'the path ended [\d.]+ m from its start, [\d.]+ sigma', told.stdout)


@pytest.mark.parametrize(
    ('options', 'says'),
    [
        (['--closed', '0.1'], '`--closed` needs `--smooth`'),
        (['--smooth', '--closed', '0'], r'`--closed` must be a positive length \[m\], got 0\.0'),
        (['--smooth', '--closed', 'nan'], '`--closed` must be a positive length'),
    ],
)
def test_closing_is_asked_for_in_a_way_that_makes_sense(folder, options, says):
    with pytest.raises(ConfigError, match=says):
        fuse(folder, 'never', *options)
    assert not (folder / 'never').exists()


@pytest.mark.parametrize(
    'options',
    [('--odometry', 'federated'), ('--odometry', 'seeds'), ('--attitude', 'madgwick'),
     ('--attitude', 'rk4'), ('--zero-velocity', 'ared'), ('--zero-velocity', 'none')],
)  # fmt: skip
def test_other_filters_walk_the_same_way(folder, options):
    name = '-'.join(options).strip('-')
    fuse(folder, name, *options)
    _, rows = numbers(folder / name, '/odom')
    _, imus = numbers(folder / name, '/imu/data')
    assert np.isfinite(rows).all()
    assert np.isfinite(imus).all()
    if 'none' in options:
        return
    usual, heading = (numbers(folder / 'live', topic)[1] for topic in ('/odom', '/imu/data'))
    assert np.linalg.norm(usual[:, :3], axis=1).max() > 1.0  # it walked
    # The loop ends where it began; whoever knows a stance ends there to a twentieth of its 5 m.
    assert np.linalg.norm(rows[-1, :3]) < 0.25
    pose = slice(0, 43)  # the twist holds the rate of the attitude filter
    assert (rows[:, pose] != usual[:, pose]).any() == ('--attitude' not in options)
    assert (imus != heading).any() == ('--odometry' not in options)


def test_a_choice_that_does_not_exist_is_refused_by_name(folder):
    with pytest.raises(ConfigError, match='`odometry` must be one of'):
        fuse(folder, 'none', '--odometry', 'best')
    with pytest.raises(ConfigError, match='`zero_velocity` must be one of'):
        fuse(folder, 'none', '--zero-velocity', 'shoe')
