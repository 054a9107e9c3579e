"""`multiimu allan` on small recordings: what it writes, keeps, prints and refuses."""

import json

import numpy as np
from numpy.testing import assert_allclose
import pytest
from temperatures import temperature
from typer.testing import CliRunner
import yaml

from multiimu_ros.bags import BagWriter
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.cli.allan import app
from multiimu_ros.cli.rig_start import names_of
from multiimu_ros.errors import CalibrationError, ConfigError
from multiimu_ros.rig import load_rig, parse_rig, save_rig
from multiimu_ros.samples import ImuSamples

N, PERIOD_NS = 7000, 10_000_000  # 70 s at 100 Hz
START_NS = 1_700_000_000 * 10**9
RATE_DENSITY, FORCE_DENSITY = 1e-4, 2e-3


def resting(rng, n=N):
    stamps = START_NS + PERIOD_NS * np.arange(n)
    rate = RATE_DENSITY * 10 * rng.standard_normal((n, 3))  # one sample has N sqrt(100)
    force = FORCE_DENSITY * 10 * rng.standard_normal((n, 3)) + np.array([0.0, 0.0, 9.81])
    return ImuSamples(stamps, rate, force)


def write(path, topics, temperatures=()):
    """Write the samples of each topic, with the name of its frame."""
    with BagWriter(path) as bag:
        for topic, samples in topics.items():
            bag.add_topic(topic, 'sensor_msgs/msg/Imu')
            for stamp_ns, data in zip(
                samples.stamp_ns.tolist(), encode_imus('chip', samples), strict=True
            ):
                bag.write(topic, stamp_ns, data)
        if temperatures:
            bag.add_topic('/imu0/temperature', 'sensor_msgs/msg/Temperature')
        for value in temperatures:
            bag.write('/imu0/temperature', START_NS, temperature(value))
    return path


def allan(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)


@pytest.fixture
def pair(tmp_path, rng):
    topics = {f'/imu{k}/data_raw': resting(rng) for k in (1, 0)}
    return write(tmp_path / 'rest', topics, (24.5, 27.0))


@pytest.fixture
def board(tmp_path):
    """Save a rig of three, the second and third with things worth keeping."""
    imus = [
        {'name': 'imu0', 'frame_id': 'f0', 'serial': 'A1', 'provenance': {'intrinsics': {'a': 1}}},
        {'name': 'imu1', 'frame_id': 'f1', 'time_offset': 0.25,
         'intrinsics': {'gyroscope': {'scale': [2.0, 2.0, 2.0]}}},
        {'name': 'imu2', 'frame_id': 'f2', 'extrinsics': {'lever_arm': [0.1, 0.0, 0.0]}},
    ]  # fmt: skip
    rig = parse_rig({'version': 1, 'rig': {'name': 'ring3', 'gravity': 9.8}, 'imus': imus}, 'test')
    save_rig(rig, tmp_path / 'rig.yaml')
    return tmp_path / 'rig.yaml'


def test_without_a_rig_one_is_made_of_the_topics(tmp_path, pair):
    answer = allan(pair, '-o', tmp_path / 'new.yaml')
    assert answer.exit_code == 0
    rig = load_rig(tmp_path / 'new.yaml')
    assert rig.names == ('imu0', 'imu1')
    assert rig.imus[0].frame_id == 'chip'  # what the messages say
    for imu in rig.imus:
        # 7000 samples: 1 % with all five terms in the fit; four of them.
        assert_allclose(imu.noise.noise_density.gyroscope, RATE_DENSITY, rtol=0.05)
        assert_allclose(imu.noise.noise_density.accelerometer, FORCE_DENSITY, rtol=0.05)
        assert imu.noise.bias_random_walk is None


def test_the_rest_of_the_rig_is_kept(tmp_path, pair, board):
    before = load_rig(board)
    assert allan(pair, '--rig', board, '-o', board).exit_code == 0
    after = load_rig(board)
    assert load_rig(board.with_name('rig.yaml.old')) == before
    assert after.rig == before.rig
    assert after.imus[2] == before.imus[2]  # which was not recorded
    for k in (0, 1):
        fresh = {'noise': None, 'provenance': before.imus[k].provenance}
        assert after.imus[k].model_copy(update=fresh) == before.imus[k]
    assert after.imus[0].provenance['intrinsics'] == {'a': 1}
    # The noise of calibrated readings: a scale of 2 doubles it.
    assert_allclose(after.imus[1].noise.noise_density.gyroscope, 2 * RATE_DENSITY, rtol=0.05)


def test_provenance_says_where_the_figures_come_from(tmp_path, pair):
    allan(pair, '-o', tmp_path / 'new.yaml')
    noted = [imu.provenance['noise'] for imu in load_rig(tmp_path / 'new.yaml').imus]
    assert noted[0]['bag'] == 'rest'
    assert len(noted[0]['sha256']) == 64
    assert noted[0]['date'].startswith('2023-11-14T22:13:20')
    assert_allclose(noted[0]['duration_s'], 70.0)
    assert noted[0]['version'].startswith('multiimu_ros')
    assert noted[0]['temperature'] == [24.5, 27.0]
    assert 'temperature' not in noted[1]


def test_the_table_has_units_and_says_what_is_missing(tmp_path, pair):
    text = allan(pair, '-o', tmp_path / 'new.yaml').stdout
    for part in ('[deg/s/√Hz]', '[deg/h]', '[µg/√Hz]', 'imu1', ' ± ', 'temperature: 24.5 to 27.0'):
        assert part in text
    assert '70 s of rest do not tell the bias random walk of 3 of 3 axes; at least' in text


def test_json_holds_terms_confidences_and_hints(tmp_path, pair):
    result = json.loads(allan(pair, '-o', tmp_path / 'new.yaml', '--json').stdout)
    assert list(result) == ['imu0', 'imu1']
    terms = result['imu0']['gyroscope']['terms']
    assert list(terms) == ['Q', 'N', 'B', 'K', 'R']
    assert terms['N'][2]['low'] < terms['N'][2]['value'] < terms['N'][2]['high']
    assert terms['K'][0]['value'] is None
    assert terms['K'][0]['needed_s'] > 70
    assert {hint['kind'] for hint in result['imu1']['accelerometer']['model']} == {'white'}


def test_report_and_kalibr_files_are_written(tmp_path, pair):
    allan(pair, '-o', tmp_path / 'new.yaml', '--report', tmp_path / 'a' / 'b',
          '--kalibr', tmp_path / 'k.yaml')  # fmt: skip
    page = (tmp_path / 'a' / 'b' / 'allan.html').read_text(encoding='utf-8')
    assert page.count('<img') == 12
    content = yaml.safe_load((tmp_path / 'k_imu1.yaml').read_text())
    assert content['rostopic'] == '/imu1/data_raw'
    assert_allclose(content['gyroscope_noise_density'], RATE_DENSITY, rtol=0.05)
    assert not (tmp_path / 'k.yaml').exists()


def test_a_single_imu_gets_the_kalibr_file_as_named(tmp_path, pair):
    allan(pair, '-o', tmp_path / 'n.yaml', '--topics', '/imu1/data_raw', '--kalibr',
          tmp_path / 'k.yaml')  # fmt: skip
    assert yaml.safe_load((tmp_path / 'k.yaml').read_text())['rostopic'] == '/imu1/data_raw'
    assert load_rig(tmp_path / 'n.yaml').names == ('imu1',)


def test_names_come_from_the_topics_or_are_numbered():
    assert names_of(['/ring/left/data_raw', 'right/data_raw']) == ['left', 'right']
    assert names_of(['/a/imu/data_raw', '/b/imu/data_raw']) == ['imu0', 'imu1']
    assert names_of(['/phone/imu', '/imu0/data_raw']) == ['imu0', 'imu1']
    assert names_of(['/1st/data_raw']) == ['imu0']


def test_ten_imus_are_in_the_order_of_their_numbers(tmp_path, rng):
    samples = resting(rng)
    path = write(tmp_path / 'ten', {f'/imu{k}/data_raw': samples for k in (10, 2, 1)})
    allan(path, '-o', tmp_path / 'n.yaml')
    assert load_rig(tmp_path / 'n.yaml').names == ('imu1', 'imu2', 'imu10')


def test_a_recording_that_moves_or_ends_early_changes_nothing(tmp_path, rng, board):
    before = board.read_bytes()
    short = write(tmp_path / 'short', {'/imu0/data_raw': resting(rng, 3000)})
    with pytest.raises(CalibrationError, match=r'for 60 s, but rests for 30 s .*record 10 min'):
        allan(short, '--rig', board, '-o', board, '--kalibr', tmp_path / 'k.yaml')
    wild = resting(rng)
    wild = ImuSamples(wild.stamp_ns, 1000 * wild.angular_rate, wild.specific_force)
    moving = write(tmp_path / 'moving', {'/imu0/data_raw': resting(rng), '/imu1/data_raw': wild})
    with pytest.raises(CalibrationError, match=r'`/imu1/data_raw` must lie still .* never rests'):
        allan(moving, '--rig', board, '-o', board)
    assert board.read_bytes() == before
    assert not (tmp_path / 'k.yaml').exists()
    assert not board.with_name('rig.yaml.old').exists()


def test_a_rig_file_is_not_replaced_by_a_bare_one(pair, board):
    before = board.read_bytes()
    with pytest.raises(ConfigError, match=r'`--rig .*rig\.yaml` must be given to keep'):
        allan(pair, '-o', board)
    assert board.read_bytes() == before


def test_a_bag_without_raw_topics_says_what_it_holds(tmp_path, rng):
    path = write(tmp_path / 'phone', {'/phone/imu': resting(rng, 100)})
    with pytest.raises(ConfigError, match='it has `/phone/imu`'):
        allan(path, '-o', tmp_path / 'n.yaml')


@pytest.mark.parametrize('option', ['--report', '--kalibr'])
def test_a_place_that_cannot_be_written_is_named(tmp_path, pair, option):
    (tmp_path / 'file').write_text('')
    with pytest.raises(ConfigError, match='choose a writable place'):
        allan(pair, '-o', tmp_path / 'n.yaml', option, tmp_path / 'file' / 'k')
    assert not (tmp_path / 'n.yaml').exists()
