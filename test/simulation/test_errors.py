"""Drawn errors have the size that they claim, and undo like a calibration undoes them."""

from dataclasses import replace

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
from scipy.signal import welch

from multiimu_ros.rig import Intrinsics
from multiimu_ros.simulation import errors as e

RATE = 200.0
QUIET = e.TriadErrors()


def calibrate(rate, force, unit):
    """Apply the rig file's convention, written out."""
    accelerometer, gyroscope = unit.accelerometer, unit.gyroscope
    force = (
        (force - accelerometer.bias) * accelerometer.scale @ np.array(accelerometer.misalignment).T
    )
    rate = (rate - gyroscope.bias) * gyroscope.scale @ np.array(gyroscope.misalignment).T
    return rate - force @ np.array(gyroscope.g_sensitivity).T, force


@given(seed=st.integers(0, 2**32 - 1))
def test_a_perfect_calibration_undoes_the_errors_of_a_unit(seed):
    rng = np.random.default_rng(seed)
    unit = e.draw_unit(e.MPU9150, rng)
    rate, force = rng.standard_normal((2, 20, 3)) * [[[3.0]], [[10.0]]]
    raw = e.apply_errors(rate, force, RATE, e.PERFECT, unit, rng=rng)
    back = calibrate(*raw, unit)
    # A matrix and its inverse: rounding only.
    assert_allclose(back[0], rate, atol=1e-12)
    assert_allclose(back[1], force, atol=1e-12)


def test_a_perfect_imu_reads_the_truth():
    rng = np.random.default_rng(7)
    rate, force = rng.standard_normal((2, 5, 3))
    raw = e.apply_errors(rate, force, RATE, e.PERFECT, Intrinsics(), rng=rng)
    assert_allclose(raw, (rate, force), rtol=1e-15)
    assert e.draw_unit(e.PERFECT, rng) == Intrinsics()


def test_white_noise_has_the_density_of_the_data_sheet():
    rng = np.random.default_rng(1)
    white = e.TriadErrors(noise_density=e.BMI160.gyroscope.noise_density)
    noise = e.draw_noise(100_000, RATE, white, rng)
    _, power = welch(noise, RATE, nperseg=256, axis=0)
    # One-sided, so twice N^2; 3 axes x ~780 half-overlapping segments x 127 frequencies: the
    # standard error is about 0.2 %.
    assert_allclose(np.sqrt(power[1:-1].mean() / 2), white.noise_density, rtol=0.01)


def allan_deviation(rate, count):
    """Return the overlapping Allan deviation (3,) of clusters of `count` samples."""
    angle = np.cumsum(np.vstack((np.zeros((1, 3)), rate)), axis=0)
    second = angle[2 * count :] - 2 * angle[count:-count] + angle[: -2 * count]
    return np.sqrt(np.mean(second**2, axis=0) / 2) / count


def test_flicker_has_a_flat_allan_deviation_of_0_664_times_the_instability():
    rng = np.random.default_rng(2)
    flicker = e.draw_noise(2**18, RATE, e.TriadErrors(bias_instability=3.0), rng)
    flat = [np.sqrt(np.mean(allan_deviation(flicker, n) ** 2)) for n in (30, 100, 300, 1000)]
    # sqrt(2 ln 2 / pi) = 0.664; with 131 clusters of 1000 on 3 axes the spread is some 5 %.
    assert_allclose(flat, 0.664 * 3.0, rtol=0.1)


def test_random_walk_grows_with_the_root_of_time():
    rng = np.random.default_rng(3)
    walks = [
        e.draw_noise(2000, RATE, e.TriadErrors(bias_random_walk=2.0), rng)[-1] for _ in range(400)
    ]
    # After 10 s: K sqrt(t); the deviation of 1200 draws is known to 2 %, 3.5 of which is 7 %.
    assert_allclose(np.std(walks), 2.0 * np.sqrt(10), rtol=0.07)


def test_readings_come_in_steps_and_stop_at_the_range():
    rng = np.random.default_rng(4)
    rate = np.linspace(-50, 50, 3000).reshape(1000, 3)
    raw, _ = e.apply_errors(rate, 3 * rate, RATE, e.BMI160, Intrinsics(), rng=rng)
    counts = raw / e.BMI160.gyroscope.step
    # 16.4 LSB per deg/s, in 16 bits.
    assert_allclose(counts, np.round(counts), atol=1e-6)
    assert_allclose([counts.min(), counts.max()], [-32767, 32767], atol=1e-6)


def test_units_of_a_class_spread_as_it_says():
    rng = np.random.default_rng(5)
    units = [e.draw_unit(e.BMI160, rng) for _ in range(500)]
    biases = [unit.gyroscope.bias for unit in units]
    scales = [unit.accelerometer.scale for unit in units]
    # 1500 draws: 1.8 % standard error of a deviation, times 3.5.
    assert_allclose(np.std(biases), e.BMI160.gyroscope.bias_sigma, rtol=0.065)
    assert_allclose(np.std(scales), e.BMI160.accelerometer.scale_sigma, rtol=0.065)
    shears = np.array([unit.accelerometer.misalignment for unit in units])
    assert np.all(np.tril(shears - np.eye(3)) == 0)


def test_force_leaks_into_the_rate_by_the_g_sensitivity():
    leak = np.arange(9).reshape(3, 3) / 1000
    unit = Intrinsics.model_validate({'gyroscope': {'g_sensitivity': leak.tolist()}})
    up = np.array([[0.0, 0.0, 10.0]])
    still = np.zeros((1, 3))
    rate, _ = e.apply_errors(still, up, RATE, e.PERFECT, unit, rng=np.random.default_rng(0))
    assert_allclose(rate, [[0.02, 0.05, 0.08]], rtol=1e-12)


def test_the_noise_block_of_a_class_holds_its_figures():
    quieter = replace(e.BMI160, gyroscope=replace(e.BMI160.gyroscope, noise_density=1e-5))
    block = e.noise_block(quieter)
    assert block.noise_density.gyroscope == (1e-5,) * 3
    assert block.bias_instability.accelerometer == (e.BMI160.accelerometer.bias_instability,) * 3
