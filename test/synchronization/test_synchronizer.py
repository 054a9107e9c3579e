"""Scans from streams: exact on the grid, independent of arrival order, honest about faults."""

from itertools import chain

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.synchronization import synchronizer as synchronizer_module
from multiimu_ros.synchronization.synchronizer import scan_of, SyncConfig, Synchronizer

MS = 1_000_000
START = 1_790_000_000_000_000_000
PERIOD = 5 * MS
CONFIG = SyncConfig()


def line(k, stamp_ns):
    """Return readings that grow linearly in time: interpolation must reproduce them."""
    seconds = (stamp_ns - START) * 1e-9
    return [k + axis + (axis + 1.0) * seconds for axis in range(6)]


def stream_of(k, count, offset_ns=0, skip=range(0)):
    stamps = [START + offset_ns + n * PERIOD for n in range(count) if n not in skip]
    return [(stamp, k, line(k, stamp)) for stamp in stamps]


def scans_of(samples, count=3, config=CONFIG):
    synchronizer = Synchronizer(count, config)
    scans = [scan for stamp, k, values in samples for scan in synchronizer.push(k, stamp, values)]
    return synchronizer, scans


def present(scans, k):
    return np.array([np.isfinite(scan.values[k, 0]) for scan in scans])


def states(synchronizer):
    return [stream.state for stream in synchronizer.health()]


def test_samples_of_one_instant_pass_unchanged(rng):
    synchronizer = Synchronizer(2, CONFIG)
    readings = rng.standard_normal((20, 2, 6))
    scans = []
    for n in range(20):
        scans += synchronizer.push(0, START + n * PERIOD, readings[n, 0])
        scans += synchronizer.push(1, START + n * PERIOD, readings[n, 1])
    assert [scan.stamp_ns for scan in scans] == [START + n * PERIOD for n in range(20)]
    assert np.array_equal([scan.values for scan in scans], readings)


def test_staggered_samples_are_interpolated_to_the_reference():
    samples = sorted(stream_of(0, 50) + stream_of(1, 50, 1 * MS) + stream_of(2, 50, 3 * MS))
    _, scans = scans_of(samples)
    assert len(scans) == 50  # every sample of the reference, and no wait for a later round
    for scan in scans[1:]:
        assert_allclose(scan.values, [line(k, scan.stamp_ns) for k in range(3)], rtol=1e-9)


def test_a_parabola_is_reproduced_and_its_noise_gain_is_told(rng):
    stamps = START + np.cumsum(rng.integers(3 * MS, 6 * MS, 300))
    seconds = (stamps - START) * 1e-9
    synchronizer = Synchronizer(2, CONFIG)
    scans = []
    for n, stamp in enumerate(stamps.tolist()):
        scans += synchronizer.push(0, stamp - 2 * MS, [np.sin(n)] * 6)
        scans += synchronizer.push(1, stamp, [1.0 + 2.0 * seconds[n] - 3.0 * seconds[n] ** 2] * 6)
    due = np.array([(scan.stamp_ns - START) * 1e-9 for scan in scans])[3:]
    found = np.array([scan.values[1, 0] for scan in scans])[3:]
    assert_allclose(found, 1.0 + 2.0 * due - 3.0 * due**2, rtol=1e-9)
    gain = np.array([scan.noise_gain for scan in scans])[3:]
    assert (gain[:, 0] == 1.0).all()
    assert ((gain[:, 1] > 0.5) & (gain[:, 1] < 1.0)).all()


@given(seed=st.integers(0, 2**32 - 1))
def test_scans_do_not_depend_on_the_order_in_which_topics_arrive(seed):
    rng = np.random.default_rng(seed)
    streams = [stream_of(k, 40, k * MS, skip=rng.integers(0, 40, 3)) for k in range(3)]
    merged = sorted(chain(*streams))
    # Each sample is late by up to 40 ms, less than the patience; a topic keeps its own order.
    delays = {id(sample): sample[0] + rng.integers(0, 40 * MS) for sample in merged}
    arrival = {}
    for stream in streams:
        latest = 0
        for sample in stream:
            arrival[id(sample)] = latest = max(latest, delays[id(sample)])
    shuffled = sorted(merged, key=lambda sample: (arrival[id(sample)], sample[1], sample[0]))
    _, straight = scans_of(merged)
    _, late = scans_of(shuffled)
    for a, b in zip(straight, late, strict=False):
        assert a.stamp_ns == b.stamp_ns
        assert np.array_equal(a.values, b.values, equal_nan=True)
    assert abs(len(straight) - len(late)) <= 1  # the very last one may still be waited for


@pytest.mark.compiled
@given(seed=st.integers(0, 2**32 - 1))
def test_a_block_makes_the_scans_that_single_readings_make(seed):
    rng = np.random.default_rng(seed)
    samples = stream_of(0, 300) + stream_of(1, 300, 1 * MS) + stream_of(2, 300, 3 * MS, range(90))
    samples = sorted(samples) + sorted(stream_of(1, 40) + stream_of(0, 40))  # time jumps back
    for n in rng.integers(0, len(samples), 20):  # some come late, some are none
        stamp, k, values = samples[n]
        samples[n] = (stamp - int(rng.integers(0, 30)) * MS, k, [*values[:5], np.nan])
    one_by_one, expected = scans_of(samples)
    in_blocks = Synchronizer(3, CONFIG)
    stamps, ks, values = (np.array(column) for column in zip(*samples, strict=True))
    cut = int(rng.integers(1, len(samples)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synchronizer_module, 'BLOCK', int(rng.integers(1, 500)))
        scans = [
            scan_of(stamp_ns, rows)
            for part in (slice(0, cut), slice(cut, None))
            for block in in_blocks.take_block(ks[part], stamps[part], values[part])
            for stamp_ns, rows in zip(*block, strict=True)
        ]
    assert [scan.stamp_ns for scan in scans] == [scan.stamp_ns for scan in expected]
    for ours, theirs in zip(scans, expected, strict=True):
        assert np.array_equal(ours.values, theirs.values, equal_nan=True)
        assert np.array_equal(ours.share, theirs.share)
        assert np.array_equal(ours.noise_gain, theirs.noise_gain)
    assert in_blocks.health() == one_by_one.health()
    assert in_blocks.time_jumps == one_by_one.time_jumps == 1


def test_a_silent_stream_is_absent_after_the_patience_and_stops_nothing():
    dead = range(20, 100)
    samples = sorted(stream_of(0, 100) + stream_of(1, 100, MS) + stream_of(2, 100, 2 * MS, dead))
    synchronizer, scans = scans_of(samples)
    assert len(scans) == 100
    assert present(scans, 2)[1:20].all()
    assert not present(scans, 2)[20:].any()
    assert states(synchronizer) == ['ok', 'ok', 'absent']


def test_when_the_reference_dies_the_next_one_takes_over_and_no_scan_is_lost():
    samples = sorted(stream_of(0, 100, skip=range(50, 100)) + stream_of(1, 100, MS))
    synchronizer, scans = scans_of(samples, count=2)
    stamps = [scan.stamp_ns for scan in scans]
    expected = [START + n * PERIOD + (MS if n >= 50 else 0) for n in range(100)]
    # The scan of sample 49 of the new reference lies behind the old one's last: it is made too.
    assert set(expected) <= set(stamps)
    assert stamps == sorted(stamps)
    assert states(synchronizer) == ['absent', 'ok']


def test_a_stream_that_returns_is_on_probation_then_its_share_grows_to_one():
    outage = range(100, 140)
    samples = sorted(stream_of(0, 400) + stream_of(1, 400, skip=outage))
    _, scans = scans_of(samples, count=2)
    share = np.array([scan.share[1] for scan in scans])
    assert (share[:100] == 1.0).all()
    returned = 140 + round(CONFIG.patience_s / 5e-3)
    assert not present(scans, 1)[100 : returned + 1].any()
    assert present(scans, 1)[returned + 1 :].all()
    probation = round(CONFIG.probation_s / 5e-3)
    assert (share[141 : 141 + probation] == 0.0).all()
    growth = share[141 + probation : 140 + 2 * probation]
    assert_allclose(np.diff(growth), 1.0 / probation, rtol=1e-9)
    assert (share[140 + 2 * probation :] == 1.0).all()


def test_a_short_hole_is_not_interpolated_and_costs_no_trust():
    samples = sorted(stream_of(0, 60) + stream_of(1, 60, MS, skip=range(30, 34)))
    _, scans = scans_of(samples, count=2)
    assert not present(scans, 1)[30:35].any()  # 25 ms without a sample
    assert present(scans, 1)[35:].all()
    assert all(scan.share[1] == 1.0 for scan in scans)


def test_a_silence_that_all_share_costs_nobody_the_trust_nor_the_reference_its_role():
    hiccup = range(100, 160)
    samples = sorted(chain(*(stream_of(k, 300, k * MS, skip=hiccup) for k in range(3))))
    late_reference = sorted(samples, key=lambda sample: sample[0] + 30 * MS * (sample[1] == 0))
    for order in (samples, late_reference):
        _, scans = scans_of(order)
        assert [scan.stamp_ns for scan in scans] == [stamp for stamp, k, _ in samples if k == 0]
        assert all((scan.share == 1.0).all() for scan in scans)
        assert present(scans, 2).sum() == 300 - 60 - 2  # no neighbour before, one hole


@pytest.mark.parametrize('bad', [np.nan, np.inf])
def test_readings_that_are_no_numbers_never_enter(bad):
    samples = sorted(stream_of(0, 60) + stream_of(1, 60))
    ill = [
        (stamp, k, [bad] * 6 if k == 1 and stamp > START + 30 * PERIOD else values)
        for stamp, k, values in samples
    ]
    synchronizer, scans = scans_of(ill, count=2)
    assert len(scans) == 60
    assert not present(scans, 1)[31:].any()
    assert states(synchronizer) == ['ok', 'invalid']
    assert synchronizer.health()[1].invalid == 29


def test_a_frozen_sensor_is_found_by_its_tenth_repetition():
    samples = [
        (stamp, k, line(k, START + 30 * PERIOD) if k == 1 and stamp > START + 30 * PERIOD else v)
        for stamp, k, v in sorted(stream_of(0, 80) + stream_of(1, 80))
    ]
    synchronizer, scans = scans_of(samples, count=2)
    assert present(scans, 1)[:40].all()
    assert not present(scans, 1)[40:].any()
    assert states(synchronizer) == ['ok', 'stuck']


def test_perfect_sensors_at_rest_are_not_taken_for_frozen_ones():
    constant = [(stamp, k, [0.0] * 5 + [9.81]) for stamp, k, _ in
                sorted(stream_of(0, 100) + stream_of(1, 100))]  # fmt: skip
    synchronizer, scans = scans_of(constant, count=2)
    assert len(scans) == 100
    assert states(synchronizer) == ['ok', 'ok']


def test_backward_stamps_are_counted_and_refused():
    samples = [*stream_of(0, 10), (START + 2 * PERIOD, 0, line(0, START))]
    synchronizer, scans = scans_of(samples, count=1)
    assert len(scans) == 10
    assert synchronizer.health()[0].backward == 1
    assert synchronizer.time_jumps == 0


def test_a_recording_that_starts_again_is_one_time_jump():
    once = sorted(stream_of(0, 600) + stream_of(1, 600))
    synchronizer, scans = scans_of(once + once, count=2)
    assert synchronizer.time_jumps == 1
    assert len(scans) == 1200
    assert states(synchronizer) == ['ok', 'ok']


def test_a_stream_that_never_speaks_is_waited_for_at_the_start_only():
    first_wait = round(CONFIG.start_patience_s / 5e-3)
    _, scans = scans_of(stream_of(0, 300), count=2)
    assert len(scans) == 300
    _, scans = scans_of(stream_of(0, first_wait), count=2)
    assert scans == []


def test_a_topic_that_is_discovered_late_and_comes_in_a_burst_loses_nothing():
    early = round(0.8 * CONFIG.start_patience_s / 5e-3)
    first, second, third = (stream_of(k, 300) for k in range(3))
    rest = sorted(first[early:] + second[early:] + third[early:])
    _, scans = scans_of([*second[:early], *first[:early], *third[:early], *rest])
    _, in_order = scans_of(sorted(first + second + third))
    assert [scan.stamp_ns for scan in scans] == [scan.stamp_ns for scan in in_order]
    assert np.array_equal([scan.values for scan in scans], [scan.values for scan in in_order])
    assert all(scan.share.min() == 1.0 for scan in scans)


def test_a_stream_that_is_always_late_is_waited_for_at_the_start_only():
    lag = round(2 * CONFIG.patience_s / 5e-3)
    late = [(stamp, 1, values) for stamp, _, values in stream_of(1, 300)]
    samples = list(stream_of(0, lag))
    for ahead, behind in zip(stream_of(0, 300)[lag:], late, strict=False):
        samples += [ahead, behind]
    _, scans = scans_of(samples, count=2)
    waited = present(scans, 1)
    assert waited[:50].all()
    assert not waited[120:].any()


def test_a_disabled_stream_is_left_out_until_it_is_enabled_again():
    synchronizer = Synchronizer(2, CONFIG)
    scans = []
    for n, (stamp, k, values) in enumerate(sorted(stream_of(0, 300) + stream_of(1, 300))):
        if n == 100:
            synchronizer.set_enabled(0, enabled=False)
            assert synchronizer.health()[0].state == 'disabled'
        if n == 200:
            synchronizer.set_enabled(0, enabled=True)
        scans += synchronizer.push(k, stamp, values)
    assert len(scans) == 300
    assert not present(scans, 0)[51:100].any()
    assert scans[101].share[0] == 0.0
    assert scans[-1].share[0] == 1.0


def test_readings_and_stamps_are_mapped_at_the_door(rng):
    maps = rng.standard_normal((1, 6, 7))
    synchronizer = Synchronizer(1, CONFIG, maps, np.array([-7 * MS]))
    values = rng.standard_normal(6)
    (scan,) = synchronizer.push(0, START, values)
    assert scan.stamp_ns == START - 7 * MS
    # One sum of seven products, in two orders of summation.
    assert_allclose(scan.values[0], maps[0, :, :6] @ values + maps[0, :, 6], rtol=1e-12)


def test_settings_must_be_positive():
    with pytest.raises(ValueError, match='`patience_s` must be positive, got nan'):
        SyncConfig(patience_s=float('nan'))
