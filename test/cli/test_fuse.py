"""`multiimu fuse` on a small recording: what it writes, twice the same, and what it refuses."""

import json

import numpy as np
from numpy.testing import assert_array_equal
import pytest
from rosbags.highlevel import AnyReader
from rosbags.typesys import get_typestore, Stores
from typer.testing import CliRunner

from multiimu_ros.bags import BagWriter, list_topics, read_imus
from multiimu_ros.bags.cdr import encode_imus
from multiimu_ros.cli.fuse import app
from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion.masters import FilterDivergedError
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.rig import load_rig, Noise, parse_rig, PerTriad, save_rig
from multiimu_ros.samples import ImuSamples

N, IMUS = 300, 2
START_NS = 10**18


@pytest.fixture
def recording(tmp_path, rng):
    """Write a rig at rest and its bag; return their paths and the samples of each IMU."""
    imus = [{'name': f'imu{k}', 'frame_id': f'imu{k}_link'} for k in range(IMUS)]
    rig = parse_rig({'version': 1, 'rig': {'name': 'pair'}, 'imus': imus}, 'test')
    save_rig(rig, tmp_path / 'rig.yaml')
    stamp_ns = START_NS + 5_000_000 * np.arange(N)
    noise = 0.001 * rng.standard_normal((IMUS, 2, N, 3))  # below that of the data sheet
    samples = [ImuSamples(stamp_ns, n[0], n[1] + [0.0, 0.0, 9.81]) for n in noise]
    write(tmp_path / 'bag', samples)
    return tmp_path / 'bag', tmp_path / 'rig.yaml', samples


def write(path, samples):
    """Write one topic per IMU, scan by scan."""
    with BagWriter(path) as bag:
        for k in range(len(samples)):
            bag.add_topic(f'/imu{k}/data_raw', 'sensor_msgs/msg/Imu')
        rows = zip(*(encode_imus(f'imu{k}_link', s) for k, s in enumerate(samples)), strict=True)
        for stamp_ns, scan in zip(samples[0].stamp_ns.tolist(), rows, strict=True):
            for k, data in enumerate(scan):
                bag.write(f'/imu{k}/data_raw', stamp_ns, data)


def fuse(bag, rig, output, *arguments):
    command = [str(bag), '--rig', str(rig), '-o', str(output), *arguments]
    return CliRunner().invoke(app, command, catch_exceptions=False)


def messages(path, topic):
    """Return the messages of a topic as another reader sees them."""
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        wanted = [c for c in reader.connections if c.topic == topic]
        return [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(wanted)]


def test_the_bag_holds_what_the_pipeline_says(tmp_path, recording):
    bag, rig, samples = recording
    assert fuse(bag, rig, tmp_path / 'out').exit_code == 0
    pipeline = Pipeline(load_rig(rig), PipelineConfig())
    frames = []
    for row in range(N):
        for k in range(IMUS):
            track = samples[k]
            values = [*track.angular_rate[row], *track.specific_force[row]]
            frames += pipeline.push(k, int(track.stamp_ns[row]), values)
    imus, poses = (messages(tmp_path / 'out', topic) for topic in ('/imu/data', '/odom'))
    assert len(imus) == len(poses) == len(frames) >= N - 1
    last, imu, odom = frames[-1], imus[-1], poses[-1]
    stamp = imu.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == last.stamp_ns  # of the measurement
    assert (imu.header.frame_id, odom.child_frame_id) == ('base_link', 'base_link')
    assert odom.header.frame_id == 'odom'
    w, p = imu.angular_velocity, odom.pose.pose.position
    assert_array_equal([w.x, w.y, w.z], last.angular_rate)
    assert_array_equal([p.x, p.y, p.z], last.position_n)
    assert_array_equal(imu.orientation_covariance, last.orientation_covariance.ravel())
    assert_array_equal(odom.twist.covariance, last.twist_covariance.ravel())


def test_the_same_bag_gives_the_same_bytes_twice(tmp_path, recording, monkeypatch):
    monkeypatch.setattr('multiimu_ros.cli.fuse.BLOCK', 64)  # several, the last one partly filled
    bag, rig, _ = recording
    for place in ('first', 'second'):
        assert fuse(bag, rig, tmp_path / place / 'out').exit_code == 0
    first, second = ((tmp_path / p / 'out' / 'out.mcap').read_bytes() for p in ('first', 'second'))
    assert first == second


def test_a_missing_imu_shrinks_the_fused_set(tmp_path, recording):
    _, rig, samples = recording
    write(tmp_path / 'one', samples[:1])
    answer = fuse(tmp_path / 'one', rig, tmp_path / 'out', '--json')
    summary = json.loads(answer.stdout)
    assert summary['frames'] > 0.5 * N  # the start waits for the other one
    assert summary['imus'][1]['received'] == 0
    assert summary['still_share'] > 0.5


def test_sqlite_is_written_where_it_is_wanted(tmp_path, recording):
    bag, rig, _ = recording
    fuse(bag, rig, tmp_path / 'out', '--storage', 'sqlite3', '--topics', 'imu1/data_raw')
    assert (tmp_path / 'out' / 'out.db3').exists()
    assert {topic.name for topic in list_topics(tmp_path / 'out')} == {'/imu/data', '/odom'}
    assert len(read_imus(tmp_path / 'out', ['/imu/data']).order) > 0.5 * N


def test_frames_that_are_not_finite_are_not_written(tmp_path, recording, monkeypatch):
    bag, rig, _ = recording
    push_block = Pipeline.push_block

    def spoilt(pipeline, *block):
        for frame in push_block(pipeline, *block):
            frame.record[0] = np.nan
            yield frame

    monkeypatch.setattr(Pipeline, 'push_block', spoilt)
    fuse(bag, rig, tmp_path / 'out')
    assert [topic.count for topic in list_topics(tmp_path / 'out')] == [0, 0]


def test_a_failure_leaves_no_half_written_bag(tmp_path, recording, monkeypatch):
    bag, rig, _ = recording

    def break_off(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(Pipeline, 'push_block', break_off)
    assert fuse(bag, rig, tmp_path / 'out').exit_code != 0
    assert not (tmp_path / 'out').exists()


def test_a_filter_that_diverges_says_so_and_leaves_no_bag(tmp_path, recording):
    bag, path, _ = recording
    rig = load_rig(path)
    noise = [
        Noise(noise_density=PerTriad(gyroscope=[N] * 3, accelerometer=[10 * N] * 3))
        for N in (0.01, 0.02)  # large and unlike, so that no process noise hides it
    ]
    imus = [imu.model_copy(update={'noise': n}) for imu, n in zip(rig.imus, noise, strict=True)]
    save_rig(rig.model_copy(update={'imus': tuple(imus)}), path)
    with pytest.raises(FilterDivergedError, match=r'mfkf_printed has diverged after \d+ scans'):
        fuse(bag, path, tmp_path / 'out', '--master', 'mfkf_printed', '--profile', 'vehicle')
    assert not (tmp_path / 'out').exists()


def test_the_virtual_imu_has_a_frame_of_its_own(tmp_path, recording):
    bag, rig, _ = recording
    where = ['--virtual-imu', '0.1', '0', '0.02', '--virtual-imu-frame', 'tip']
    assert fuse(bag, rig, tmp_path / 'out', *where).exit_code == 0
    imus, poses = (messages(tmp_path / 'out', topic) for topic in ('/imu/data', '/odom'))
    assert {imu.header.frame_id for imu in imus} == {'tip'}
    assert {(pose.header.frame_id, pose.child_frame_id) for pose in poses} == {('odom', 'tip')}


@pytest.mark.parametrize(
    ('arguments', 'complaint'),
    [
        (['--profile', 'boat'], "`profile` must be one of 'hand', 'foot', 'vehicle', got 'boat'"),
        (['--local', 'lqr'], '`local` must be one of'),
        (['--master', 'average', '--reset', 'none'], '`reset` is a setting of the master carlson'),
        (['--master', 'scaat', '--local', 'ukf'], 'is one filter for all samples'),
        (['--fuse-every', '0'], '`fuse_every` must be positive, got 0'),
        (['--virtual-imu', '0', 'nan', '0'], '`virtual_imu` must be three finite numbers'),
        (
            ['--virtual-imu', '0', '0', '0.1'],
            '`virtual_imu_frame` must name the frame of the point',
        ),
        (['--topics', '/x'], '`/x` must fit one Imu topic'),
        (['--storage', 'csv'], '`storage` must be mcap or sqlite3'),
    ],
)
def test_wrong_options_are_refused_before_anything_is_written(
    tmp_path, recording, arguments, complaint
):
    bag, rig, _ = recording
    with pytest.raises(ConfigError, match=complaint):
        fuse(bag, rig, tmp_path / 'out', *arguments)
    assert not (tmp_path / 'out').exists()


def test_an_existing_bag_is_never_touched(tmp_path, recording):
    bag, rig, _ = recording
    with pytest.raises(ConfigError, match='exists already'):
        fuse(bag, rig, bag)
    assert len(read_imus(bag, ['/imu0/data_raw']).order) == N
