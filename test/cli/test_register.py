"""`multiimu register`: poses from a bag, a pointer or a drawing, and nothing else is touched."""

import json

from calibration_bags import recorded, register, write_bag
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation
import yaml

from multiimu_ros.errors import ConfigError, MultiImuError
from multiimu_ros.rig import load_rig, save_rig

CORNERS = {'a': [0, 0, 0], 'b': [0.02, 0, 0], 'c': [0.02, 0.015, 0], 'd': [0.006, 0.015, 0]}
DRAWN = {
    'imu0': {'position': [0.01, 0, 0], 'axes': {'x': 'forward', 'z': 'up'}},
    'imu1': {'position': [0, 0.05, 0.004], 'axes': {'x': 'left', 'z': 'up'}},
}


@pytest.fixture(scope='module')
def recording():
    return recorded(poses=6, waving=20.0)  # too few poses for intrinsics, which are known


@pytest.fixture(scope='module')
def bag(recording, tmp_path_factory):
    return write_bag(tmp_path_factory.mktemp('register') / 'bag', recording.raw)


@pytest.fixture
def rig(recording, tmp_path):
    """Write the true rig without poses, as if it had been calibrated elsewhere."""
    imus = [imu.model_copy(update={'extrinsics': None}) for imu in recording.rig.imus]
    save_rig(recording.rig.model_copy(update={'imus': tuple(imus)}), tmp_path / 'rig.yaml')
    return tmp_path / 'rig.yaml'


def written(tmp_path, **content):
    (tmp_path / 'sheet.yaml').write_text(yaml.safe_dump({'version': 1, **content}))
    return tmp_path / 'sheet.yaml'


def surveyed(main='imu0', second='imu1'):
    """Return a pointer's points on two boards, of which the second lies 5 cm to the left."""
    there = {name: [x, y + 0.05, z] for name, (x, y, z) in CORNERS.items()}
    boards = {
        'imu0': {'corners': CORNERS, 'points': CORNERS},
        second: {'corners': CORNERS, 'points': there},
    }
    return {'main': main, 'imus': boards, 'pointer_sigma': 1e-4}


def rest_of(rig):
    keys = {'extrinsics', 'time_offset', 'time_offset_sigma', 'provenance'}
    return [imu.model_dump(exclude=keys) for imu in rig.imus]


def test_a_bag_gives_poses_and_keeps_intrinsics_and_noise_bit_for_bit(
    tmp_path, recording, bag, rig
):
    before = load_rig(rig)
    result = register(tmp_path / 'out.yaml', bag, '--rig', rig, '--json')
    after = load_rig(tmp_path / 'out.yaml')
    assert rest_of(after) == rest_of(before)
    assert json.loads(result.output)['verdict'] in ('good', 'usable')
    true = [imu.extrinsics.lever_arm_b for imu in recording.rig.imus]
    pose = after.imus[1].extrinsics
    error = (pose.lever_arm_b - (true[1] - true[0])) / pose.lever_arm_sigma
    assert np.abs(error).max() < 5  # sigma
    for stage in ('time', 'rotation', 'lever_arm'):
        assert after.imus[1].provenance[stage]['bag'] == 'bag'
    assert 'intrinsics' not in after.imus[1].provenance


def test_a_drawing_places_the_imus(tmp_path, rig):
    before = load_rig(rig)
    result = register(rig, '--rig', rig, '--cad', written(tmp_path, imus=DRAWN))
    after = load_rig(rig)
    assert rest_of(after) == rest_of(before)
    assert after.imus[1].extrinsics.lever_arm == (0.0, 0.05, 0.004)
    assert after.imus[1].provenance['extrinsics'] == 'drawing'
    assert '0.00 0.00 90.00' in result.output  # x to the left: a yaw of 90 deg
    assert 'not stated' in result.output  # a drawing tells no sigma
    assert load_rig(tmp_path / 'rig.yaml.old') == before


def test_a_pointer_places_the_imus_beside_the_main_one(tmp_path, rig):
    register(rig, '--rig', rig, '--cad', written(tmp_path, imus=DRAWN))
    register(rig, '--rig', rig, '--tip', written(tmp_path, **surveyed()))
    first, second = load_rig(rig).imus
    assert first.extrinsics.lever_arm == (0.01, 0.0, 0.0)  # where the drawing put it
    assert_allclose(second.extrinsics.lever_arm, [0.01, 0.05, 0.0], atol=1e-12)  # rounding
    assert second.extrinsics.lever_arm_sigma is not None
    assert second.provenance['extrinsics'] == 'pointer'


@pytest.mark.parametrize(
    ('way', 'content', 'words'),
    [
        ('--cad', {'imus': {'imu7': DRAWN['imu1']}}, ('`imu7`', 'imu0, imu1', 'correct')),
        ('--tip', surveyed(second='imu7'), ('`imu7`', 'imu0, imu1', 'correct')),
        ('--tip', surveyed(main='imu7', second='imu7'), ('`main`', '`imu7`', 'imu0, imu1')),
        ('--cad', {'imus': {}}, ('sheet.yaml',)),
    ],
)
def test_unknown_imus_are_refused(tmp_path, rig, way, content, words):
    before = rig.read_bytes()
    with pytest.raises(MultiImuError) as error:
        register(rig, '--rig', rig, way, written(tmp_path, **content))
    for word in words:
        assert word in str(error.value)
    assert rig.read_bytes() == before
    assert not (tmp_path / 'rig.yaml.old').exists()


def test_exactly_one_way_must_be_chosen(tmp_path, rig, bag):
    sheet = written(tmp_path, imus=DRAWN)
    for ways in ([], [bag, '--cad', sheet], ['--cad', sheet, '--tip', sheet]):
        with pytest.raises(ConfigError, match='just one'):
            register(tmp_path / 'out.yaml', '--rig', rig, *ways)
    with pytest.raises(ConfigError, match='`--report`'):
        register(tmp_path / 'out.yaml', '--rig', rig, '--cad', sheet, '--report', tmp_path / 'r')
    assert not (tmp_path / 'out.yaml').exists()


def test_a_place_that_cannot_be_written_is_refused_first(tmp_path, rig):
    with pytest.raises(ConfigError, match=r'`-o .*choose another'):
        register(tmp_path / 'none' / 'rig.yaml', tmp_path / 'no_bag', '--rig', rig)


def test_a_tracker_gives_the_poses_on_its_target_and_the_delays(tmp_path, recording, bag, rig):
    truth, times = recording.truth, recording.truth_ns
    quaternions = Rotation.from_matrix(truth.R_nb).as_quat()
    table = np.column_stack([times * 1e-9 - times[0] * 1e-9, truth.position_n, quaternions])
    head = 'time,x,y,z,qx,qy,qz,qw'
    np.savetxt(tmp_path / 'poses.csv', table, delimiter=',', header=head, comments='')
    output = tmp_path / 'out.yaml'
    register(output, bag, '--rig', rig, '--tracker', tmp_path / 'poses.csv')
    found = load_rig(output)
    assert rest_of(found) == rest_of(load_rig(rig))
    for imu, true in zip(found.imus, recording.rig.imus, strict=True):
        assert imu.provenance['extrinsics'] == 'tracker'
        turn = imu.extrinsics.R_bs.T @ true.extrinsics.R_bs
        assert Rotation.from_matrix(turn).magnitude() < np.deg2rad(0.05)  # docs: 0.006 deg
        assert_allclose(imu.extrinsics.lever_arm, true.extrinsics.lever_arm, atol=5e-4)
    assert abs(found.imus[1].time_offset - recording.rig.imus[1].time_offset) < 1e-4


def test_a_tracker_without_a_bag_is_refused(tmp_path, rig):
    with pytest.raises(ConfigError, match='must come with the BAG recorded meanwhile'):
        register(tmp_path / 'o.yaml', '--rig', rig, '--tracker', 'poses.csv', '--cad', 'x')
