"""Every filter, saturation, learnt noise, prefilters and virtual IMU through the whole chain."""

from dataclasses import replace
from functools import cache
from itertools import product
from typing import get_args

from blocks import frames_of
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.fusion.local_filters import Local
from multiimu_ros.fusion.masters import Master, Reset
from multiimu_ros.fusion.prefilters import ScanPrefilter
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.report.tracks import in_order
from multiimu_ros.rig import Range
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.paths import through
from multiimu_ros.simulation.placements import placed, ring, row
from multiimu_ros.simulation.recording import simulate, Timing
from multiimu_ros.simulation.trajectories import trajectory

pytestmark = pytest.mark.slow  # where nothing is compiled

RATE_HZ = 200.0
MOVING = 9.0  # [s] the least that a hand moves in: the second half of it
SETTLED = 600  # scans: alignment and the rest before the first motion
LIMIT = 8.7  # [rad/s] 500 deg/s


def one_side(count, radius=0.08):
    """Return IMUs that lie to one side of the base origin."""
    angle = np.linspace(-0.6, 0.6, count) if count > 1 else np.zeros(1)
    arms = np.column_stack(
        [radius * np.cos(angle), radius * np.sin(angle), 0.01 * np.arange(count)]
    )
    return placed('side', arms, [Rotation.identity()] * count)


@cache
def recording(placement, *size, seed=1, duration=12.0, motion='hand', dropout=0.0):
    """Return a trajectory, what a board recorded on it, and its user's rig file."""
    path = trajectory(motion, duration, seed)
    timing = Timing(dropout=dropout)
    simulated = simulate(placement(*size), path, RATE_HZ, seed=seed, timing=timing)
    return path, simulated, calibrated_rig(simulated.rig, seed + 1000)


def run(rig, streams, **settings):
    pipeline = Pipeline(rig, PipelineConfig(**settings))
    return pipeline, frames_of(pipeline, streams)


def stacked(frames, name):
    return np.array([getattr(frame, name) for frame in frames])


def chi_square(error, covariance):
    """Return e' P^-1 e per dimension (N,)."""
    weighted = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.sum(error * weighted, axis=1) / error.shape[1]


def errors(path, simulated, frames, point=(0.0, 0.0, 0.0)):
    """Return the errors (N, 3) of rate and force, and both normalised and squared (N,)."""
    truth = path.at(1e-9 * (stacked(frames, 'stamp_ns') - simulated.truth_ns[0]))
    rate = stacked(frames, 'angular_rate') - truth.angular_rate_b
    force = stacked(frames, 'specific_force') - truth.specific_force_at(np.array(point))
    rate_chi = chi_square(rate, stacked(frames, 'angular_rate_covariance'))
    return rate, force, rate_chi, chi_square(force, stacked(frames, 'specific_force_covariance'))


def rms(error):
    return np.sqrt(np.mean(error**2))


@cache
def error_of_the_default():
    path, simulated, rig = recording(row, 3, duration=MOVING)
    rate, force, *_ = errors(path, simulated, run(rig, simulated.raw)[1])
    return rms(rate[100:]), rms(force[100:])


# Largest ratio of the error to that of kf + carlson.  Like IMUs: all means are the same.
ALIKE = 1.005
# `adaptive` smooths, by the means of its innovations; it may only be better.
# 1000 particles of three filters: a resampled cloud adds some part of its variance, filters.md.
PARTICLES = 1.35
# The printed recursion counts its prior again and lags; docs/derivations/filters.md.
PRINTED = np.inf


def combinations():
    """Return each local filter with each master; where neither is the default, among the long."""
    rows = []
    for local, master in product(get_args(Local), get_args(Master)):
        default = PipelineConfig.local == local or PipelineConfig.master == master
        rows.append(pytest.param(local, master, marks=() if default else pytest.mark.long))
    return rows


@pytest.mark.parametrize(('local', 'master'), combinations())
def test_every_filter_runs_through_the_chain_and_is_as_good_as_theory_says(local, master):
    path, simulated, rig = recording(row, 3, duration=MOVING)
    _, frames = run(rig, simulated.raw, local=local, master=master)
    assert len(frames) == len(simulated.raw[0])
    assert np.isfinite(stacked(frames, 'record')).all()
    rate, force, *_ = errors(path, simulated, frames)
    limit = PRINTED if master == 'mfkf_printed' else PARTICLES if local == 'particle' else ALIKE
    for error, default in zip((rate, force), error_of_the_default(), strict=True):
        assert rms(error[100:]) < limit * default


@pytest.mark.parametrize('reset', get_args(Reset))
def test_every_reset_runs_with_a_fusion_every_ten_scans(reset):
    path, simulated, rig = recording(row, 3, duration=MOVING)
    _, frames = run(rig, simulated.raw, reset=reset, fuse_every=10)
    assert np.isfinite(stacked(frames, 'record')).all()
    rate, force, *_ = errors(path, simulated, frames)
    # The first scans of a run differ: shares hold for ten scans, and a scan without some IMU
    # is then missing its part.  Seen: 1.02 and 1.07.
    for error, default in zip((rate, force), error_of_the_default(), strict=True):
        assert rms(error[100:]) < 1.1 * default


@pytest.mark.parametrize(
    'settings', [{}, {'local': 'ukf', 'master': 'centralised'}, {'master': 'scaat'}]
)
def test_a_block_gives_bit_for_bit_the_frames_of_single_pushes(settings):
    _, simulated, rig = recording(row, 3, duration=MOVING)
    _, frames = run(rig, simulated.raw, **settings)
    pipeline = Pipeline(rig, PipelineConfig(**settings))
    one_by_one = zip(*(column.tolist() for column in in_order(simulated.raw)), strict=True)
    pushed = [frame for reading in one_by_one for frame in pipeline.push(*reading)]
    assert np.array_equal(stacked(frames, 'record'), stacked(pushed, 'record'))
    again = run(rig, simulated.raw, **settings)[1]
    assert np.array_equal(stacked(frames, 'record'), stacked(again, 'record'))


def nees(placement, count, motion, seeds=3):
    """Return the mean normalised squared error of rate and force over some boards."""
    scores = []
    for seed in range(seeds):
        path, simulated, rig = recording(placement, count, seed=seed, duration=14.0, motion=motion)
        _, _, rate, force = errors(path, simulated, run(rig, simulated.raw)[1])
        scores.append((rate[SETTLED:].mean(), force[SETTLED:].mean()))
    return np.mean(scores, axis=0)


# 3 boards of 2200 scans, 3 axes, interpolated (every second is independent): standard error
# sqrt(2 / 9900) = 1.4 %; the rate's bias, one draw per axis and board, adds another percent.
@pytest.mark.parametrize(('motion', 'tolerance'), [('static', 0.075), ('hand', 0.1)])
@pytest.mark.parametrize('count', [1, 3, 8])
@pytest.mark.parametrize('placement', [ring, one_side])
def test_variances_are_honest_with_the_guard_on(placement, count, motion, tolerance):
    rate, force = nees(placement, count, motion)
    assert rate == pytest.approx(1.0, abs=tolerance)
    assert force == pytest.approx(1.0, abs=tolerance)


@pytest.mark.parametrize('point', [(0.1, 0.0, 0.0), (0.05, -0.06, 0.06)])
def test_a_virtual_imu_feels_what_its_point_does_and_its_odometry_follows_it(point):
    force_chi, position_chi = [], []
    for seed in range(3):
        path, simulated, rig = recording(ring, 8, 0.04, seed=seed, duration=14.0)
        _, frames = run(rig, simulated.raw, virtual_imu=point)
        force_chi.append(errors(path, simulated, frames, point)[3][SETTLED:].mean())
        truth = path.at(1e-9 * (stacked(frames, 'stamp_ns') - simulated.truth_ns[0]))
        where = truth.position_n + truth.R_nb @ np.array(point)
        start = Rotation.from_matrix(truth.R_nb[0])
        turned = start * Rotation.from_quat(frames[0].orientation).inv()
        heading = Rotation.from_rotvec([0.0, 0.0, turned.as_rotvec()[2]]).inv()
        error = heading.apply(where - where[0]) - stacked(frames, 'position_n')
        covariance = stacked(frames, 'pose_covariance')[:, :3, :3]
        position_chi.append(chi_square(error[SETTLED:], covariance[SETTLED:]).mean())
    assert np.mean(force_chi) == pytest.approx(1.0, abs=0.1)
    # A drift is one draw per bout, axis and board, 6 of each: standard error sqrt(2 / 18) = 0.33.
    assert np.mean(position_chi) < 1.0 + 3 * 0.33


@cache
def spun(seed):
    """Return a path with three turns of up to 15 rad/s, and a board whose gyroscopes clip."""
    turn = np.random.default_rng(seed).uniform(2.4, 3.0) * np.pi
    path = through([0.0, 14.0])
    for k, start in enumerate((5.0, 8.0, 11.0)):
        path += through([start, start + 1.2], yaw=[0.0, turn * (-1) ** k])
    path = Trajectory(path + trajectory('hand', 14.0, seed).path, 14.0)
    clipping = replace(BMI160, gyroscope=replace(BMI160.gyroscope, limit=LIMIT))
    simulated = simulate(ring(8), path, RATE_HZ, clipping, seed=seed)
    return path, simulated, calibrated_rig(simulated.rig, seed + 1000)


def with_range(rig, **limits):
    update = {'range': Range(**limits)}
    return rig.model_copy(update={'imus': tuple(i.model_copy(update=update) for i in rig.imus)})


def attitude_error(path, simulated, frames):
    """Return the angle between attitude and truth at the end, aligned before the turns [deg]."""
    truth = path.at(1e-9 * (stacked(frames, 'stamp_ns') - simulated.truth_ns[0]))
    R = Rotation.from_quat(stacked(frames, 'orientation'))
    lead = Rotation.from_matrix(truth.R_nb) * R.inv()
    return np.rad2deg((lead[SETTLED].inv() * lead[-1]).magnitude())


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_a_turn_beyond_the_gyroscopes_is_bridged_honestly_and_without_a_jump(seed):
    path, simulated, rig = spun(seed)
    _, frames = run(with_range(rig, gyroscope=LIMIT), simulated.raw)
    rate, _, chi, _ = errors(path, simulated, frames)
    truth = path.at(1e-9 * (stacked(frames, 'stamp_ns') - simulated.truth_ns[0]))
    beyond = (np.abs(truth.angular_rate_b) > LIMIT).any(axis=1)
    near = np.convolve(beyond, np.ones(21), 'same') > 0
    assert beyond.sum() > 100
    # Errors that last count half a second: 0.6 to 0.8, on the safe side of 1; array_geometry.md.
    assert 0.4 < chi[beyond].mean() < 1.2
    assert 0.8 < chi[near & ~beyond].mean() < 1.25
    assert rms(rate[beyond]) < 0.005  # clipped 1.1 to 1.9, below
    variance = np.diagonal(stacked(frames, 'angular_rate_covariance'), axis1=1, axis2=2)
    steps = np.abs(np.diff(rate, axis=0)) / np.sqrt(variance[1:] + variance[:-1])
    assert steps[near[1:]].max() < 4.0  # of some 1000 draws the largest is 3.5
    assert variance[beyond].max() > 20 * variance[SETTLED:][~near[SETTLED:]].max()
    # Integrated over a gap of half a second, 4 mrad/s that lasts is 0.1 deg; three gaps.
    assert attitude_error(path, simulated, frames) < 0.4


def test_without_a_range_in_the_rig_file_a_clipped_rate_passes_for_the_truth():
    path, simulated, rig = spun(0)
    _, frames = run(rig, simulated.raw)
    rate, *_ = errors(path, simulated, frames)
    truth = path.at(1e-9 * (stacked(frames, 'stamp_ns') - simulated.truth_ns[0]))
    beyond = (np.abs(truth.angular_rate_b) > LIMIT).any(axis=1)
    assert rms(rate[beyond]) > 1.0  # up to 6.6 rad/s are cut off
    assert attitude_error(path, simulated, frames) > 30.0


IDEAL = np.array([6.0, 6.0, 1.0]) / 13.0  # 1 / variance of 1, 1 and 2.45 sigma


@cache
def noisy(seed, which):
    """Return a recording in which one IMU has 2.45 times the noise that its rig file says."""
    path, simulated, rig = recording(row, 3, seed=seed, duration=40.0)
    rng, raw = np.random.default_rng(seed + 77), list(simulated.raw)
    if which is not None:
        stream = raw[which]
        own = np.sqrt((2.45**2 - 1.0) * RATE_HZ) * rng.standard_normal((2, len(stream), 3))
        own[0] *= BMI160.gyroscope.noise_density
        own[1] *= BMI160.accelerometer.noise_density
        raw[which] = type(stream)(
            stream.stamp_ns, stream.angular_rate + own[0], stream.specific_force + own[1]
        )
    return path, simulated, rig, raw


def white(error):
    """Return the rms of what second differences over 3 scans leave: biases cancel, noise stays."""
    return rms(error[6:] - 2 * error[3:-3] + error[:-6]) / np.sqrt(6.0)


@pytest.mark.long
@pytest.mark.parametrize('calibrated', [True, False])
def test_noise_that_the_rig_file_does_not_know_is_learnt_in_motion(calibrated):
    found = {}
    for which in (None, 0, 1, 2):
        path, simulated, rig, raw = noisy(0, which)
        if not calibrated:
            plain = (i.model_copy(update={'intrinsics': None}) for i in simulated.rig.imus)
            rig = simulated.rig.model_copy(update={'imus': tuple(plain)})
        _, frames = run(rig, raw, noise='learnt')
        rate, force, *_ = errors(path, simulated, frames)
        found[which] = np.array([white(rate[4000:]), white(force[4000:])])
        if which is not None:
            ideal = IDEAL if which == 2 else np.roll(IDEAL, which + 1)
            # R of one axis to 4 %, weights are of three.
            np.testing.assert_allclose(frames[6000].weights, ideal, rtol=0.1)
    ratio = np.mean([found[which] / found[None] for which in (0, 1, 2)])
    # sqrt(3 / (2 + 1/6)) = 1.18 with perfect weights; a mean would have 1.6.
    assert ratio <= 1.2


@pytest.mark.parametrize('kind', ['low_pass', 'complementary', 'wavelet'])
def test_a_prefilter_lags_as_it_says_and_bears_dropouts(kind):
    if kind == 'wavelet':
        pytest.importorskip('pywt')
    path, simulated, rig = recording(ring, 3, 0.001, duration=14.0, dropout=0.02)
    _, frames = run(rig, simulated.raw, prefilter=kind, cutoff_hz=20.0)
    _, plain = run(rig, simulated.raw)
    assert np.isfinite(stacked(frames, 'record')).all()
    assert len(frames) == len(plain)  # from the first scan on, and in spite of restarts
    time = 1e-9 * (stacked(frames, 'stamp_ns') - simulated.truth_ns[0])
    moving = (time > 4.0) & (time < 12.0)
    rate = stacked(frames, 'angular_rate')
    lags = np.arange(-0.01, 0.06, 0.001)
    misfit = [rms(rate[moving] - path.at(time[moving] - s).angular_rate_b) for s in lags]
    stated = ScanPrefilter(kind, 3, cutoff_hz=20.0, rate_hz=RATE_HZ).lag_s
    assert lags[np.argmin(misfit)] == pytest.approx(stated, abs=0.0021)  # steps of 1 ms
    noise = rate[200:700].std(axis=0) / stacked(plain, 'angular_rate')[200:700].std(axis=0)
    # (1 - alpha) / (1 + alpha) of white noise at 20 Hz: 0.49, and more of interpolated; the
    # complementary filter's mean of all keeps what fusing them has.
    assert (noise < 0.7).all() if kind != 'complementary' else (noise < 1.01).all()
