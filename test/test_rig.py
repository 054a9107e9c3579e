"""The rig file: what is written comes back, what is wrong is refused by its path."""

import copy
import os
from pathlib import Path

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation
import yaml

from multiimu_ros import rig as rigs
from multiimu_ros.errors import ConfigError

MINIMAL = """
version: 1
rig: {name: pair}
imus:
  - {name: imu0, frame_id: imu0_link}
  - {name: imu1, frame_id: imu1_link}
"""

FULL = """
version: 1
rig: {name: ring8, base_frame: base_link, latitude: 59.35, height: 30.0}
imus:
  - name: imu0
    frame_id: imu0_link
    model: BMI160
    serial: 'A-17'
    intrinsics:
      accelerometer:
        misalignment: [[1, 0.01, -0.02], [0, 1, 0.03], [0, 0, 1]]
        scale: [1.01, 0.99, 1.0]
        scale_sigma: [1e-4, 1e-4, 1e-4]
        bias: [0.1, -0.2, 0.3]
        bias_sigma: [0.001, 0.001, 0.001]
      gyroscope:
        g_sensitivity: [[1e-4, 0, 0], [0, 0, 0], [0, 0, 0]]
    noise:
      noise_density: {accelerometer: [1.8e-3, 1.8e-3, 1.8e-3], gyroscope: [1e-4, 1e-4, 1e-4]}
    extrinsics: {rotation: [0, 0, 0.70711, 0.70711], lever_arm: [0.08, 0, 0]}
    time_offset: -0.0012
    time_offset_sigma: 1.0e-5
    provenance: {bag: wave.mcap, residual_rms: 0.004}
"""


def parse(change=None):
    """Return the full rig after `change` has edited its content."""
    content = yaml.safe_load(FULL)
    if change is not None:
        change(content)
    return rigs.parse_rig(content, 'ring.yaml')


def edit(path, value):
    """Return a function that sets the key at `path`, a sequence of keys and indices."""

    def change(content):
        for key in path[:-1]:
            content = content[key]
        content[path[-1]] = value

    return change


def test_a_saved_rig_loads_as_it_was(tmp_path):
    rig = parse()
    rigs.save_rig(rig, tmp_path / 'rig.yaml')
    assert rigs.load_rig(tmp_path / 'rig.yaml') == rig


@given(
    quaternion=st.integers(0, 2**32 - 1).map(lambda seed: Rotation.random(rng=seed).as_quat()),
    bias=st.tuples(*[st.floats(-1e3, 1e3)] * 3),
)
def test_every_digit_survives_the_file(quaternion, bias, tmp_path_factory):
    path = tmp_path_factory.mktemp('rig') / 'rig.yaml'
    content = yaml.safe_load(MINIMAL)
    content['imus'][0]['extrinsics'] = {'rotation': quaternion.tolist()}
    content['imus'][0]['intrinsics'] = {'gyroscope': {'bias': list(bias)}}
    rig = rigs.parse_rig(content, 'drawn')
    rigs.save_rig(rig, path)
    again = rigs.load_rig(path)
    assert again.imus[0].intrinsics == rig.imus[0].intrinsics
    # Normalising what is normal may turn the last bit.
    assert_allclose(again.imus[0].extrinsics.R_bs, rig.imus[0].extrinsics.R_bs, atol=1e-15)


def test_a_matrix_is_written_as_a_matrix(tmp_path):
    rigs.save_rig(parse(), tmp_path / 'rig.yaml')
    text = (tmp_path / 'rig.yaml').read_text()
    assert 'misalignment: [[1.0, 0.01, -0.02], [0.0, 1.0, 0.03], [0.0, 0.0, 1.0]]' in text
    assert 'null' not in text


def test_absent_blocks_are_nominal_and_can_be_told():
    rig = rigs.parse_rig(yaml.safe_load(MINIMAL), 'pair.yaml')
    assert rig.names == ('imu0', 'imu1')
    assert rig.nominal_blocks()[:3] == (
        'imus[0].intrinsics',
        'imus[0].noise',
        'imus[0].extrinsics',
    )
    assert parse().nominal_blocks() == ()


def test_extrinsics_map_sensor_vectors_into_the_base():
    extrinsics = parse().imus[0].extrinsics
    # A quarter turn about z: the sensor's x looks along the rig's y; 5 typed digits are enough.
    assert_allclose(extrinsics.R_bs @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    assert_allclose(np.linalg.norm(extrinsics.rotation), 1.0, rtol=1e-15)
    assert extrinsics.lever_arm_b.tolist() == [0.08, 0.0, 0.0]


def test_a_number_without_a_point_is_a_number():
    # YAML 1.1 reads 1e-4 as text; a person means a number.
    assert parse().imus[0].intrinsics.accelerometer.scale_sigma == (1e-4, 1e-4, 1e-4)


IMU = ('imus', 0)
ACC = (*IMU, 'intrinsics', 'accelerometer')
REFUSALS = [
    (('version',), 2, '`version`: Input should be 1, got 2'),
    (('colour',), 'red', '`colour`: Extra inputs are not permitted.'),
    (('rig', 'gravitty'), 9.8, '`rig.gravitty`: Extra inputs are not permitted.'),
    (('rig', 'gravity'), 981.0, '`rig.gravity`: Input should be less than 30, got 981.0'),
    (('rig', 'latitude'), 91, '`rig.latitude`: Input should be less than or equal to 90, got 91'),
    (('imus',), [], '`imus`: Tuple should have at least 1 item'),
    ((*IMU, 'name'), '0imu', '`imus[0].name`: String should match pattern'),
    ((*IMU, 'name'), 'a b', '`imus[0].name`: String should match pattern'),
    ((*IMU, 'time_offset'), float('nan'), '`imus[0].time_offset`: Input should be a finite'),
    ((*IMU, 'time_offset_sigma'), -1.0, '`imus[0].time_offset_sigma`: Input should be greater'),
    ((*ACC, 'scale'), [1, 0, 1], '.accelerometer.scale`: must not contain 0, got [1, 0, 1]'),
    ((*ACC, 'scale'), [1, 1], '`imus[0].intrinsics.accelerometer.scale[2]`: Field required.'),
    ((*ACC, 'bias'), ['a', 0, 0], '.accelerometer.bias[0]`: Input should be a valid number'),
    ((*ACC, 'bias_sigma'), [1, -1, 1], '.accelerometer.bias_sigma[1]`: Input should be greater'),
    ((*ACC, 'misalignment'), [[0] * 3] * 3, '.misalignment`: must be an invertible matrix'),
    ((*ACC, 'g_sensitivity'), [[0] * 3] * 3, '.g_sensitivity`: Extra inputs'),
    ((*IMU, 'extrinsics', 'rotation'), [0, 0, 1, 1], 'unit quaternion [x, y, z, w], got one of'),
    ((*IMU, 'extrinsics', 'rotation'), [0, 0, 0, 0], 'unit quaternion [x, y, z, w], got one of'),
    ((*IMU, 'noise', 'noise_density'), {'gyroscope': [1, 1, 1]}, '.accelerometer`: Field requir'),
]


@pytest.mark.parametrize(('path', 'value', 'message'), REFUSALS)
def test_what_is_wrong_is_refused_with_the_keys_path(path, value, message):
    with pytest.raises(ConfigError) as caught:
        parse(edit(path, value))
    assert str(caught.value).startswith('ring.yaml: `')
    assert message in str(caught.value)


@pytest.mark.parametrize('content', [None, [], 'ring8', 3])
def test_a_file_that_is_no_mapping_is_refused(content):
    with pytest.raises(ConfigError, match=r'ring\.yaml: `the top level`: Input should be'):
        rigs.parse_rig(content, 'ring.yaml')


def test_two_imus_of_one_name_are_refused():
    def twice(content):
        content['imus'].append(copy.deepcopy(content['imus'][0]))

    with pytest.raises(ConfigError, match='`imus` must have distinct names, got `imu0`'):
        parse(twice)


def test_a_seventeenth_imu_is_refused():
    imus = [{'name': f'imu{k}', 'frame_id': f'imu{k}_link'} for k in range(17)]
    with pytest.raises(ConfigError, match='`imus`: Tuple should have at most 16 items'):
        parse(edit(('imus',), imus))


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r'Cannot read the rig file `.*none\.yaml`: No such'):
        rigs.load_rig(tmp_path / 'none.yaml')


@pytest.mark.parametrize('junk', [b'rig: [1, 2', b'\xff\xfe\x00rig', b'a: b: c'])
def test_a_file_that_is_no_yaml_is_named(tmp_path, junk):
    path = tmp_path / 'rig.yaml'
    path.write_bytes(junk)
    with pytest.raises(ConfigError, match=r'The rig file `.*rig\.yaml` is not YAML: '):
        rigs.load_rig(path)


def test_the_file_before_is_kept(tmp_path):
    path = tmp_path / 'rig.yaml'
    for name in ('first', 'second', 'third'):
        rigs.save_rig(parse(edit(('rig', 'name'), name)), path)
    assert rigs.load_rig(path).rig.name == 'third'
    assert rigs.load_rig(tmp_path / 'rig.yaml.old').rig.name == 'second'
    assert {item.name for item in tmp_path.iterdir()} == {'rig.yaml', 'rig.yaml.old'}


@pytest.mark.parametrize('step', [(os, 'fsync'), (Path, 'replace')])
def test_a_write_that_fails_leaves_the_file_as_it_was(tmp_path, monkeypatch, step):
    path = tmp_path / 'rig.yaml'
    rigs.save_rig(parse(), path)

    def full(*_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(*step, full)
    with pytest.raises(ConfigError, match=r'Cannot write .*: No space left on device; choose'):
        rigs.save_rig(parse(edit(('rig', 'name'), 'other')), path)
    assert rigs.load_rig(path) == parse()


def test_a_full_disk_leaves_no_draft_behind(tmp_path, monkeypatch):
    def full(_):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr(os, 'fsync', full)
    with pytest.raises(ConfigError):
        rigs.save_rig(parse(), tmp_path / 'rig.yaml')
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_not_there_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r'Cannot write the rig file .*: No such file'):
        rigs.save_rig(parse(), tmp_path / 'none' / 'rig.yaml')


def test_others_may_read_the_file(tmp_path):
    rigs.save_rig(parse(), tmp_path / 'rig.yaml')
    assert (tmp_path / 'rig.yaml').stat().st_mode & 0o777 == 0o644


# NIMA TR8350.2, table 3.4: normal gravity of the ellipsoid at the equator and at the poles.
@pytest.mark.parametrize(('latitude', 'published'), [(0, 9.7803253359), (90, 9.8321849378)])
def test_gravity_on_the_ellipsoid_is_the_published_one(latitude, published):
    assert_allclose(rigs.normal_gravity(latitude, 0.0), published, atol=1e-10)


def test_gravity_falls_with_height():
    fall = rigs.normal_gravity(45.0, 1000.0) - rigs.normal_gravity(45.0, 0.0)
    # GRS 80 (Moritz, 1980), the same ellipsoid to 0.1 mm: -(3.0877e-6 - 4.3e-9 sin^2) h
    # + 0.72e-12 h^2, whose last digits are worth 1e-7 at 1 km.
    assert_allclose(fall, -3.0877e-3 + 4.3e-6 / 2 + 0.72e-6, atol=1e-7)


@pytest.mark.parametrize(
    ('keys', 'gravity'),
    [
        ({}, 9.80665),
        ({'gravity': 9.81}, 9.81),
        ({'latitude': 0.0}, 9.7803253359),
        ({'gravity': 9.81, 'latitude': 0.0}, 9.81),
    ],
)
def test_gravity_is_what_the_file_says_else_the_latitudes_else_standard(keys, gravity):
    frame = rigs.RigFrame(name='r', **keys)
    assert_allclose(frame.gravity_magnitude, gravity, atol=1e-10)


def test_the_nominal_imu_is_no_better_than_a_calibrated_one():
    noise = rigs.NOMINAL_NOISE
    assert np.all(np.array(noise.noise_density.gyroscope) >= np.deg2rad(0.007) * 0.98)


def test_a_range_is_kept_and_may_name_one_triad_only(tmp_path):
    rig = parse(edit(['imus', 0, 'range'], {'gyroscope': 8.7}))
    assert rig.imus[0].range.gyroscope == 8.7
    assert rig.imus[0].range.accelerometer is None
    rigs.save_rig(rig, tmp_path / 'rig.yaml')
    assert rigs.load_rig(tmp_path / 'rig.yaml') == rig
    assert parse().imus[0].range is None


@pytest.mark.parametrize('value', [0.0, -8.7, 'wide', float('inf')])
def test_a_range_that_is_none_is_refused_by_its_path(value):
    with pytest.raises(ConfigError, match=r'imus.*range.*gyroscope'):
        parse(edit(['imus', 0, 'range'], {'gyroscope': value}))
