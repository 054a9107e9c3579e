"""The whole chain on simulated boards: true covariances, any entrance, and no harm from faults."""

from functools import cache

from blocks import frames_of
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.calibration.sensor_model import calibrate
from multiimu_ros.errors import ConfigError
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.registration.transform import register
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring, row
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

RATE_HZ = 200.0


@cache
def recording(seed=0, duration=12.0, placement=row, motion='hand'):
    """Return a trajectory, what a board recorded on it, and its user's rig file."""
    path = trajectory(motion, duration, seed)
    simulated = simulate(placement(), path, RATE_HZ, seed=seed)
    return path, simulated, calibrated_rig(simulated.rig, seed + 1000)


def stacked(frames, name):
    return np.array([getattr(frame, name) for frame in frames])


def nees(error, covariance):
    """Return the mean over time of e' P^-1 e per dimension."""
    weighted = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.mean(np.sum(error * weighted, axis=1)) / error.shape[1]


def scores(seed):
    """Return the NEES of everything that a frame says, 3 s after the start and on."""
    path, simulated, rig = recording(seed, 40.0)
    frames = frames_of(Pipeline(rig, PipelineConfig()), simulated.raw)
    truth = path.at(1e-9 * (stacked(frames, 'stamp_ns') - simulated.truth_ns[0]))
    R, R_est = (
        Rotation.from_matrix(truth.R_nb),
        Rotation.from_quat(stacked(frames, 'orientation')),
    )
    # No rig knows its heading: the odometry frame is the truth's, turned by the first one.
    heading = Rotation.from_rotvec([0.0, 0.0, (R[0] * R_est[0].inv()).as_rotvec()[2]]).inv()
    R_odom = Rotation.from_quat(stacked(frames, 'odom_orientation'))
    pose_P, twist_P = stacked(frames, 'pose_covariance'), stacked(frames, 'twist_covariance')
    moved = heading.apply(truth.position_n - truth.position_n[0])
    pairs = {
        'rate': (stacked(frames, 'angular_rate') - truth.angular_rate_b,
                 stacked(frames, 'angular_rate_covariance')),
        'force': (stacked(frames, 'specific_force') - truth.specific_force_b,
                  stacked(frames, 'specific_force_covariance')),
        'attitude': ((heading * R * R_est.inv()).as_rotvec(),
                     stacked(frames, 'orientation_covariance')),
        'odom attitude': ((heading * R * R_odom.inv()).as_rotvec(), pose_P[:, 3:, 3:]),
        'position': (moved - stacked(frames, 'position_n'), pose_P[:, :3, :3]),
        'velocity': (R.inv().apply(truth.velocity_n) - stacked(frames, 'velocity_b'),
                     twist_P[:, :3, :3]),
    }  # fmt: skip
    return {name: nees(e[600:], P[600:]) for name, (e, P) in pairs.items()}


@pytest.mark.long
@pytest.mark.slow
def test_every_covariance_is_true():
    table = [scores(seed) for seed in range(20)]
    mean = {name: np.mean([row[name] for row in table]) for name in table[0]}
    # The promise of the package; 20 runs leave a standard error of 0.1 on the slowest, position.
    assert all(0.8 < value < 1.2 for value in mean.values()), mean


@pytest.mark.slow  # where nothing is compiled
@pytest.mark.parametrize('stage', ['calibrated', 'registered'])
def test_every_entrance_leads_to_the_same_frames(stage):
    _, simulated, rig = recording()
    streams = [
        calibrate(s, imu.intrinsics) for s, imu in zip(simulated.raw, rig.imus, strict=True)
    ]
    if stage == 'registered':
        streams = [register(s, imu) for s, imu in zip(streams, rig.imus, strict=True)]
    frames = frames_of(Pipeline(rig, PipelineConfig(input=stage)), streams)
    reference = frames_of(Pipeline(rig, PipelineConfig()), simulated.raw)
    assert len(frames) == len(reference) > 0
    for ours, theirs in zip(frames, reference, strict=True):
        assert ours.stamp_ns == theirs.stamp_ns
        # The maps are one product or two: rounding only, which the filters carry on.
        assert_allclose(ours.record, theirs.record, rtol=1e-9, atol=1e-9)


def test_every_scan_of_the_reference_becomes_a_frame():
    _, simulated, rig = recording(placement=ring)
    pipeline = Pipeline(rig, PipelineConfig())
    frames = frames_of(pipeline, simulated.raw)
    # The last scan waits for samples that never come, except the reference's own.
    assert len(frames) >= len(simulated.raw[0]) - 1
    assert np.isin(stacked(frames, 'stamp_ns'), simulated.raw[0].stamp_ns).all()
    assert pipeline.empty_scans == 0


@pytest.mark.slow  # where nothing is compiled
def test_two_runs_are_bit_identical():
    _, simulated, rig = recording()
    once, twice = (frames_of(Pipeline(rig, PipelineConfig()), simulated.raw) for _ in range(2))
    assert np.array_equal(stacked(once, 'record'), stacked(twice, 'record'))


@pytest.mark.slow  # where nothing is compiled
def test_a_reset_starts_anew():
    _, simulated, rig = recording()
    pipeline = Pipeline(rig, PipelineConfig())
    once = frames_of(pipeline, simulated.raw)
    pipeline.reset()
    twice = frames_of(pipeline, simulated.raw)
    assert np.array_equal(stacked(once, 'record'), stacked(twice, 'record'))


def test_an_imu_that_dies_is_named_and_leaves_no_step():
    _, simulated, rig = recording(placement=ring, motion='static')
    dies_at = simulated.raw[0].stamp_ns[1200]
    streams = list(simulated.raw)
    for dead in (0, 5):  # the reference of the clock among them
        streams[dead] = streams[dead].select(streams[dead].stamp_ns < dies_at)
    pipeline = Pipeline(rig, PipelineConfig())
    frames = frames_of(pipeline, streams)
    states = [health.state for health in pipeline.health()]
    assert states == ['absent', 'ok', 'ok', 'ok', 'ok', 'absent', 'ok', 'ok']
    assert np.diff(stacked(frames, 'stamp_ns')).max() <= 1.2e9 / RATE_HZ
    for name in ('angular_rate', 'specific_force'):
        signal = stacked(frames, name)
        step = signal[1200:1600].mean(axis=0) - signal[800:1200].mean(axis=0)
        # Two means of 400: standard error sigma sqrt(2 / 400), five of them.
        assert (np.abs(step) < 5 * signal.std(axis=0) * np.sqrt(2 / 400)).all()


def test_no_frame_ever_holds_a_nan():
    _, simulated, rig = recording()
    rng = np.random.default_rng(5)
    streams = []
    for stream in simulated.raw:
        force = stream.specific_force.copy()
        force[rng.random(len(force)) < 0.2] = np.nan
        streams.append(type(stream)(stream.stamp_ns, stream.angular_rate, force))
    pipeline = Pipeline(rig, PipelineConfig())
    frames = frames_of(pipeline, streams)
    assert len(frames) > 1000
    assert np.isfinite(stacked(frames, 'record')).all()
    assert all(health.rejected > 300 for health in pipeline.health())


def test_when_time_jumps_back_attitude_and_biases_stay_and_the_motion_starts_anew():
    _, simulated, rig = recording()
    pipeline = Pipeline(rig, PipelineConfig())
    last = frames_of(pipeline, simulated.raw)[-1]
    biases, *_ = pipeline.biases()
    first = frames_of(pipeline, [stream.select(slice(0, 3)) for stream in simulated.raw])[0]
    assert pipeline.time_jumps == 1
    assert (first.position_n == 0.0).all()
    turned = Rotation.from_quat(first.orientation) * Rotation.from_quat(last.orientation).inv()
    assert turned.magnitude() < np.deg2rad(5.0)
    assert_allclose(pipeline.biases()[0], biases, atol=0.01)


def test_the_biases_that_a_rest_shows_are_those_of_the_gyroscopes():
    _, simulated, _ = recording(motion='static', duration=20.0)
    pipeline = Pipeline(simulated.rig.model_copy(update={'imus': tuple(
        imu.model_copy(update={'intrinsics': None}) for imu in simulated.rig.imus
    )}), PipelineConfig())  # fmt: skip
    frames_of(pipeline, simulated.raw)
    biases, variance, rest = pipeline.biases()
    for imu, bias, sigma in zip(simulated.rig.imus, biases, np.sqrt(variance), strict=True):
        true = np.array(imu.intrinsics.gyroscope.bias)
        force = imu.intrinsics.gyroscope.g_sensitivity
        shown = true + np.array(force) @ [0.0, 0.0, 9.8]
        # In the base frame, which the IMUs of a row share; flicker of 4e-5 rad/s on top.
        assert_allclose(bias[:3], shown, atol=1e-4)
        # An unknown g-sensitivity makes 9e-5 of the force: 9.8, as nominal accelerometers read it.
        assert sigma[:3] == pytest.approx(8.8e-4, rel=0.05)
    # A tenth of a second fills the detector's window, half a second is rest, 0.25 s confirm it.
    assert rest.seconds == pytest.approx(20.0 - 0.85, abs=0.1)
    assert rest.last_ns == pytest.approx(simulated.truth_ns[-1], abs=1e7)


def test_a_disabled_imu_has_no_weight():
    _, simulated, rig = recording()
    pipeline = Pipeline(rig, PipelineConfig())
    pipeline.set_enabled(1, enabled=False)
    frames = frames_of(pipeline, simulated.raw)
    assert frames[-1].weights[1] == 0.0
    assert_allclose(frames[-1].weights.sum(), 1.0, rtol=1e-12)
    assert pipeline.health()[1].state == 'disabled'


@pytest.mark.parametrize('name', ['input', 'profile', 'local', 'master'])
def test_an_unknown_choice_is_refused_and_the_known_ones_are_named(name):
    with pytest.raises(ConfigError, match=f"`{name}` must be one of '.*, got 'best'"):
        PipelineConfig(**{name: 'best'})
