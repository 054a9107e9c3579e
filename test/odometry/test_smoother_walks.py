"""The smoother on a real foot."""

from functools import cache

import numpy as np
import pytest
from walks import end_error, walk, xio_gait

from multiimu_ros.odometry.smoother import Recording, smooth, Smoother


@cache
def loop():
    """Return a real loop: what was known live, how, and what is to be smoothed."""
    recording = xio_gait()
    live = walk(recording)
    n, known = len(recording.time), recording.sensor
    to_smooth = Recording(
        dt=np.diff(recording.time, prepend=recording.time[0] - 0.0025),
        angular_rate=recording.rate,
        specific_force=recording.force,
        rate_density=np.tile(known.rate_density, (n, 1)),
        force_density=np.tile(known.force_density, (n, 1)),
        still=live.flags[:, 0],
        resting=live.flags[:, 1],
    )
    return live, live.odometry._config, to_smooth


@pytest.mark.realdata
@pytest.mark.slow
def test_a_loop_with_lost_samples_is_smoothed_within_its_own_uncertainty():
    live, config, recording = loop()
    smoothed = smooth(config, recording)
    # The foot came back to its mark, to the width of a hand.
    sigma = np.sqrt(np.diag(smoothed.P[-1])[:3])
    assert (np.abs(smoothed.position_n[-1]) < 3 * np.hypot(sigma, 0.03)).all()
    # Biases that are known better, and rests that are used in full, serve the whole path.
    assert end_error(smoothed.position_n) < end_error(live.position)


@pytest.mark.realdata
@pytest.mark.slow
def test_a_loop_that_is_said_to_close_does_without_surprise():
    _, config, recording = loop()
    smoother = Smoother(config, recording, closed_sigma=0.05)  # feet on a mark, by eye
    end = np.concatenate([block.position_n for block in smoother.blocks()])[-1]
    assert np.linalg.norm(end) < 0.05
    assert smoother.closure.gap > 0.05  # it had something to do
    assert smoother.closure.surprise < 2
