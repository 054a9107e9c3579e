"""Faults put into a recording are found, and nothing else is."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from multiimu_ros.bags import BagWriter, ImuTrack
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.cli import verdicts
from multiimu_ros.cli.inspect import app, inspect_track, saturated
from multiimu_ros.errors import ConfigError
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

N = 400


@pytest.fixture
def samples(rng):
    """Return 2 s at 200 Hz of a rig that rests but for noise."""
    stamp_ns = 10**18 + 5_000_000 * np.arange(N)
    noise = 0.01 * rng.standard_normal((2, N, 3))
    return ImuSamples(stamp_ns, noise[0], noise[1] + [0.0, 0.0, 9.81])


def complaints(samples, late_ns=0):
    track = ImuTrack('/imu0/data_raw', 'imu0_link', samples, samples.stamp_ns + late_ns)
    return ' '.join(inspect_track(track)['complaints'])


def test_a_good_recording_is_not_complained_about(samples):
    assert complaints(samples) == ''


@pytest.mark.parametrize(
    ('fault', 'complaint'),
    [
        (lambda s: s.select(np.r_[:100, 200:400]), '1 gaps, the longest 0.505 s'),
        (lambda s: s.select(np.r_[:100, 50:400]), '1 stamps go back'),
        (lambda s: s.select(np.r_[:100, 99:400]), '1 stamps repeat'),
        (lambda s: s.select(slice(0, 0)), 'it is empty'),
        (lambda s: scaled(s, 1.0, 1 / 9.81), 'the median force is 1: it looks like g'),
        (lambda s: scaled(s, 1.0, 0.01), 'was gravity taken out'),
        (lambda s: scaled(s, 1e4, 1.0), 'it looks like deg/s'),
        (lambda s: clipped(s, 0.015), 'rates end the range'),
        (lambda s: with_nan(s, 3), '1 readings are not finite'),
    ],
)
def test_a_fault_is_found(samples, fault, complaint):
    assert complaint in complaints(fault(samples))


def scaled(samples, rate, force):
    return ImuSamples(
        samples.stamp_ns, rate * samples.angular_rate, force * samples.specific_force
    )


def clipped(samples, limit):
    rate = np.clip(samples.angular_rate, -limit, limit)
    return ImuSamples(samples.stamp_ns, rate, samples.specific_force)


def with_nan(samples, index):
    force = samples.specific_force.copy()
    force[index, 1] = np.nan
    return ImuSamples(samples.stamp_ns, samples.angular_rate, force)


def test_stamps_on_the_clock_of_the_board_are_named(samples):
    assert 'are they the clock of the board' in complaints(samples, late_ns=7200 * 10**9)


def test_coarse_readings_at_rest_are_not_saturated(rng):
    # Noise of one step: the extremes come again, but less often than the step before them.
    assert saturated(np.round(rng.standard_normal((5000, 3))) * 0.1 + [0.0, 0.0, 9.8]) == 0


def test_a_rate_that_is_no_number_is_counted(samples):
    samples.angular_rate[3:5] = np.nan
    assert '2 readings are not finite' in complaints(samples)


def test_both_ends_of_the_range_count_as_saturated():
    ramp = np.linspace(-1.0, 1.0, 100)[:, None] * np.ones(3)
    assert saturated(ramp) == 0
    assert saturated(np.clip(ramp, -0.9, 0.9)) == 30  # 5 at each end of each axis


def test_the_verb_prints_json_for_machines_and_words_for_people(tmp_path, samples):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/imu0/data_raw', 'sensor_msgs/msg/Imu')
        bag.add_topic('/odom', 'nav_msgs/msg/Odometry')
        for stamp_ns, data in zip(
            samples.stamp_ns.tolist(), encode_imus('a', samples), strict=True
        ):
            bag.write('/imu0/data_raw', stamp_ns, data)
        bag.write('/imu0/data_raw', 0, data)  # twice the last one
    runner, path = CliRunner(), str(tmp_path / 'bag')
    answer = json.loads(runner.invoke(app, [path, '--json']).stdout)
    assert answer['candidates'] == ['/imu0/data_raw']
    assert answer['imus'][0]['rate_hz'] == pytest.approx(200.0)
    assert [topic['count'] for topic in answer['topics']] == [N + 1, 0]
    words = runner.invoke(app, [path, '--topics', '/other'])
    assert words.exit_code == 0
    assert 'no Imu topic looks raw' in words.stdout
    words = runner.invoke(app, [path]).stdout
    assert 'To fuse or calibrate: /imu0/data_raw' in words
    assert '/imu0/data_raw: 1 stamps ' in words


@pytest.fixture(scope='module')
def calibration(tmp_path_factory):
    """Return a bag of 60 s of two IMUs: some poses, and waving."""
    path = tmp_path_factory.mktemp('bags') / 'calibration'
    raw = simulate(ring(2), trajectory('calibration', 60.0), 50.0).raw
    with BagWriter(path) as bag:
        for k, part in enumerate(raw):
            bag.add_topic(f'/imu{k}/data_raw', 'sensor_msgs/msg/Imu')
            messages = encode_imus(f'imu{k}_link', part)
            for stamp_ns, data in zip(part.stamp_ns.tolist(), messages, strict=True):
                bag.write(f'/imu{k}/data_raw', stamp_ns, data)
    return str(path)


def test_the_verb_says_what_a_calibration_lacks(calibration):
    words = CliRunner().invoke(app, [calibration]).stdout
    assert 'What /imu0/data_raw and 1 more that move alike' in words
    assert 'rad/s m/s^2' in words
    assert 'accelerometer: prop it on the edge' in words
    assert 'Allan: record an hour of rest' in words


def test_the_json_of_a_calibration_has_everything_under_stable_keys(calibration):
    answer = json.loads(CliRunner().invoke(app, [calibration, '--json']).stdout)
    assert list(answer) == ['topics', 'imus', 'candidates', 'boards', 'suffices']
    assert answer['boards'][0]['topics'] == ['/imu0/data_raw', '/imu1/data_raw']
    assert answer['boards'][0]['correlations']['/imu1/data_raw'] > 0.9  # what makes a board
    assert answer['suffices'] == answer['boards'][0]['suffices']
    assert set(answer['suffices'][0]) == {'task', 'answer', 'why', 'instead'}
    imu = answer['imus'][0]
    assert {'saturated_share', 'rest', 'units', 'poses', 'turns', 'waving', 'suffices'} <= set(imu)
    assert set(imu['rest']) == {'first_s', 'longest_s', 'total_s', 'count'}


@pytest.mark.parametrize(('arguments', 'got'), [([], 'neither'), (['bag', '--live'], 'both')])
def test_exactly_one_of_a_bag_and_live_is_wanted(arguments, got):
    error = CliRunner().invoke(app, arguments).exception
    assert isinstance(error, ConfigError)
    assert (
        str(error) == f'`inspect` must have either a BAG or `--live`, got {got}; pass one of them.'
    )


def test_a_terminal_shows_that_reading_takes_its_time(monkeypatch, capsys):
    monkeypatch.setenv('FORCE_COLOR', '1')  # rich then takes stderr for a terminal
    monkeypatch.setenv('TERM', 'xterm')
    with verdicts.waiting('Reading walk ...'):
        pass
    assert 'Reading walk' in capsys.readouterr().err


def test_long_lists_are_cut_short():
    assert verdicts.shortened(list('abcde')) == list('abcde')
    assert verdicts.shortened(list('abcdef')) == [*'abcd', 'and 2 more like these']
