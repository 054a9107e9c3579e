"""Samples in the order of their stamps: each once, none late, however the topics are served."""

from hypothesis import given, strategies as st
import numpy as np
import pytest

from multiimu_ros.synchronization.streams import RING
from multiimu_ros.synchronization.synchronizer import SyncConfig, Synchronizer

MS = 1_000_000
START = 1_790_000_000_000_000_000
CONFIG = SyncConfig()


def reading(k, stamp_ns):
    """Return six numbers that tell stream and instant."""
    return [k + 1e-3 * ((stamp_ns - START) / MS) + axis for axis in range(6)]


def stream_of(k, count, period=5 * MS, phase=0, skip=()):
    stamps = [START + phase + n * period for n in range(count) if n not in skip]
    return [(stamp, k) for stamp in stamps]


def served(samples, count, synchronizer=None):
    """Push (stamp, stream) pairs; return the arrivals of every scan."""
    synchronizer = synchronizer or Synchronizer(count, CONFIG)
    arrivals = []
    for stamp, k in samples:
        scans = synchronizer.push(k, stamp, reading(k, stamp))
        arrivals += [(scan.stamp_ns, synchronizer.arrivals(scan.stamp_ns)) for scan in scans]
    return synchronizer, arrivals


def pairs(arrivals):
    """Return every (stamp, stream) that came out, in its order."""
    return [
        pair
        for _, a in arrivals
        for pair in zip(a.stamps.tolist(), a.streams.tolist(), strict=True)
    ]


def test_samples_come_in_the_order_of_their_stamps_ties_by_stream():
    samples = stream_of(2, 20) + stream_of(0, 40, 3 * MS) + stream_of(1, 20, phase=2 * MS)
    _, arrivals = served(sorted(samples, key=lambda sample: (sample[0], -sample[1])), 3)
    last = arrivals[-1][0]
    assert pairs(arrivals) == sorted(sample for sample in samples if sample[0] <= last)
    before = 0
    for stamp, taken in arrivals:
        assert before < taken.stamps[0] <= taken.stamps[-1] <= stamp
        before = stamp
        for instant, k, values in zip(*taken, strict=True):
            assert values.tolist() == reading(k, instant)


@given(seed=st.integers(0, 2**32 - 1))
def test_arrivals_do_not_depend_on_the_order_in_which_topics_are_served(seed):
    rng = np.random.default_rng(seed)
    periods = (10 * MS, 5 * MS, 3 * MS)
    streams = [
        stream_of(k, 120 * MS // period, period, k * MS, set(rng.integers(0, 12, 2).tolist()))
        for k, period in enumerate(periods)
    ]
    straight = sorted(sample for stream in streams for sample in stream)
    # Each sample is late by up to 40 ms, less than the patience; a topic keeps its own order.
    delayed = []
    for stream in streams:
        delays = [stamp + int(rng.integers(0, 40 * MS)) for stamp, _ in stream]
        delayed += zip(np.maximum.accumulate(delays).tolist(), stream, strict=True)
    shuffled = [sample for _, sample in sorted(delayed)]
    assert pairs(served(straight, 3)[1])[:60] == pairs(served(shuffled, 3)[1])[:60]


def test_before_the_first_scan_and_between_scans_there_is_nothing():
    synchronizer = Synchronizer(2, CONFIG)
    assert len(synchronizer.arrivals().stamps) == 0
    synchronizer.push(0, START, reading(0, START))
    assert len(synchronizer.arrivals().stamps) == 0
    synchronizer.push(1, START + MS, reading(1, START + MS))
    taken = synchronizer.arrivals()
    assert taken.stamps.tolist() == [START]
    assert taken.values.shape == (1, 6)
    assert len(synchronizer.arrivals().stamps) == 0


def test_each_of_two_scans_of_one_push_gets_its_own_samples():
    synchronizer = Synchronizer(2, CONFIG)
    for n in range(3):
        synchronizer.push(0, START + 5 * n * MS, reading(0, START))
    scans = synchronizer.push(1, START + 12 * MS, reading(1, START))
    assert [scan.stamp_ns - START for scan in scans] == [0, 5 * MS, 10 * MS]
    for scan in scans:
        assert synchronizer.arrivals(scan.stamp_ns).stamps.tolist() == [scan.stamp_ns]
    assert len(synchronizer.arrivals().stamps) == 0


def test_without_an_instant_all_scans_so_far_are_taken_and_no_later_sample():
    synchronizer = Synchronizer(2, CONFIG)
    for n in range(3):
        synchronizer.push(0, START + 5 * n * MS, reading(0, START))
    synchronizer.push(1, START + 12 * MS, reading(1, START))
    taken = synchronizer.arrivals(START + 3600 * 1000 * MS)  # not beyond the last scan
    assert (taken.stamps - START).tolist() == [0, 5 * MS, 10 * MS]


def test_readings_are_mapped_and_stamps_moved_and_unsound_ones_stay_outside():
    maps = np.stack([np.column_stack([2.0 * np.eye(6), np.ones(6)]), np.eye(6, 7)])
    synchronizer = Synchronizer(2, CONFIG, maps, np.array([MS, 0]))
    synchronizer.push(0, START, [1.0] * 6)
    synchronizer.push(0, START + MS, [np.nan] * 6)
    synchronizer.push(0, START - MS, [4.0] * 6)  # backward
    synchronizer.push(1, START + 2 * MS, [5.0] * 6)
    taken = synchronizer.arrivals()
    assert taken.stamps.tolist() == [START + MS]
    assert taken.values.tolist() == [[3.0] * 6]


def test_a_sample_whose_scan_is_over_is_dropped_and_counted():
    synchronizer = Synchronizer(2, CONFIG)
    both = sorted(stream_of(0, 100) + stream_of(1, 2, phase=MS))
    _, before = served(both, 2, synchronizer)
    silent = [(START + phase * MS, 1) for phase in (200, 300, 400)]
    assert before[-1][0] > silent[1][0]  # given up after the patience of 50 ms
    _, after = served([*silent, *stream_of(0, 120)[100:], (START + 600 * MS, 1)], 2, synchronizer)
    assert synchronizer._cursors.late.tolist() == [0, 3]
    assert [k for _, k in pairs(after)].count(1) == 0
    stamps = [stamp for stamp, _ in pairs(before + after)]
    assert stamps == sorted(stamps)


def test_a_ring_that_nobody_empties_gives_its_latest_samples_and_counts_the_rest():
    synchronizer = Synchronizer(1, CONFIG)
    stamps = [START + n * MS for n in range(RING + 100)]
    for stamp in stamps:
        synchronizer.push(0, stamp, reading(0, stamp))
    taken = synchronizer.arrivals()
    assert taken.stamps.tolist() == stamps[100:]
    assert taken.values[0].tolist() == reading(0, stamps[100])
    assert synchronizer._cursors.overrun.tolist() == [100]


@pytest.mark.parametrize('by_hand', [True, False])
def test_after_time_jumped_nothing_old_comes_out(by_hand):
    synchronizer = Synchronizer(1, CONFIG)
    for n in range(10):
        synchronizer.push(0, START + n * MS, reading(0, START))
        if n < 7:
            synchronizer.arrivals()
    back = START - 3600 * 1000 * MS
    if by_hand:
        synchronizer.restart()
        assert len(synchronizer.arrivals().stamps) == 0
    for n in range(5):
        synchronizer.push(0, back + n * MS, reading(0, back))
    assert synchronizer.arrivals().stamps.tolist() == [back + n * MS for n in range(5)]
    assert synchronizer._cursors.late.tolist() == [0]
