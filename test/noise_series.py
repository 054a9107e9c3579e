"""Series of known noise for the tests of the Allan analysis."""

import numpy as np

from multiimu_ros.simulation.errors import draw_noise, TriadErrors


def five_terms(count, rate_hz, Q, N, B, K, R, rng):
    """Return (count, 3) readings with the five terms.

    The simulated flicker repeats after its length, so that one of twice the length is cut.
    """
    errors = TriadErrors(noise_density=N, bias_instability=B, bias_random_walk=K)
    drawn = draw_noise(2 * count, rate_hz, errors, rng)[:count]
    steps = rate_hz * np.diff(rng.standard_normal((count + 1, 3)), axis=0)
    return drawn + Q * steps + R * np.arange(count)[:, np.newaxis] / rate_hz
