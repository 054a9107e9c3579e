"""The noise of each IMU from differences: unbiased, as sure as theory allows, deaf to motion."""

from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose, assert_array_equal
import pytest

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.fusion import three_cornered_hat as hat
from multiimu_ros.fusion.federated import information_shares
from multiimu_ros.fusion.rigid_body import lever_arm_matrix
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.placements import row
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory
from multiimu_ros.synchronization.synchronizer import SyncConfig, Synchronizer

RATE_HZ, REST_S = 200.0, 4.0  # the simulated hand begins to move after that
seeds = st.integers(0, 2**32 - 1)


def sample_variance(triad):
    """White noise of one sample, and that of its rounding."""
    return triad.noise_density**2 * RATE_HZ + triad.step**2 / 12


TRUE = np.repeat([sample_variance(BMI160.gyroscope), sample_variance(BMI160.accelerometer)], 3)


def standard_error(R, scans):
    """Standard error of R_0 from `scans` second differences, derived without pairs.

    R_0 = s_00 - 2/(K-2) (sum_j s_0j - sum_{j<k} s_jk / (K-1)) in sample covariances s of
    independent noises, var(s_ii) = 2 R_i^2 / n, var(s_ij) = R_i R_j / n; n = scans 18/35, for
    second differences repeat themselves.
    """
    own = R[0] * R[1:].sum()
    others = (R[1:].sum() ** 2 - (R[1:] ** 2).sum()) / 2
    count = len(R)
    part = 2 / (count - 2)
    near, far = part * (1 - 1 / (count - 1)), part / (count - 1)
    square = 2 * R[0] ** 2 + near**2 * own + far**2 * others
    return np.sqrt(square / (scans * 18 / 35))


def learn(readings, dt=1 / RATE_HZ, usable=None, noise_gain=None):
    """Track readings (N, K, 6); return the memory."""
    count = readings.shape[1]
    memory = hat.hat_state(count)
    for n, z in enumerate(readings):
        hat.track(
            memory,
            z,
            np.ones(count) if usable is None else usable[n],
            np.ones(count) if noise_gain is None else noise_gain[n],
            dt,
        )
    return memory


def draw(rng, R, scans):
    """Noises of variance R (K,), on all six axes."""
    return np.sqrt(R)[:, None] * rng.standard_normal((scans, len(R), 6))


@pytest.mark.parametrize('R', [[1, 1, 1], [1, 1, 6], [6, 1, 1], [1.0] * 8, [4, 1, 1, 1, 2, 9]])
def test_estimates_are_unbiased_and_scatter_as_derived(R, rng):
    R, scans, runs = np.array(R, float), 1500, 40
    found = [hat.learnt_density(draw(rng, R, scans), 1.0)[0] ** 2 for _ in range(runs)]
    error = standard_error(R, scans)
    # 240 estimates: their mean errs by error / 15, their scatter by 1 / sqrt(480) = 4.6 %.
    assert np.mean(found) == pytest.approx(R[0], abs=3 * error / np.sqrt(240))
    assert np.std(found) == pytest.approx(error, rel=3 / np.sqrt(480))


@settings(max_examples=20)
@given(seed=seeds)
def test_what_the_imus_share_and_what_is_slow_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    noise = draw(rng, rng.uniform(0.5, 2.0, 4), 400)
    time = np.arange(400)[:, None, None] / 400
    slow = rng.normal(0, 100, (4, 6)) + rng.normal(0, 100, (4, 6)) * time
    # A jerky truth of 5 sigma: so violent that scans are left out begins at 30 sigma.
    truth = 5 * rng.standard_normal((400, 1, 6))
    # Sums of numbers of 200 in double: 1e-13 of one, against variances of 1.
    assert_allclose(
        hat.learnt_density(noise + slow + truth, 1.0), hat.learnt_density(noise, 1.0), rtol=1e-9
    )


@settings(max_examples=20)
@given(seed=seeds)
def test_the_order_of_the_imus_and_the_unit_do_not_matter(seed):
    rng = np.random.default_rng(seed)
    noise, order = draw(rng, rng.uniform(0.5, 2.0, 5), 300), rng.permutation(5)
    density = hat.learnt_density(noise, 1.0)
    # A least-squares fit in another order: the condition of 10 equations, 1e-15 each.
    assert_allclose(
        hat.learnt_density(1e-3 * noise[:, order], 1.0), 1e-3 * density[order], rtol=1e-9
    )


def test_the_stream_that_never_forgets_says_what_the_batch_says(rng):
    # Bounded noise: no second difference beyond 4 sigma, so that nothing is ever clipped.
    readings = rng.uniform(-1, 1, (600, 4, 6)) * np.array([1.0, 1.2, 0.8, 2.0])[:, None]
    readings[300:320, 2] = np.nan
    readings[400:410, 1, 3:] = np.nan
    R, known = hat.learnt_variance(learn(readings, dt=0.0))
    assert known.all()
    # The same sums in another order.
    assert_allclose(np.sqrt(R / RATE_HZ), hat.learnt_density(readings, RATE_HZ), rtol=1e-9)


def test_an_imu_of_ten_times_the_noise_leaves_the_estimates_of_the_others_alone(rng):
    R = np.array([1.0] * 7 + [100.0])
    found, known = hat.learnt_variance(learn(draw(rng, R, 2000)))
    assert known.all()
    # As sure as seven IMUs are without it; 42 numbers, so four standard errors.
    assert_allclose(found[:7], 1.0, atol=4 * standard_error(R[:7], 2000))
    assert_allclose(found[7], 100.0, rtol=4 * standard_error(R[::-1], 2000) / 100)


def test_of_three_imus_none_is_believed_perfect_beside_one_of_ten_times_the_noise(rng):
    """R_1 is then (y_12 + y_13 - y_23) / 2, known to 0.36: no weight may grow out of that."""
    R = np.array([1.0, 1.0, 100.0])
    for _ in range(40):
        b = information_shares(hat.learnt_density(draw(rng, R, 3000), 1.0) ** 2)
        # Best is 0.706, one alone 1; R_1 : R_2 as 0.36 : 2 makes sqrt(0.85^2 + 0.15^2) = 0.86, and
        # y_12 = 2 scatters by 5 %.
        assert np.sqrt((b**2 * R[:, None]).sum(axis=0)).max() < 0.88


def test_spikes_are_cut(rng):
    readings = draw(rng, np.ones(4), 4000)
    for k in range(4):
        readings[500 + 200 * k :: 1000, k] += 100.0  # four of each IMU
    # Each spike is in three second differences, 16 x (6 R + 6 R) in each: 4 x 3 x 16 x 2 / 4000 of
    # R more, 9.6 %.  Uncut it were 4 x 10^4 / 4000, tenfold.
    error = standard_error(np.ones(4), 4000)
    stream, _ = hat.learnt_variance(learn(readings, dt=0.0))
    assert_allclose(stream, 1.096, atol=4 * error)
    assert_allclose(hat.learnt_density(readings, 1.0) ** 2, 1.096, atol=4 * error)


def test_noise_that_grows_is_followed_within_seconds(rng):
    readings = draw(rng, np.ones(4), 2400)
    readings[1000:, 0] *= 10.0
    R, _ = hat.learnt_variance(learn(readings))
    # After 7 s: 1 - exp(-7 / 15) = 0.37 of it, less the seconds in which it was cut.
    assert R[0].min() > 10.0
    assert_allclose(R[1:], 1.0, atol=0.35)


def test_readings_that_rest_on_one_step_at_first_do_not_bind_the_rest(rng):
    readings = draw(rng, np.ones(3), 1600)
    readings[:100] = 0.0
    R, _ = hat.learnt_variance(learn(readings, dt=0.0))
    assert_allclose(R, 15 / 16, atol=4 * standard_error(np.ones(3), 1500))


def test_what_lacks_or_is_not_usable_is_left_out(rng):
    readings, usable = draw(rng, np.ones(4), 1000), np.ones((1000, 4), dtype=bool)
    readings[200:400, 1] = np.nan
    readings[600:700, 2, :3] = np.inf
    readings[700:, 3] *= 1000.0
    usable[700:, 3] = False
    R, known = hat.learnt_variance(learn(readings, usable=usable))
    assert known.all()
    assert_allclose(R, 1.0, atol=5 * standard_error(np.ones(4), 600))


def test_two_imus_and_few_scans_tell_nothing(rng):
    for count, scans in ((1, 300), (2, 300), (3, 100)):
        R, known = hat.learnt_variance(learn(draw(rng, np.ones(count), scans)))
        assert np.isnan(R).all()
        assert not known.any()
        assert np.isnan(hat.learnt_density(draw(rng, np.ones(count), scans), 1.0)).all()
    readings = draw(rng, np.ones(4), 300)
    readings[:, 3] = np.nan
    R, _ = hat.learnt_variance(learn(readings))
    assert_array_equal(np.isnan(R[:, 0]), [False, False, False, True])


def test_readings_without_noise_have_a_positive_variance():
    R, known = hat.learnt_variance(learn(np.ones((300, 3, 6))))
    assert known.all()
    assert (R > 0.0).all()


def test_bad_input_is_named_in_the_message():
    with pytest.raises(ValueError, match=r'`values` must have shape \(N, K, 6\), got \(9, 6\)'):
        hat.learnt_density(np.zeros((9, 6)), 1.0)
    with pytest.raises(ValueError, match='`count` must be from 1 to 16 IMUs, got 17'):
        hat.hat_state(17)


def moving_board(count, seconds, *, noisy=None, calibrated=True):
    """Carry BMI160s by hand through the synchroniser; return readings, truth and noise gains.

    `noisy` has 2.45 times the noise.  Lever arms are taken out with the true motion.
    """
    recording = simulate(row(count), trajectory('hand', seconds), RATE_HZ, seed=5)
    rig = calibrated_rig(recording.rig) if calibrated else recording.rig
    maps = np.stack([np.column_stack(affine(imu.intrinsics)) for imu in rig.imus])
    if not calibrated:
        maps[:] = np.eye(6, 7)
    rng = np.random.default_rng(6)
    columns = []
    for k, samples in enumerate(recording.raw):
        values = np.hstack([samples.angular_rate, samples.specific_force])
        if k == noisy:  # 1 + 5 = 2.45^2
            values = values + np.sqrt(5 * TRUE) * rng.standard_normal(values.shape)
        columns.append(values)
    synchronizer, scans = Synchronizer(count, SyncConfig(), maps), []
    for n in range(len(recording.truth_ns)):
        for k, samples in enumerate(recording.raw):
            scans.extend(synchronizer.push(k, samples.stamp_ns[n], columns[k][n]))
    whole = [s for s in scans if np.isfinite(s.values).all()]
    begin = np.searchsorted(recording.truth_ns, [s.stamp_ns for s in whole])
    z = np.array([s.values for s in whole])
    truth = recording.truth
    arms = np.array([imu.extrinsics.lever_arm_b for imu in rig.imus])
    for n, m in enumerate(begin):
        L = lever_arm_matrix(truth.angular_rate_b[m], truth.angular_acceleration_b[m])
        z[n, :, 3:] -= arms @ L.T
    values = np.hstack([truth.angular_rate_b, truth.specific_force_b])[begin]
    moves = np.array([s.stamp_ns for s in whole]) > recording.truth_ns[0] + REST_S * 1e9
    return z[moves], values[moves], np.array([s.noise_gain for s in whole])[moves]


@pytest.mark.compiled
@pytest.mark.parametrize('calibrated', [True, False])
def test_staggered_imus_in_a_moving_hand_show_the_noise_of_their_samples(calibrated):
    z, _, gain = moving_board(5, 16.0, calibrated=calibrated)
    assert gain.mean(axis=0).min() < 0.7  # half-way between two samples
    R, known = hat.learnt_variance(learn(z, noise_gain=gain))
    assert known.all()
    # Scans of the fading memory: (sum k)^2 / sum k^2 of k = exp(-n / 3000).
    keep = np.exp(-np.arange(len(z)) / RATE_HZ / hat.MEMORY_S)
    scans = keep.sum() ** 2 / (keep**2).sum()
    error = standard_error(np.ones(5), scans)
    # Three axes of each of five IMUs: their mean to 1 / sqrt(3) of one.
    means = (R / TRUE).reshape(5, 2, 3).mean(axis=2)
    assert_allclose(means, 1.0, atol=3 * error / np.sqrt(3))


@pytest.mark.compiled
def test_an_imu_of_unknown_noise_costs_no_more_than_its_information():
    healthy, truth, gain = moving_board(3, 16.0)
    third = np.full((3, 6), 1 / 3)

    def error(readings, weights):
        return np.std((readings * weights).sum(axis=1) - truth, axis=0)

    ratios, averages = [], []
    for noisy in range(3):
        z, _, _ = moving_board(3, 16.0, noisy=noisy)
        R, known = hat.learnt_variance(learn(z, noise_gain=gain))
        assert known.all()
        best = error(healthy, third)
        ratios.append(np.mean(error(z, information_shares(R)) / best))
        averages.append(np.mean(error(z, third) / best))
    # Theory sqrt(3 / (2 + 1/6)) = 1.18 and sqrt((1 + 1 + 6) / 3) = 1.63 where all are alike.
    # Interpolation, which leaves 1, 0.8 and 0.7 of the variance, makes it 1.14 to 1.22 and 1.5 to
    # 1.8, as the noisy one is the first or the last.
    assert np.mean(ratios) < 1.2
    assert max(ratios) < 1.23
    assert np.mean(averages) == pytest.approx(1.63, rel=0.03)
