"""The smoother on a real foot."""

import numpy as np
import pytest
from walks import end_error, walk, xio_gait

from multiimu_ros.odometry.smoother import Recording, smooth


@pytest.mark.realdata
@pytest.mark.slow
def test_a_loop_with_lost_samples_is_smoothed_within_its_own_uncertainty():
    recording = xio_gait()
    live = walk(recording)
    n, known = len(recording.time), recording.sensor
    smoothed = smooth(
        live.odometry._config,
        Recording(
            dt=np.diff(recording.time, prepend=recording.time[0] - 0.0025),
            angular_rate=recording.rate,
            specific_force=recording.force,
            rate_density=np.tile(known.rate_density, (n, 1)),
            force_density=np.tile(known.force_density, (n, 1)),
            still=live.flags[:, 0],
            resting=live.flags[:, 1],
        ),
    )
    # The foot came back to its mark, to the width of a hand.
    sigma = np.sqrt(np.diag(smoothed.P[-1])[:3])
    assert (np.abs(smoothed.position_n[-1]) < 3 * np.hypot(sigma, 0.03)).all()
    # Biases that are known better, and rests that are used in full, serve the whole path.
    assert end_error(smoothed.position_n) < end_error(live.position)
