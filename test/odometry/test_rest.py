"""Rest is learnt from late; motion passes at once; nothing is lost."""

from hypothesis import given, strategies as st
import numpy as np

from multiimu_ros.odometry.rest import RestBuffer, Sample


def sample(k, resting, dt=0.01):
    """Return a sample that carries its number."""
    return Sample(dt, np.full(3, float(k)), *np.zeros((3, 3)), resting, resting)


def test_motion_passes_at_once():
    buffer = RestBuffer(0.1)
    assert buffer.push(sample(1, False))[0].angular_rate[0] == 1.0


def test_rest_is_released_after_the_lag_and_made_up_for_as_motion():
    buffer = RestBuffer(0.045)
    out = [buffer.push(sample(k, True)) for k in range(6)]
    assert [len(ready) for ready in out] == [0, 0, 0, 0, 1, 1]
    late = buffer.push(sample(6, False))
    assert [int(ready.angular_rate[0]) for ready in late] == [2, 3, 4, 5, 6]
    assert not any(ready.resting or ready.still for ready in late)


def test_what_rested_up_to_a_hole_rested():
    buffer = RestBuffer(0.045)
    for k in range(6):
        buffer.push(sample(k, True))
    late = buffer.push(sample(6, False, dt=2.0))
    assert [ready.resting for ready in late] == [True] * 4 + [False]


@given(st.lists(st.booleans(), max_size=60))
def test_every_sample_comes_out_once_and_in_order(rests):
    buffer = RestBuffer(0.05)
    out = [ready for k, rest in enumerate(rests) for ready in buffer.push(sample(k, rest))]
    out += buffer.push(sample(len(rests), False))
    assert [int(ready.angular_rate[0]) for ready in out] == list(range(len(rests) + 1))


def test_the_caller_may_reuse_its_arrays():
    buffer, rate = RestBuffer(0.1), np.ones(3)
    buffer.push(Sample(0.01, rate, *np.zeros((3, 3)), True, True))
    rate[:] = 7.0
    assert buffer.push(sample(2, False))[0].angular_rate[0] == 1.0


def test_clear_forgets():
    buffer = RestBuffer(0.1)
    buffer.push(sample(1, True))
    buffer.clear()
    assert len(buffer.push(sample(2, False))) == 1
