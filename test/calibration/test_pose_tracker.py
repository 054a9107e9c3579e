"""Poses of simulated and real recordings are found, whatever the unit and however they come."""

from hypothesis import given, strategies as st
import kth
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.calibration.pose_tracker import PoseTracker
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.placements import row
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

RATE_HZ = 200


def tracked(*parts):
    tracker = PoseTracker()
    for part in parts:
        tracker.push(part)
    return tracker.view()


def recorded(motion, duration):
    return simulate(row(1), trajectory(motion, duration), float(RATE_HZ)).raw[0]


@pytest.fixture(scope='module')
def poses():
    """Return 120 s: a rest, 10 poses, waving, the last pose of all."""
    return recorded('calibration', 120.0)


def scaled(samples, rate, force):
    return ImuSamples(
        samples.stamp_ns, rate * samples.angular_rate, force * samples.specific_force
    )


def turned_about(axis, angle, rng, *, rest=2.0, turn=1.0):
    """Return a sensor that rests, is turned at constant rate, and rests again."""
    time = np.arange(round((2 * rest + turn) * RATE_HZ)) / RATE_HZ
    moved = np.clip((time - rest) / turn, 0.0, 1.0) * angle
    rate = np.where((time >= rest) & (time < rest + turn), angle / turn, 0.0)
    y, z = -np.sin(moved), np.cos(moved)
    force = (
        9.81 * np.stack([0 * z, -y, z], axis=1)
        if axis == 0
        else np.stack([0 * z, 0 * z, 9.81 + 0 * z], axis=1)
    )
    noise = [0.002, 0.02] * rng.standard_normal((len(time), 3, 2))
    stamp_ns = (time * NANOSECONDS).astype(np.int64) + NANOSECONDS
    rates = np.outer(rate, np.eye(3)[axis])
    return ImuSamples(stamp_ns, rates + noise[..., 0], force + noise[..., 1])


def test_every_pose_of_a_calibration_is_found(poses):
    rests = tracked(poses).rests
    # 120 s: rest 6, waving 24, so (120 - 30) // 7 = 12 poses, all distinct, and the first rest.
    assert rests.is_new.sum() == 13
    assert rests.duration_s[0] == pytest.approx(6.0, abs=0.3)  # bins, and a slow start
    # A move of 3 s starts and ends so softly that a third of a second at either end is still.
    assert_allclose(rests.duration_s[1:12], 4.35, atol=0.35)


@given(rate=st.floats(1e-4, 1e4), force=st.floats(1e-4, 1e4))
def test_rests_do_not_depend_on_the_units(rate, force):
    samples = turned_about(0, 1.0, np.random.default_rng(1))
    plain, other = tracked(samples), tracked(scaled(samples, rate, force))
    assert other.still.tolist() == plain.still.tolist()
    assert_allclose(other.rests.turned[1], rate * plain.rests.turned[1], rtol=1e-9)  # rounding


@given(seed=st.integers(0, 2**32 - 1))
def test_what_is_known_does_not_depend_on_how_the_samples_came(seed):
    samples = turned_about(0, 1.0, np.random.default_rng(2))
    cuts = np.sort(np.random.default_rng(seed).integers(0, len(samples), 7))
    parts = [samples.select(slice(a, b)) for a, b in zip([0, *cuts], [*cuts, None], strict=True)]
    whole, pieces = tracked(samples), tracked(*parts)
    assert pieces.still.tolist() == whole.still.tolist()
    # Sums in another order: rounding only.
    assert_allclose(pieces.rests.mean_force, whole.rests.mean_force, rtol=1e-12, atol=1e-12)
    assert_allclose(pieces.rests.turned[1], whole.rests.turned[1], rtol=1e-9, atol=1e-9)


def test_the_turn_between_two_poses_is_the_integral_of_the_rate(rng):
    samples = turned_about(0, -1.2, rng)
    samples.angular_rate[:] += [0.05, -0.03, 0.02]  # the bias of a cheap gyroscope
    motion = tracked(samples)
    # Half a step at the end of the turn lies within the rest: 1.2 rad/s / 200 Hz / 2 = 3 mrad;
    # and noise of 600 samples at most, .002 rad/s * sqrt(600) / 200 Hz = .25 mrad; four.
    assert_allclose(motion.rests.turned[1], [-1.2, 0.0, 0.0], atol=4e-3)
    assert_allclose(motion.carried_up()[1], motion.rests.up_s[1], atol=5e-3)  # these, and 1 mrad


def test_a_wrong_unit_of_the_rate_does_not_carry_gravity_along(rng):
    motion = tracked(scaled(turned_about(0, 1.0, rng), np.rad2deg(1.0), 1.0))
    right = motion.carried_up(np.deg2rad(1.0))[1] @ motion.rests.up_s[1]
    wrong = motion.carried_up(1.0)[1] @ motion.rests.up_s[1]
    assert right > np.cos(0.01)  # noise alone
    assert wrong < np.cos(0.3)  # 57.3 rad about one axis are 0.75 rad beside a whole turn


def test_turning_about_the_vertical_is_no_new_pose(rng):
    motion = tracked(turned_about(2, 1.0, rng))
    assert motion.rests.is_new.tolist() == [True, False]


def test_turning_at_constant_rate_about_the_vertical_is_no_rest(rng):
    motion = tracked(turned_about(2, 20.0, rng, turn=10.0))
    assert len(motion.rests) == 2
    assert motion.rests.duration_s.sum() == pytest.approx(4.0, abs=0.5)  # bins at either end


def test_waving_alone_has_no_rest():
    hand = recorded('hand', 30.0)
    since = (hand.stamp_ns - hand.stamp_ns[0]) / NANOSECONDS
    motion = tracked(hand.select((since > 5.0) & (since < 9.0)))  # a bout lasts at least 6 s
    assert len(motion.rests) == 0
    assert motion.waving_s() > 3.0
    assert not motion.resting


def test_a_turn_across_a_hole_is_not_known(rng):
    samples = turned_about(0, 1.0, rng)
    since = (samples.stamp_ns - samples.stamp_ns[0]) / NANOSECONDS
    motion = tracked(samples.select((since < 2.2) | (since > 2.8)))
    assert len(motion.rests) == 2
    assert np.isnan(motion.rests.turned).all()
    assert np.isnan(motion.carried_up()).all()


def test_a_hole_within_a_rest_ends_it(rng):
    samples = turned_about(0, 0.0, rng)
    since = (samples.stamp_ns - samples.stamp_ns[0]) / NANOSECONDS
    motion = tracked(samples.select((since < 2.0) | (since > 3.0)))
    assert_allclose(motion.rests.duration_s, 2.0, atol=0.11)  # a bin


def test_stamps_that_go_back_and_readings_that_are_none_are_left_out(rng):
    samples = turned_about(0, 0.5, rng)
    samples.specific_force[5] = np.nan
    twice = samples.select(np.r_[0:400, 300:400, 399:1000])
    tracker = PoseTracker()
    tracker.push(twice)
    tracker.push(samples.select(slice(0, 10)))
    assert tracker.count == 999
    assert_allclose(tracker.view().rests.turned[1, 0], 0.5, atol=2.5e-3)  # half a step, noise


def test_a_sensor_of_coarse_steps_rests(rng):
    samples = turned_about(0, 1.0, rng)
    coarse = ImuSamples(  # steps far above the noise: at rest nothing changes at all
        samples.stamp_ns,
        np.round(samples.angular_rate / 0.05) * 0.05,
        np.round(samples.specific_force / 0.4) * 0.4,
    )
    assert tracked(coarse).rests.is_new.tolist() == [True, True]


def test_a_pose_between_two_steps_rests_though_another_lies_on_one(rng):
    samples = turned_about(0, 1.0, rng)
    first, flicker = samples.stamp_ns < 3 * NANOSECONDS, np.zeros((len(samples), 3))
    flicker[first, 0] = np.arange(first.sum()) % 2  # a variance of 1/4 step^2
    flicker[::RATE_HZ, 0] = 1.0  # of 1/200: no noise of this sensor is 50 times that of another
    coarse = ImuSamples(
        samples.stamp_ns,
        (np.round(samples.angular_rate / 0.05) + flicker) * 0.05,
        (np.round(samples.specific_force / 0.25) + flicker) * 0.25,
    )
    assert tracked(coarse).rests.is_new.tolist() == [True, True]


def test_the_last_second_tells_whether_it_rests(rng):
    samples = turned_about(0, 1.0, rng)
    assert tracked(samples).resting
    assert not tracked(samples.select(slice(0, 500))).resting  # in the middle of the turn


def test_noise_density_is_that_of_the_sensor(rng):
    density = tracked(turned_about(0, 0.0, rng)).noise_density
    # The least of some 40 windows of 600 readings: at most 4 standard errors of 3 % too low.
    assert_allclose(density, np.array([0.002, 0.02]) / np.sqrt(RATE_HZ), rtol=0.12)


def test_lever_information_grows_with_the_time_of_waving(poses):
    since = (poses.stamp_ns - poses.stamp_ns[0]) / NANOSECONDS
    still = tracked(poses.select(since < 90.0)).lever_arm_information()
    waved = tracked(poses).lever_arm_information()
    assert np.linalg.eigvalsh(waved).min() > 20 * np.linalg.eigvalsh(still).min()


def test_the_noise_of_a_rest_tells_nothing_of_lever_arms(rng):
    assert not tracked(turned_about(0, 0.0, rng)).lever_arm_information().any()


@pytest.mark.parametrize(('turn', 'soon'), [(15.0, True), (25.0, False)])
def test_a_turn_of_more_than_20_s_has_drifted(rng, turn, soon):
    assert tracked(turned_about(0, 6.0, rng, turn=turn)).rests.turned_soon.tolist() == [
        False,
        soon,
    ]


def test_nothing_is_known_of_nothing():
    motion = PoseTracker().view()
    assert len(motion.rests) == 0
    assert np.isnan(motion.rate_hz)
    assert motion.lever_arm_information().tolist() == np.zeros((3, 3)).tolist()


@pytest.mark.realdata
@pytest.mark.parametrize('name', ['exp_3', 'exp_6'])
def test_the_board_of_kth_was_laid_into_20_poses(name):
    for samples in kth.load(name):
        motion = tracked(samples)
        assert motion.rests.is_new.sum() == 20
        miss = np.einsum('pi,pi->p', motion.carried_up(), motion.rests.up_s)[1:20]
        assert np.median(miss) > np.cos(np.deg2rad(3.0))  # uncalibrated, and at 62.5 Hz
