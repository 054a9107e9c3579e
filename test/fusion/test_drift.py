"""Who no longer agrees: the outlier alone is named, after a while, and honest IMUs are not."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.drift import BLOCK_NS, compare, DriftMonitor, RAISE
from multiimu_ros.fusion.rig_model import rig_model
from multiimu_ros.rig import (
    Extrinsics,
    GyroscopeTriad,
    Imu,
    Intrinsics,
    Noise,
    PerTriad,
    Rig,
    RigFrame,
    Triad,
)

COUNT, SCANS = 4, 20  # IMUs; scans in a block, of 200 Hz
DENSITY = 1e-4
BIAS_SIGMA, SCALE_SIGMA = 1e-3, 1e-4
SIGMA = BIAS_SIGMA * np.sqrt(4 / 3)  # of one of four beside the mean of three
ZEROS = ((0.0,) * 3,) * 3
UP = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81])


def rig_of(walk=0.0):
    """Return a rig that knows its scale and mounting well."""
    six = PerTriad(accelerometer=(DENSITY,) * 3, gyroscope=(DENSITY,) * 3)
    walks = PerTriad(accelerometer=(walk,) * 3, gyroscope=(walk,) * 3)
    known = {
        'bias_sigma': (BIAS_SIGMA,) * 3,
        'scale_sigma': (SCALE_SIGMA,) * 3,
        'misalignment_sigma': ZEROS,
    }
    intrinsics = Intrinsics(
        gyroscope=GyroscopeTriad(**known, g_sensitivity_sigma=ZEROS),
        accelerometer=Triad(**known | {'scale_sigma': (0.0,) * 3}),
    )
    imus = tuple(
        Imu(
            name=f'imu{k}',
            frame_id='a',
            intrinsics=intrinsics,
            noise=Noise(noise_density=six, bias_random_walk=walks),
            extrinsics=Extrinsics(rotation_sigma=(0.0,) * 3),
        )
        for k in range(COUNT)
    )
    return Rig(version=1, rig=RigFrame(name='test'), imus=imus)


def empty_block():
    """Return zeros that lie in memory as those of the fusion stage do."""
    return np.zeros((COUNT + 1, 9))[:, 2:]


class Feed:
    """A monitor, and the blocks that it takes."""

    def __init__(self, rng=None, walk=0.0):
        rig = rig_of(walk)
        self.monitor = DriftMonitor(rig, rig_model(rig))
        self._rng = rng
        self._stamp_ns = 0
        self.monitor.take(empty_block() + 1.0, 0, resting=False)  # what came before counts not

    def push(self, errors, seconds, rates=None, seen=(SCANS,) * COUNT):
        """Feed blocks in which IMU i reads the truth plus `errors` (K, 6 or 3x3 of the rate)."""
        for n in range(round(seconds * 1e9 / BLOCK_NS)):
            truth = UP.copy() if rates is None else np.array([*rates[n], *UP[3:]])
            readings = truth + (errors if errors.ndim == 2 else np.zeros((COUNT, 6)))
            if errors.ndim == 3:
                readings[:, :3] += errors @ truth[:3]
            if self._rng:  # white noise of a mean over a tenth of a second
                readings = readings + DENSITY * np.sqrt(10) * self._rng.standard_normal((COUNT, 6))
            block = empty_block()
            block[:COUNT, :6] = readings * np.array(seen)[:, None]
            block[:COUNT, 6] = seen
            block[COUNT] = [*(truth * SCANS), SCANS]
            self._stamp_ns += BLOCK_NS
            self.monitor.take(block, self._stamp_ns, resting=rates is None)
            assert not block.any()
        return [getattr(d, name) for d in self.monitor.disagreements()
                for name in ('rate', 'force', 'turn')]  # fmt: skip


def raised(gaps):
    """Return (IMU, quantity) of all that is raised."""
    return {(n // 3, ('rate', 'force', 'turn')[n % 3]) for n, gap in enumerate(gaps) if gap.raised}


def one_off(k, axis, size):
    errors = np.zeros((COUNT, 6))
    errors[k, axis] = size
    return errors


def turning(rng, seconds):
    return rng.standard_normal((round(10 * seconds), 3))


def test_the_outlier_is_set_aside_and_the_others_are_compared_among_themselves():
    values = np.array([[0.0], [0.1], [100.0], [-0.1]])
    gaps, sigmas, kept = compare(values, np.ones((4, 1)), np.ones(4, bool))
    assert kept.tolist() == [True, True, False, True]
    # Beside the mean of the other two healthy ones; the outlier beside all three.
    assert_allclose(gaps[:, 0], [0.0, 0.15, 100.0, 0.15], atol=1e-12)
    assert_allclose(sigmas[:, 0] ** 2, [1.5, 1.5, 4 / 3, 1.5], rtol=1e-12)


def test_of_two_that_disagree_none_is_set_aside():
    gaps, _, kept = compare(np.array([[0.0], [100.0]]), np.ones((2, 1)), np.ones(2, bool))
    assert kept.all()
    assert_allclose(gaps, 100.0)


def test_an_imu_of_which_nothing_is_known_moves_nobody():
    values = np.array([[0.0], [0.2], [0.1], [np.nan]])
    gaps, _, kept = compare(values, np.ones((4, 1)), np.array([True, True, True, False]))
    assert kept.tolist() == [True, True, True, False]
    assert_allclose(gaps[:3, 0], [0.15, 0.15, 0.0], atol=1e-12)


def test_honest_sigmas_are_beaten_as_often_as_they_say(rng):
    spread = np.array([1.0, 2.0, 0.5])[:, None]
    square = []
    for _ in range(2000):
        values = spread * rng.standard_normal((3, 2))
        gaps, sigmas, _ = compare(values, spread**2 * np.ones((3, 2)), np.ones(3, bool))
        square.append((gaps / sigmas) ** 2)
    # Chi-squared of one degree of freedom, 4000 of each: standard error sqrt(2 / 4000) = 0.022.
    assert_allclose(np.mean(square, axis=(0, 2)), 1.0, atol=0.1)


@pytest.mark.parametrize(('axis', 'name'), [(1, 'rate'), (5, 'force')])
def test_a_gap_at_rest_is_raised_when_it_has_persisted(axis, name):
    feed = Feed()
    errors = one_off(2, axis, 10 * SIGMA)
    assert raised(feed.push(errors, 3.9)) == set()
    gaps = feed.push(errors, 0.2)  # the second judgement, after 4 s of rest
    assert raised(gaps) == {(2, name)}
    gap = gaps[6 + ('rate', 'force').index(name)]
    assert gap.value == pytest.approx(10 * SIGMA, rel=1e-9)
    # White noise of 4 s adds (1e-4)^2 / 4 to (1e-3)^2.
    assert gap.sigma == pytest.approx(SIGMA, rel=0.01)
    assert gap.rivals == ()


def test_a_gap_that_lasts_one_judgement_is_not_raised():
    feed = Feed()
    feed.push(one_off(2, 0, 10 * SIGMA), 2.1)
    # One judgement beyond; memory keeps 2 s of 10 SIGMA among more and more of the opposite.
    assert raised(feed.push(one_off(2, 0, -10 * SIGMA), 4.0)) == set()


def test_what_is_raised_stays_until_it_has_been_calm_for_long():
    feed = Feed()
    feed.push(one_off(1, 0, 10 * SIGMA), 10.0)
    assert raised(feed.push(one_off(1, 0, 5 * SIGMA), 60.0)) == {(1, 'rate')}  # between 4 and 6
    # Forgotten to below 4 sigma in 10 s ln(5/4) = 2.2 s; four judgements later it is not over.
    assert raised(feed.push(np.zeros((COUNT, 6)), 10.0)) == {(1, 'rate')}
    assert raised(feed.push(np.zeros((COUNT, 6)), 4.0)) == set()


@pytest.mark.parametrize('rates', [None, np.zeros((620, 3))], ids=['rest', 'motion'])
def test_biases_may_walk_away_while_the_monitor_runs(rates):
    walk = 1e-3  # a variance of 1e-6 in a second, as much as the calibration left
    steady, walking = (
        Feed(walk=w).push(np.zeros((COUNT, 6)), 62.0, rates)[0].sigma for w in (0.0, walk)
    )
    # Judged last after 60 s, or after 60.2 where 0.1 s do not add up to 5 s.
    assert walking**2 - steady**2 == pytest.approx(walk**2 * 61.0 * 4 / 3, rel=0.03)


def test_below_the_threshold_nothing_is_raised():
    assert raised(Feed().push(one_off(0, 0, 0.97 * RAISE * SIGMA), 60.0)) == set()


def test_a_response_of_its_own_to_the_rate_is_found_in_motion(rng):
    errors = np.zeros((COUNT, 3, 3))
    errors[3, 0, 1] = 0.005  # a misalignment, fifty times its sigma
    gaps = Feed(rng).push(errors, 15.0, turning(rng, 15.0))
    assert raised(gaps) == {(3, 'turn')}
    # Noise 1e-4 rad/s in a second, 15 s at 1 rad/s: 2.6e-5, four of them.
    assert gaps[11].value == pytest.approx(0.005, abs=1e-4)


def test_a_bias_is_no_response_to_the_rate(rng):
    gaps = Feed(rng).push(one_off(0, 0, 1.0), 15.0, turning(rng, 15.0))
    assert raised(gaps) == {(0, 'rate')}
    assert gaps[0].value == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(('axis', 'name'), [(0, 'rate'), (4, 'force')])
def test_who_errs_too_much_for_a_rest_to_be_noticed_is_found_all_the_same(rng, axis, name):
    # The mean of four then turns at 0.25 rad/s and weighs 0.25 m/s^2 too much, for ever.
    steady = np.tile([0.25, 0.0, 0.0], (110, 1))
    assert raised(Feed(rng).push(one_off(1, axis, 1.0), 11.0, steady)) == {(1, name)}


def test_without_a_turn_nothing_is_known_of_the_response(rng):
    # Rates of 1e-4 rad/s: the noise itself would show as a slope of order 1.
    gaps = Feed(rng).push(np.zeros((COUNT, 6)), 60.0, 1e-4 * turning(rng, 60.0))
    assert raised(gaps) == set()


@pytest.mark.compiled
def test_the_response_of_honest_imus_is_within_its_sigma(rng):
    scores = []
    for _ in range(100):
        errors = SCALE_SIGMA * np.eye(3) * rng.standard_normal((COUNT, 1, 3))
        gaps = Feed(rng).push(errors, 10.1, turning(rng, 10.1))
        scores += [gap.value / gap.sigma for gap in gaps[2::3]]
    # The largest of nine: for nine independent Gaussians its mean is 1.8, and 400 of them give
    # 0.03 of error; correlated estimates and a generous noise make it less.
    assert 0.8 < np.mean(scores) < 1.9
    assert max(scores) < RAISE


def test_an_imu_that_missed_scans_of_a_block_is_not_judged_by_it():
    feed = Feed()
    gaps = feed.push(one_off(2, 0, 1.0), 10.0, seen=(SCANS, SCANS, SCANS - 1, SCANS))
    assert np.isnan(gaps[6].value)
    assert raised(gaps) == set()
    assert np.isnan(feed.monitor.rest_offsets()[0][2]).all()
    assert_allclose(feed.monitor.rest_offsets()[0][[0, 1, 3]], 0.0, atol=1e-15)


def test_after_a_jump_of_time_what_is_known_stays():
    feed = Feed()
    feed.push(one_off(2, 0, 10 * SIGMA), 10.0)
    feed.monitor.restart()
    assert feed.monitor.due_ns < -(2**62)
    feed.monitor.take(empty_block(), -(10**12), resting=True)
    assert feed.monitor.due_ns == BLOCK_NS - 10**12
    assert feed.monitor.disagreements()[2].rate.raised


def test_a_variance_at_rest_holds_what_gravity_makes_of_scale():
    rig = rig_of()
    loose = rig.imus[0].intrinsics.model_copy(update={'accelerometer': Triad(
        bias_sigma=(BIAS_SIGMA,) * 3, scale_sigma=(0.01,) * 3, misalignment_sigma=ZEROS
    )})  # fmt: skip
    imus = tuple(imu.model_copy(update={'intrinsics': loose}) for imu in rig.imus)
    rig = rig.model_copy(update={'imus': imus})
    feed = Feed()
    feed.monitor = DriftMonitor(rig, rig_model(rig))
    feed.push(np.zeros((COUNT, 6)), 2.2)
    _, variance = feed.monitor.rest_offsets()
    noise = variance[0, 0]  # across gravity
    assert_allclose(variance[0, 5] - noise, (0.01 * 9.81) ** 2, rtol=1e-9)
