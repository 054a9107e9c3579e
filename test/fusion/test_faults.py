"""Leave-one-out statistics against their formula; who is excluded, who is not, and who returns."""

from hypothesis import given, settings, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.stats import chi2, kstest

from multiimu_ros.fusion import fault_state as columns
from multiimu_ros.fusion.faults import fault_states, guard_state, judge

DT = 0.005  # [s]
GAINS = (1.0, 0.1, 0.01, 0.002)  # of the four memories at 200 Hz


def run(guard, readings, R=None, slow=1e-6, dt=DT):
    """Judge readings (N, K, 6) scan by scan; return what becomes of R (N, K, 6), by default 1."""
    count = readings.shape[1]
    R = np.ones((count, 6)) if R is None else R
    slow = np.broadcast_to(np.asarray(slow, float), (count, 6))
    out = np.empty(readings.shape)
    for n, z in enumerate(readings):
        missing = np.isnan(z)
        for triad in (0, 1):
            part = slice(3 * triad, 3 * triad + 3)
            noise = np.where(missing, np.inf, R)[:, part].copy()
            judge(guard, triad, z[:, part].copy(), noise, slow[:, part].copy(), dt)
            out[n, :, part] = noise
    return out


def healthy(rng, scans, count):
    return rng.standard_normal((scans, count, 6))


def chi_square(guard, triad):
    first = triad * columns.BLOCK + columns.CHI
    return guard[:, first : first + columns.SCALES]


def words(guard):
    return [state.state for state in fault_states(guard)]


def test_statistic_is_the_averaged_residual_beside_the_mean_of_the_others(rng):
    count, scans = 5, 40
    R, slow = rng.uniform(0.5, 2.0, (2, count, 6))
    slow *= 0.1
    readings = np.sqrt(R) * healthy(rng, scans, count)
    guard = guard_state(count)
    run(guard, readings, R, slow)
    for scale, gain in enumerate(GAINS):
        weights = gain * (1 - gain) ** np.arange(scans)[::-1]
        mean = np.einsum('n,nka->ka', weights, readings)
        V = (weights**2).sum() * R + weights.sum() * slow
        for i in range(count):
            others = np.delete(np.arange(count), i)
            information = (1 / V[others]).sum(axis=0)
            apart = mean[i] - (mean[others] / V[others]).sum(axis=0) / information
            expected = (apart**2 / (V[i] + 1 / information)).reshape(2, 3).sum(axis=1)
            for triad in (0, 1):  # one number by two routes
                assert_allclose(chi_square(guard, triad)[i, scale], expected[triad], rtol=1e-10)


def test_statistic_of_healthy_imus_is_chi_squared_of_three(rng):
    guard = guard_state(3)
    scores = []
    for z in healthy(rng, 2000, 3):
        run(guard, z[np.newaxis], slow=0.0)
        scores.append([chi_square(guard, triad)[0, 0] for triad in (0, 1)])
    # The shortest scale has no memory: 4000 independent draws.
    assert kstest(np.ravel(scores), chi2(3).cdf).pvalue > 1e-3
    assert words(guard) == ['ok'] * 3


@pytest.mark.parametrize('triad', [0, 1])
@pytest.mark.parametrize(
    ('size', 'scans', 'word'),
    # What the averages of a step of `size` sigma must reach: sqrt(40 * 1.5) of their own sigma,
    # 7.75 of 1, of 0.23 after 4 scans at gain 0.1, of 0.071 after 80 at 0.01; two sigma on top.
    [(12.0, 2, 'jump'), (4.0, 15, 'bias'), (1.2, 140, 'bias')],
)
def test_a_step_is_isolated_and_takes_both_triads_out(rng, triad, size, scans, word):
    readings = healthy(rng, 100 + scans, 3)
    readings[100:, 1, 3 * triad] += size
    guard = guard_state(3)
    R = run(guard, readings)
    assert np.isinf(R[-1, 1, 3 * triad : 3 * triad + 3]).all()
    again = run(guard, readings[-1:])  # the rate of that scan was fused before its force was seen
    assert np.isinf(again[0, 1]).all()
    assert np.isfinite(again[0, [0, 2]]).all()
    assert np.isfinite(R[:, [0, 2]]).all()
    state = fault_states(guard)[1]
    triad_word = ('angular rate', 'specific force')[triad]
    assert (state.state, state.reason) == ('excluded', f'{triad_word}: {word}')
    assert state.exclusions == 1


@pytest.mark.parametrize('kind', ['noise', 'spikes'])
def test_noise_and_spikes_are_called_noise(rng, kind):
    readings = healthy(rng, 400, 3)
    if kind == 'noise':
        readings[100:, 2, :3] *= 15.0
    else:
        readings[100:, 2, 3:] += (
            100.0 * rng.standard_normal((300, 1)) * (rng.random((300, 1)) < 0.2)
        )
    guard = guard_state(3)
    R = run(guard, readings)
    state = fault_states(guard)[2]
    assert state.state == 'excluded'
    assert state.reason.endswith('noise')
    assert np.isfinite(R[:, :2]).all()


def test_one_jump_costs_one_reading_and_two_cost_the_imu(rng):
    readings = healthy(rng, 100, 3)
    readings[[50, 90, 92], 1, 3] += 20.0
    guard = guard_state(3)
    R = run(guard, readings[:90])
    assert np.flatnonzero(np.isinf(R[:, 1, 3])).tolist() == [50]
    assert np.isfinite(np.delete(R, 50, axis=0)).all()
    assert words(guard)[1] != 'excluded'
    run(guard, readings[90:])
    assert words(guard) == ['ok', 'excluded', 'ok']


def test_what_has_healed_returns_after_the_hold_and_without_a_jump(rng):
    readings = healthy(rng, 500, 3)
    readings[100:200, 0, 2] += 50.0
    R = run(guard := guard_state(3), readings)
    share = 1.0 / R[:, 0, 0]
    # Half a second of agreement; chance (2e-4 per score) may restart it, but not with this seed.
    back = np.flatnonzero(share[200:] > 0.0)[0]
    assert 100 <= back <= 160
    assert (share[100 : 200 + back] == 0.0).all()
    ramp = np.diff(share[200 + back : 200 + back + 49])
    assert_allclose(ramp, 0.02, rtol=1e-9)  # 0.25 s are 50 scans
    assert share[-1] == 1.0
    assert words(guard) == ['readmitted', 'ok', 'ok']


def test_the_hold_doubles_with_each_relapse_up_to_seconds(rng):
    guard = guard_state(3)
    holds = []
    for _ in range(7):
        fault = np.zeros((2, 3, 6))
        fault[:, 1, 0] = 20.0
        run(guard, fault)
        assert words(guard)[1] == 'excluded'
        holds.append(guard[1, columns.HOLD_S])
        # Coarser scans do for waiting.
        run(guard, np.zeros((round(holds[-1] / 0.02) + 2, 3, 6)), dt=0.02)
        assert words(guard)[1] != 'excluded'
    assert holds == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0, 8.0]
    run(guard, np.zeros((15, 3, 6)), dt=1.0)
    run(guard, fault)
    assert guard[1, columns.HOLD_S] == 0.5  # later it is a new fault


def test_two_imus_detect_but_do_not_isolate(rng):
    readings = healthy(rng, 200, 2)
    readings[100:, 1, 0] += 20.0
    R = np.ones((2, 6))
    R[1] = 4.0
    guard = guard_state(2)
    out = run(guard, readings, R)
    assert words(guard) == ['ambiguous', 'ambiguous']
    assert np.isfinite(out).all()
    assert_allclose(out[100:, 1] / out[100:, 0], 4.0, rtol=1e-12)  # their mean stays
    # What is apart is what the sum of the variances says, but for the noise of the latest scan.
    apart = readings[-1, 1, 0] - readings[-1, 0, 0]
    assert apart**2 <= out[-1, :, 0].sum() * (1 + 1e-9)
    run(guard, np.zeros((600, 2, 6)), R, dt=0.05)
    assert words(guard) == ['ok', 'ok']


def test_two_against_two_exclude_nobody(rng):
    readings = healthy(rng, 50, 4)
    readings[:, 2:, 4] += 30.0
    guard = guard_state(4)
    assert np.isfinite(run(guard, readings)).all()
    assert words(guard) == ['ambiguous'] * 4


def test_two_that_agree_outvote_two_that_do_not(rng):
    readings = healthy(rng, 50, 4)
    readings[:, 0, 4] += 30.0
    readings[:, 3, 4] -= 45.0
    guard = guard_state(4)
    run(guard, readings)
    assert words(guard) == ['excluded', 'ok', 'ok', 'excluded']


@pytest.mark.parametrize('count', [3, 8])
def test_the_largest_error_is_set_aside_before_the_healthy_are_judged(rng, count):
    readings = healthy(rng, 20, count)
    readings[10:, 1] += 1e4  # moves the mean of the others by thousands of sigma
    guard = guard_state(count)
    run(guard, readings)
    assert guard[:, columns.EXCLUDED].tolist() == [float(i == 1) for i in range(count)]


def test_one_that_has_healed_votes_where_the_last_two_disagree(rng):
    readings = healthy(rng, 90, 3)
    readings[10:30, 0] += 40.0
    # 40 sigma are below 7.7 of the 0.23 of the second scale after 32 scans; the hold takes 100.
    readings[80:, 1] -= 40.0
    guard = guard_state(3)
    run(guard, readings)
    assert words(guard) == ['readmitted', 'excluded', 'ok']


def test_what_all_share_is_invisible_and_harmless(rng):
    readings = healthy(rng, 200, 3)
    quiet, turning = guard_state(3), guard_state(3)
    run(quiet, readings)
    motion = 1e-3 * np.arange(200.0)[:, np.newaxis, np.newaxis] ** 2  # up to 40 sigma
    run(turning, readings + motion)
    # What cancels is up to 40: that costs two digits of the double, here squared.
    assert_allclose(chi_square(turning, 0), chi_square(quiet, 0), rtol=1e-9)


def test_a_shock_that_no_interpolation_follows_is_no_fault(rng):
    readings = healthy(rng, 300, 8)
    shock = 60.0 * rng.standard_normal(10)
    # What the IMUs, read one after the other, have of it differs by some 5 %.
    readings[100:110, :, 3:] += (shock[:, None] * (1 + 0.05 * rng.standard_normal(8)))[:, :, None]
    guard = guard_state(8)
    run(guard, readings)
    assert 'excluded' not in words(guard)


def test_a_gap_is_forgotten(rng):
    readings = healthy(rng, 150, 3)
    readings[100:120, 1] = np.nan
    biased = readings.copy()
    biased[:100, 1] += 0.2  # not yet beyond
    plain, other = guard_state(3), guard_state(3)
    run(plain, readings)
    run(other, biased)
    # The scales of the past are seconds long, but it is not theirs any more.
    assert_allclose(chi_square(other, 0)[1], chi_square(plain, 0)[1], rtol=1e-9)
    assert words(other) == ['ok'] * 3


def test_one_imu_has_nobody_to_be_compared_with(rng):
    guard = guard_state(1)
    readings = healthy(rng, 20, 1)
    readings[10:] += 1e3
    assert (run(guard, readings) == 1.0).all()
    state = fault_states(guard)[0]
    assert state.state == 'ok'
    assert np.isnan(state.chi_square)


def test_nobody_returns_while_there_is_nobody_to_agree_with(rng):
    readings = healthy(rng, 300, 3)
    readings[9:11, 0] += 50.0
    readings[11:, 1:] = np.nan
    guard = guard_state(3)
    R = run(guard, readings)
    assert np.isinf(R[11:]).all()
    assert words(guard)[0] == 'excluded'


def test_suspicion_halves_no_weight_and_certainty_takes_all(rng):
    R = []
    for size in np.linspace(0.0, 9.0, 40):
        z = np.zeros((1, 3, 6))
        z[0, 0, 0] = size
        R.append(run(guard_state(3), z, slow=0.0)[0, 0, 0])
    chi = np.linspace(0.0, 9.0, 40) ** 2 / 1.5
    expected = np.sqrt(np.maximum(chi / columns.SUSPECT, 1.0))
    expected[chi > columns.EXCLUDE] = np.inf
    assert_allclose(R, expected, rtol=1e-12)


@settings(max_examples=20)
@given(st.permutations(range(4)), st.integers(0, 2**32 - 1), st.floats(0.01, 100.0))
def test_names_and_units_do_not_matter(order, seed, unit):
    readings = healthy(np.random.default_rng(seed), 12, 4)
    readings[6:, 2, 1] += 15.0
    plain, other = guard_state(4), guard_state(4)
    R = run(plain, readings)
    scaled = run(other, unit * readings[:, order], np.full((4, 6), unit**2), unit**2 * 1e-6)
    assert_allclose(scaled / unit**2, R[:, order], rtol=1e-8)
    assert words(other) == [words(plain)[i] for i in order]


@pytest.mark.compiled
@pytest.mark.parametrize('rate_hz', [50.0, 200.0, 1000.0])
def test_memories_are_seconds_whatever_the_rate(rate_hz):
    # Without noise a step of s sigma in 200 Hz units crosses where the density says, not the rate.
    R = np.full((3, 6), rate_hz / 200.0)
    guard = guard_state(3)
    run(guard, np.zeros((round(2 * rate_hz), 3, 6)), R, dt=1 / rate_hz)
    z = np.zeros((round(rate_hz), 3, 6))
    z[:, 0, 0] = 1.0
    out = run(guard, z, R, dt=1 / rate_hz)
    crossed = np.flatnonzero(np.isinf(out[:, 0, 0]))[0] / rate_hz
    # 1 - exp(-t / 0.5 s) = sqrt(60) sigma of a mean over 0.5 s, whose variance is 1 / 200.
    assert crossed == pytest.approx(-0.5 * np.log(1 - np.sqrt(60 / 199)), abs=1.5 / rate_hz + 0.01)
