"""The sketch's clock as the host finds it, without a host: arrivals are computed, not awaited."""

from emulated_hub import bmi160s, BOOT_US, run, script
import numpy as np
import pytest

from multiimu_ros.wire import packets
from multiimu_ros.wire.board import Board

TWO_PLACES = '-DIMU_PLACES="{0,ANY},{1,ANY}"'
SECONDS = 20.0
START_NS = 1_700_000_000 * 10**9


def lateness_s(rng, count):
    """Return what wire.clock is promised: 0.6 ms in the median, 5 ms in the 99th percentile."""
    return 0.6e-3 * np.exp(0.91 * rng.standard_normal(count))


@pytest.mark.parametrize('skew_ppm', [3000, -500])
def test_the_skew_is_found_within_10_ppm_in_20_s(tmp_path, rng, skew_ppm):
    text = script(bmi160s(2), ['8.0 dead 1'], seconds=SECONDS, skew_ppm=skew_ppm)
    session = run(tmp_path, text, TWO_PLACES)
    board, samples = Board(), []
    frames = [frame + b'\0' for frame in session.data.split(b'\0')[:-1]]
    late = lateness_s(rng, len(frames))
    for frame, end, delay in zip(frames, session.ends, late, strict=True):
        samples += board.push(frame, START_NS + round(1e9 * (end + delay)))
    assert board.decoder.lost == 0
    # The tolerance is the product's promise; an IMU died on the way, which must not bend the line.
    assert board.clock.skew_ppm == pytest.approx(skew_ppm, abs=10)
    stamps = np.array([sample.stamp_ns for sample in samples if sample.imu == 0])
    true_s = [
        (scan.ticks_us + scan.imus[0][0] + np.mean(BOOT_US)) / 1e6 / (1 + 1e-6 * skew_ppm)
        for scan in session.all(packets.Scan)
    ]
    error_s = (stamps - START_NS) / 1e9 - true_s
    settled = slice(len(stamps) // 2, None)
    # The constant delay of 2.6 ms stays in the stamps, for nothing was asked; the rest scatters.
    assert np.std(error_s[settled]) < 100e-6
    assert np.mean(error_s[settled]) < 3e-3
