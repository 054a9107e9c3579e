"""Readings at the end of a range are counted, however they come."""

from hypothesis import given, strategies as st
import numpy as np
import pytest

from multiimu_ros.cli.clipping import Clipping, ImuClipping, saturated
from multiimu_ros.samples import ImuSamples


def coarse(seed):
    """Return (200, 3) readings of few distinct values, some of them at the end of the range."""
    noise = np.random.default_rng(seed).standard_normal((200, 3))
    return np.clip(np.round(3 * noise), -5, 5)


def counted(vectors):
    """Return the same, written plainly: at most one value per end of an axis."""
    hits = 0
    for axis in (*vectors.T, *-vectors.T):
        values, counts = np.unique(axis, return_counts=True)
        if values[-1] > 0 and counts[-1] >= 5 and counts[-1] > counts[-2]:
            hits += counts[-1]
    return hits


@given(seed=st.integers(0, 2**32 - 1))
def test_stream_agrees_with_batch_and_with_plain_counting(seed):
    vectors, stream = coarse(seed), Clipping(3)
    for part in np.array_split(vectors, [0, 1, 1, 40, 77, 150]):
        stream.push(part)
    assert stream.hits == saturated(vectors) == counted(vectors)


def test_readings_that_are_no_numbers_do_not_count():
    ramp = np.linspace(-1.0, 1.0, 100)[:, None] * np.ones(3)
    ramp[::7] = np.nan
    assert saturated(np.clip(ramp, -2.0, 0.5)) == 3 * np.nansum(ramp[:, 0] >= 0.5)
    assert saturated(np.full((10, 3), np.nan)) == 0


def test_the_share_is_that_of_rate_or_force_whichever_clips_more():
    ramp = np.linspace(-1.0, 1.0, 100)[:, None] * np.ones(3)
    clipping = ImuClipping()
    assert clipping.share == 0.0
    clipping.push(ImuSamples(np.arange(100), ramp, np.clip(ramp, -2.0, 0.5)))
    assert clipping.share == pytest.approx(0.25, abs=0.01)  # of 100 readings of each axis
