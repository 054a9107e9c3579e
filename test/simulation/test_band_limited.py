"""What a low-pass of 80 Hz and a full scale of 16 g leave of a motion."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.simulation.band_limited import BANDWIDTH_HZ, gaussian, read_band_limited
from multiimu_ros.simulation.errors import PERFECT, TriadErrors
from multiimu_ros.simulation.motion import Trajectory
from multiimu_ros.simulation.paths import Path, through
from multiimu_ros.simulation.placements import foot
from multiimu_ros.simulation.recording import read_imu
from multiimu_ros.simulation.trajectories import trajectory

RATE_HZ = 200.0
TIMES = np.arange(1000) / RATE_HZ
IMU = foot(1).imus[0]


def shaken(frequency, amplitude=1.0):
    """Return a motion along z that accelerates as a sine, and that acceleration at `TIMES`."""
    knots = np.arange(0.0, 6.0, 0.05 / frequency)
    phase = 2 * np.pi * frequency * knots
    omega, moves = 2 * np.pi * frequency, np.zeros((3, len(knots), 6))
    size = amplitude / omega**2
    moves[:, 1:-1, 2] = np.array([
        -size * np.sin(phase), -size * omega * np.cos(phase), amplitude * np.sin(phase),
    ])[:, 1:-1]  # fmt: skip
    return Trajectory(Path(knots, *moves), 6.0), amplitude * np.sin(omega * (TIMES))


def vertical(motion, errors=PERFECT, rng=None):
    """Return the readings (N,) along z, less gravity."""
    level = IMU.model_copy(update={'extrinsics': None})
    force = read_band_limited(level, motion, TIMES, errors, rng or np.random.default_rng(0))[1]
    return force[:, 2] - motion.gravity


@pytest.mark.parametrize(('frequency', 'passed'), [(5.0, 1.0), (BANDWIDTH_HZ, np.sqrt(0.5))])
def test_half_the_power_passes_at_the_bandwidth_and_all_of_it_far_below(frequency, passed):
    motion, acceleration = shaken(frequency)
    inner = slice(100, 900)
    # A Gaussian passes exp(-ln 2 / 2 (f / B)^2): at 5 Hz all but 0.14 %; sampling it, 1e-4.
    assert_allclose(vertical(motion)[inner], passed * acceleration[inner], atol=0.003)


def test_the_kernel_is_even_and_passes_what_is_constant():
    kernel = gaussian(0.05)
    assert_allclose(kernel, kernel[::-1])
    assert kernel.sum() == pytest.approx(1.0, rel=1e-12)


def test_a_slow_motion_reads_as_it_is_at_an_instant(rng):
    path = trajectory('slider', 5.0)
    heard = read_band_limited(IMU, path, TIMES, PERFECT, rng)
    sampled = read_imu(IMU, path.at(TIMES), RATE_HZ, PERFECT, rng)
    # The slider's ramps of 50 ms are 20 sigmas of the filter long, and only they are rounded off.
    assert_allclose(heard[0], sampled[0], atol=0.02)
    assert np.median(np.abs(heard[1] - sampled[1])) < 1e-6


def test_what_is_out_of_range_is_lost_before_the_filter():
    motion, _ = shaken(20.0, amplitude=200.0)
    narrow = replace(PERFECT, accelerometer=TriadErrors(limit=100.0))
    # The filter alone leaves 0.979 of it, and ten samples a period come as near as 72 deg.
    expected = 200.0 * 0.979 * np.sin(np.deg2rad(72))
    assert vertical(motion).max() == pytest.approx(expected, rel=0.01)
    top = vertical(motion, narrow).max() + motion.gravity
    assert 95.0 < top <= 100.0
    # A shock of 360 m/s^2 for 2 ms each way is within range after the filter, but not before it.
    blow = Trajectory(through([0.0, 2.0, 2.004, 5.0], z=[0.0, 0.0, 1e-3, 1e-3]), 6.0)
    whole, cut = (np.abs(vertical(blow, errors)).max() for errors in (PERFECT, narrow))
    assert whole < 95.0
    assert cut < 0.6 * whole
