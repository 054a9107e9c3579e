"""`multiimu calibrate`: what it finds, what it keeps, and what it says of recordings that fail."""

from datetime import datetime, UTC
import json

from calibration_bags import (
    calibrate,
    carried,
    changed,
    clipped,
    recorded,
    REST,
    turned_about_z,
    with_slow_moves,
    write_bag,
)
import numpy as np
from numpy.testing import assert_allclose
import pytest
from typer.testing import CliRunner

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.bags import BagWriter
from multiimu_ros.cli.calibrate import grouped
from multiimu_ros.cli.fuse import app as fuse_app
from multiimu_ros.errors import ConfigError, MultiImuError
from multiimu_ros.rig import load_rig, NOMINAL_NOISE, normal_gravity, save_rig
from multiimu_ros.rig_calibration.verdicts import Verdict
from multiimu_ros.samples import ImuSamples

SIGMAS = 5.0  # of 57 figures one is beyond 5 sigma in 30 000 recordings
GRAVITY = 9.80665  # of the simulation
DEGREE = 180 / np.pi


@pytest.fixture(scope='module')
def recording():
    """Return the recording of a board as it should be calibrated."""
    return recorded()


@pytest.fixture(scope='module')
def good(recording, tmp_path_factory):
    """Calibrate that board once; return bag, rig file and what was printed."""
    folder = tmp_path_factory.mktemp('good')
    bag = write_bag(folder / 'bag', recording.raw)
    result = calibrate(bag, folder / 'rig.yaml', '--gravity', GRAVITY)
    assert result.exit_code == 0
    return bag, folder / 'rig.yaml', result.output


@pytest.fixture
def earlier(good, tmp_path):
    """Return a copy of the calibrated rig's file, which may be changed."""
    path = tmp_path / 'earlier.yaml'
    path.write_bytes(good[1].read_bytes())
    return path


def refused(tmp_path, bag, words, *arguments, earlier):
    """Check that a call is refused in one sentence that says why, and changes nothing."""
    before = earlier.read_bytes()
    report = tmp_path / 'report'
    with pytest.raises(MultiImuError) as error:
        calibrate(bag, earlier, '--rig', earlier, '--report', report, *arguments)
    sentence = str(error.value)
    assert '\n' not in sentence
    assert sentence.endswith(('.', '?'))
    for word in words:
        assert word in sentence
    assert earlier.read_bytes() == before
    assert not report.exists()
    assert not earlier.with_name('earlier.yaml.old').exists()


def picture(samples, **changes):
    """Return the samples with other stamps, rates or forces."""
    old = {
        'stamp_ns': samples.stamp_ns,
        'angular_rate': samples.angular_rate,
        'specific_force': samples.specific_force,
    }
    return ImuSamples(**(old | changes))


def half_lost(recording):
    first, second = recording.raw
    kept = np.random.default_rng(1).random(len(second)) < 0.5
    return [first, second.select(kept)]


def other_body(recording):
    return [recording.raw[0], recorded(seed=7).raw[1]]  # other poses at the same instants


def silent_body(recording):
    rate = np.zeros_like(recording.raw[1].angular_rate)
    return [recording.raw[0], picture(recording.raw[1], angular_rate=rate)]


def only_nan(recording):
    rate = np.full_like(recording.raw[1].angular_rate, np.nan)
    return [recording.raw[0], picture(recording.raw[1], angular_rate=rate)]


def one_axis(recording):
    path = with_slow_moves(16, 1.0, only=3)
    return carried(path, path.time[-1] + 1.0).raw


def never_still(recording):
    path = turned_about_z(40.0)
    tracks = carried(path, path.time[-1]).raw
    return [one.select(one.stamp_ns > one.stamp_ns[0] + REST * NANOSECONDS) for one in tracks]


def slow_degrees(recording):
    # Moves of 12 s turn by 31 deg/s at most: no gyroscope's range rules these numbers out.
    path = with_slow_moves(16, 4.0)
    return [changed(one, rate=DEGREE) for one in carried(path, path.time[-1] + 1.0).raw]


DEGENERATE = {
    'no rest': (never_still, ('still poses', 'record it lying still')),
    'five poses': (lambda r: recorded(5, 0.0).raw, ('at least 9 still poses', 'record it lying')),
    'poses about one axis': (one_axis, ('too much alike', '+x up')),
    'two bodies': (other_body, ('one rigid body',)),
    'a gyroscope that says nothing': (silent_body, ('`imu1`', '`imu0`')),
    'half of the samples': (half_lost, ('`imu1` has 50.3 %', 'missing samples', 'cable')),
    'the last two thirds': (
        lambda r: [r.raw[0], r.raw[1].select(np.arange(len(r.raw[1])) < len(r.raw[1]) // 3)],
        ('`imu1` has 66.7 %', 'missing samples', 'cable'),
    ),
    'saturated moves': (
        # 0.5 rad/s: a move of 3 s by a radian reaches it
        lambda r: [clipped(x, 0.5) for x in r.raw],
        ('unbroken moves', 'saturated samples', 'wider range'),
    ),
    'force in g': (
        lambda r: [r.raw[0], changed(r.raw[1], force=1 / GRAVITY)],
        ('`imu1`', 'that is g', 'm/s^2'),
    ),
    'rates in deg/s': (lambda r: [changed(x, rate=DEGREE) for x in r.raw], ('deg/s', 'rad/s')),
    'slow rates in deg/s': (slow_degrees, ('deg/s', 'rad/s', 'driver')),
    'counts': (
        lambda r: [changed(x, rate=16.4 * DEGREE, force=4096 / GRAVITY) for x in r.raw],
        ('counts', 'm/s^2', 'driver'),
    ),
    'only NaN': (only_nan, ('`imu1`', '100 sound samples', 'NaN')),
}


@pytest.mark.parametrize('name', DEGENERATE)
def test_a_degenerate_recording_is_refused_with_the_remedy(tmp_path, recording, earlier, name):
    spoil, words = DEGENERATE[name]
    bag = write_bag(tmp_path / 'bag', spoil(recording))
    refused(tmp_path, bag, words, earlier=earlier)


def test_bodies_whose_moves_look_alike_are_told_apart_by_gravity(tmp_path, recording, earlier):
    # With seed 3 the moves' rates correlate by more than the 0.8 that is asked for.
    tracks = [recording.raw[0], recorded(seed=3).raw[1]]
    bag = write_bag(tmp_path / 'bag', tracks)
    refused(tmp_path, bag, ('feels gravity', 'rigid body'), earlier=earlier)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--only', 'lever_arms'], ('`lever_arms`', 'lever_arm, noise')),
        (['--gravity', '9.8', '--latitude', '59'], ('`--gravity` or `--latitude`', 'leave one')),
        (['--gravity', '98'], ('`--gravity`', 'plausible')),
        (['--latitude', '-91'], ('`--latitude`', 'plausible')),
        (['--height', '500'], ('`--height`', '`--latitude`')),
        (['--topics', 'imu0/data_raw,imu0/data_raw'], ('another topic for each IMU',)),
        (['--topics', 'imu9/data_raw'], ('`imu9/data_raw`', '/imu1/data_raw')),
    ],
)
def test_a_wrong_argument_is_refused(tmp_path, good, earlier, arguments, words):
    refused(tmp_path, good[0], words, *arguments, earlier=earlier)


def test_a_damaged_bag_is_refused(tmp_path, recording, earlier):
    bag = write_bag(tmp_path / 'bag', recording.raw)
    (storage,) = bag.glob('*.mcap')
    storage.write_bytes(storage.read_bytes()[:20_000])
    refused(tmp_path, bag, ('damaged', 'record it again'), earlier=earlier)


def test_an_imu_without_messages_is_named(tmp_path, recording, earlier):
    first, second = recording.raw
    bag = write_bag(tmp_path / 'bag', [first, second.select(np.zeros(len(second), bool))])
    refused(tmp_path, bag, ('nothing was recorded of `imu1`', '`--topics`'), earlier=earlier)


def test_a_topic_of_another_type_is_no_imu(tmp_path, earlier):
    with BagWriter(tmp_path / 'bag') as bag:
        bag.add_topic('/imu0/data_raw', 'std_msgs/msg/String')
        bag.write('/imu0/data_raw', 1, b'\0\1\0\0\1\0\0\0\0')
    refused(tmp_path, tmp_path / 'bag', ('no Imu topic at all',), earlier=earlier)


def test_without_a_rig_the_imus_are_those_that_were_heard(tmp_path, recording):
    first, second = recording.raw
    bag = write_bag(tmp_path / 'bag', [first, second.select(np.zeros(len(second), bool))])
    calibrate(bag, tmp_path / 'rig.yaml')
    assert load_rig(tmp_path / 'rig.yaml').names == ('imu0',)


def test_more_imus_than_a_rig_may_have_are_refused(tmp_path, recording):
    bag = write_bag(tmp_path / 'bag', [recording.raw[0].select(np.arange(2))] * 17)
    with pytest.raises(ConfigError, match='at most 16'):
        calibrate(bag, tmp_path / 'rig.yaml')


def test_a_rig_is_not_replaced_by_a_bare_one(good, earlier):
    before = earlier.read_bytes()
    with pytest.raises(ConfigError, match='--rig'):
        calibrate(good[0], earlier)
    assert earlier.read_bytes() == before


def test_one_stage_needs_the_rest_of_the_rig(tmp_path, good):
    with pytest.raises(ConfigError, match='must come with `--rig`'):
        calibrate(good[0], tmp_path / 'rig.yaml', '--only', 'noise')


def test_places_that_cannot_be_written_are_found_before_the_bag_is_read(tmp_path):
    (tmp_path / 'file').write_text('')
    for place in (tmp_path / 'file' / 'rig.yaml', tmp_path / 'none' / 'rig.yaml', tmp_path):
        with pytest.raises(ConfigError, match=r'`-o .*choose another'):
            calibrate(tmp_path / 'no_bag', place)
    with pytest.raises(ConfigError, match=r'`--report .*choose another'):
        calibrate(tmp_path / 'no_bag', tmp_path / 'rig.yaml', '--report', tmp_path / 'file' / 'r')


def verdicts_of(result):
    return {(v['imu'], v['quantity']): v for v in json.loads(result.output)['verdicts']}


def test_a_lever_arm_along_the_only_axis_of_turning_is_to_be_redone(tmp_path, earlier):
    path = turned_about_z(20.0)
    bag = write_bag(tmp_path / 'bag', carried(path, path.time[-1] + 1.0).raw)
    result = calibrate(bag, earlier, '--rig', earlier, '--only', 'lever_arm', '--json')
    found = verdicts_of(result)['imu1', 'lever arm']
    sigma = load_rig(earlier).imus[1].extrinsics.lever_arm_sigma
    assert (found['grade'], 'all three axes' in found['why']) == ('redo', True)
    # Of the three only that along z is unknown: 1 mm is good, 10 mm no longer usable.
    assert max(sigma[:2]) < 1e-3
    assert sigma[2] > 1e-2


def test_a_hole_is_flagged_and_the_rest_is_used(tmp_path, recording):
    first, second = recording.raw
    row = np.arange(len(second))
    bag = write_bag(tmp_path / 'bag', [first, second.select((row < 4000) | (row >= 6000))])
    found = verdicts_of(calibrate(bag, tmp_path / 'rig.yaml', '--json'))
    missing = found['imu1', 'missing samples']
    assert missing['grade'] == 'redo'
    assert_allclose(missing['size'], 100 * 2000 / len(second), rtol=0.01)  # one sample in 2000
    assert ('imu0', 'missing samples') not in found


def test_bad_rows_are_flagged_and_dropped(tmp_path, recording, good):
    first, second = recording.raw
    rate, stamps = second.angular_rate.copy(), second.stamp_ns.copy()
    rate[50::100] = np.nan  # one in a hundred
    stamps[::200] -= 50_000_000  # and one in two hundred goes back by five periods
    tracks = [first, picture(second, angular_rate=rate, stamp_ns=stamps)]
    bag = write_bag(tmp_path / 'bag', tracks)
    found = verdicts_of(calibrate(bag, tmp_path / 'rig.yaml', '--json'))
    unsound = found['imu1', 'unsound samples']
    assert (unsound['grade'], 'driver' in unsound['why']) == ('usable', True)
    assert_allclose(unsound['size'], 1.5, atol=0.02)  # percent; the first stamp cannot go back
    assert found['imu1', 'missing samples']['grade'] == 'good'  # what was dropped was sent


def test_saturation_in_waving_is_flagged_and_ruins_nothing(tmp_path, recording):
    bag = write_bag(tmp_path / 'bag', [clipped(one, 3.0) for one in recording.raw])
    result = calibrate(bag, tmp_path / 'rig.yaml', '--gravity', GRAVITY, '--json')
    found = verdicts_of(result)
    for name in ('imu0', 'imu1'):
        assert found[name, 'saturated samples']['grade'] == 'usable'
    assert_true_within(load_rig(tmp_path / 'rig.yaml'), recording.rig)


def assert_within(found, sigma, true):
    known = np.asarray(sigma) > 0.0
    assert known.any()
    error = (np.asarray(found) - np.asarray(true))[known] / np.asarray(sigma)[known]
    assert np.abs(error).max() < SIGMAS


def assert_true_within(rig, truth):
    """Compare all that has a sigma with what was simulated."""
    for imu, true in zip(rig.imus, truth.imus, strict=True):
        for triad in ('accelerometer', 'gyroscope'):
            own, drawn = getattr(imu.intrinsics, triad), getattr(true.intrinsics, triad)
            for key in ('misalignment', 'scale'):
                assert_within(getattr(own, key), getattr(own, f'{key}_sigma'), getattr(drawn, key))
    pose, first = rig.imus[1].extrinsics, truth.imus[0].extrinsics
    true = truth.imus[1].extrinsics
    # Bare rigs have the frame of the first IMU as base, and boards in a row are not turned.
    assert_within(pose.lever_arm_b, pose.lever_arm_sigma, true.lever_arm_b - first.lever_arm_b)
    assert_within(2 * np.array(pose.rotation[:3]), pose.rotation_sigma, np.zeros(3))


def test_a_good_recording_gives_the_truth_within_its_sigmas(recording, good):
    assert_true_within(load_rig(good[1]), recording.rig)


def test_every_estimate_has_its_sigma(good):
    for k, imu in enumerate(load_rig(good[1]).imus):
        blocks = [imu.intrinsics.accelerometer, imu.intrinsics.gyroscope, imu.noise]
        blocks += [imu.extrinsics, imu] if k else []
        for block in blocks:
            names = type(block).model_fields
            for name in names:
                if f'{name}_sigma' in names and getattr(block, name) is not None:
                    assert getattr(block, f'{name}_sigma') is not None, name


def test_the_provenance_says_where_the_figures_come_from(good, recording):
    for imu in load_rig(good[1]).imus:
        noted = imu.provenance
        assert noted['bag'] == 'bag'
        assert len(noted['sha256']) == 64
        assert datetime.fromisoformat(noted['date']).tzinfo == UTC
        assert noted['duration_s'] == pytest.approx(recording.truth.time[-1], abs=0.01)
        assert 0.0 < noted['residual_rms'] < 0.005  # [m/s^2] what verdicts call good
        assert noted['version'].startswith('multiimu_ros ')
        assert noted['verdict'] == 'good'


def test_a_good_recording_leaves_nothing_to_complain_of(good):
    output = good[2]
    assert 'good' in output
    for word in ('usable', 'redo', 'note', 'nan', 'e+0'):
        assert word not in output


def test_the_fusion_takes_the_rig(tmp_path, good):
    command = [str(good[0]), '--rig', str(good[1]), '-o', str(tmp_path / 'fused')]
    assert CliRunner().invoke(fuse_app, command, catch_exceptions=False).exit_code == 0


def test_the_same_bag_gives_the_same_rig_bit_for_bit_and_keeps_the_old_file(good, earlier):
    bag, rig, _ = good
    again = earlier.with_name('rig.yaml')
    calibrate(bag, again, '--gravity', GRAVITY)
    assert again.read_bytes() == rig.read_bytes()
    before = earlier.read_bytes()
    result = calibrate(bag, earlier, '--rig', earlier, '--only', 'noise')
    assert earlier.with_name('earlier.yaml.old').read_bytes() == before
    assert 'earlier.yaml.old' in result.output


def test_json_and_report_hold_the_verdicts(tmp_path, good, earlier):
    arguments = ('--rig', earlier, '--only', 'noise', '--json', '--report', tmp_path / 'report')
    content = json.loads(calibrate(good[0], earlier, *arguments).output)
    assert content['verdict'] == 'good'
    quantities = {verdict['quantity'] for verdict in content['verdicts']}
    assert quantities == {'noise of the accelerometer', 'noise of the gyroscope'}
    assert 'noise of the gyroscope' in (tmp_path / 'report' / 'calibration.html').read_text()


@pytest.mark.parametrize('stage', ['lever_arm', 'noise', 'rotation', 'time'])
def test_one_stage_changes_its_own_figures_only(good, earlier, stage):
    old = load_rig(earlier)
    marked = [
        imu.model_copy(
            update={
                'serial': 'kept',
                'time_offset': 2e-5,
                'extrinsics': imu.extrinsics.model_copy(
                    update={'lever_arm': (0.0, -0.02 * k, 0.001)}
                ),
                'noise': imu.noise.model_copy(
                    update={
                        'bias_instability': imu.noise.noise_density,
                        'noise_density': NOMINAL_NOISE.noise_density,
                    }
                ),
            }
        )
        for k, imu in enumerate(old.imus)
    ]
    save_rig(old.model_copy(update={'imus': tuple(marked)}), earlier)
    calibrate(good[0], earlier, '--rig', earlier, '--only', stage)
    own = {
        'lever_arm': {'extrinsics.lever_arm', 'extrinsics.lever_arm_sigma'},
        'rotation': {'extrinsics.rotation', 'extrinsics.rotation_sigma'},
        'noise': {'noise.noise_density', 'noise.noise_density_sigma'},
        'time': {'time_offset', 'time_offset_sigma'},
    }[stage]
    for before, after in zip(marked, load_rig(earlier).imus, strict=True):
        assert leaves(after).keys() == leaves(before).keys()
        changes = {k for k, v in leaves(after).items() if v != leaves(before)[k]}
        assert changes <= own
        assert {k: after.provenance[k] for k in before.provenance} == before.provenance
        assert after.provenance[stage]['bag'] == 'bag'
    assert changes


def leaves(imu):
    """Return the entries of an IMU but for its provenance, as `block.key`."""
    content = imu.model_dump(exclude={'provenance'})
    found = {}
    for key, value in content.items():
        found |= (
            {f'{key}.{k}': v for k, v in value.items()}
            if isinstance(value, dict)
            else {key: value}
        )
    return found


def test_new_biases_do_not_inherit_the_date_of_those_that_a_node_saved(good, earlier):
    old = load_rig(earlier)
    imus = [
        imu.model_copy(
            update={'provenance': imu.provenance | {'biases_saved': '2030-01-01', 'by': 'me'}}
        )
        for imu in old.imus
    ]
    save_rig(old.model_copy(update={'imus': tuple(imus)}), earlier)
    calibrate(good[0], earlier, '--rig', earlier, '--only', 'intrinsics')
    for imu in load_rig(earlier).imus:
        assert 'biases_saved' not in imu.provenance
        assert imu.provenance['by'] == 'me'


def test_latitude_replaces_the_gravity_of_the_rig(good, earlier):
    calibrate(
        good[0], earlier, '--rig', earlier, '--latitude', 59.3, '--height', 30, '--only', 'noise'
    )
    frame = load_rig(earlier).rig
    assert (frame.gravity, frame.latitude, frame.height) == (None, 59.3, 30.0)
    assert frame.gravity_magnitude == normal_gravity(59.3, 30.0)
    calibrate(good[0], earlier, '--rig', earlier, '--gravity', 9.81, '--only', 'noise')
    assert load_rig(earlier).rig.latitude is None


def test_gravity_that_nobody_stated_is_noted(tmp_path, good):
    assert '`--latitude`' in calibrate(good[0], tmp_path / 'rig.yaml').output


def test_groups_name_the_worst_first():
    def verdict(imu, grade, size):
        return Verdict(imu, 'lever arm', '', '', 'mm', grade, f'why {size}', size)

    found = [verdict('a', 'usable', 2.0), verdict('b', 'redo', 11.0), verdict('c', 'redo', 12.0)]
    assert grouped([*found, verdict('d', 'good', 0.1)]) == [
        ('redo', 'lever arm', ['b', 'c'], 'why 12.0'),
        ('usable', 'lever arm', ['a'], 'why 2.0'),
    ]
