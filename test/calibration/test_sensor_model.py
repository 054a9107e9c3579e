"""The sensor model against its formula, and batch against single readings."""

import numpy as np
from numpy.testing import assert_allclose

from multiimu_ros.calibration.sensor_model import affine, calibrate
from multiimu_ros.rig import GyroscopeTriad, Intrinsics, Triad
from multiimu_ros.samples import ImuSamples

INTRINSICS = Intrinsics(
    accelerometer=Triad(
        misalignment=((1, 0.01, -0.02), (0, 1, 0.03), (0, 0, 1)),
        scale=(1.01, 0.98, 1.02),
        bias=(0.1, -0.2, 0.3),
    ),
    gyroscope=GyroscopeTriad(
        misalignment=((1, 0.02, -0.01), (0.03, 1, 0.01), (-0.02, 0.01, 1)),
        scale=(0.99, 1.03, 1.0),
        bias=(0.01, 0.02, -0.03),
        g_sensitivity=((1e-3, 2e-3, 0), (0, -1e-3, 0), (5e-4, 0, 1e-3)),
    ),
)


def samples_of(rng, n=20):
    return ImuSamples(np.arange(n), *rng.standard_normal((2, n, 3)))


def test_the_model_is_misalignment_times_scale_times_raw_minus_bias(rng):
    raw = samples_of(rng)
    calibrated = calibrate(raw, INTRINSICS)
    a, g = INTRINSICS.accelerometer, INTRINSICS.gyroscope
    for w_raw, f_raw, w, f in zip(
        raw.angular_rate, raw.specific_force, calibrated.angular_rate,
        calibrated.specific_force, strict=True,
    ):  # fmt: skip
        force = np.array(a.misalignment) @ (np.array(a.scale) * (f_raw - a.bias))
        rate = np.array(g.misalignment) @ (np.array(g.scale) * (w_raw - g.bias))
        # The same products summed in another order.
        assert_allclose(f, force, rtol=1e-12, atol=1e-14)
        assert_allclose(w, rate - np.array(g.g_sensitivity) @ force, rtol=1e-12, atol=1e-14)
    assert np.array_equal(calibrated.stamp_ns, raw.stamp_ns)


def test_one_reading_at_a_time_agrees_with_the_batch(rng):
    raw = samples_of(rng)
    batch = calibrate(raw, INTRINSICS)
    A, c = affine(INTRINSICS)
    single = [
        A @ np.concatenate([w, f]) + c
        for w, f in zip(raw.angular_rate, raw.specific_force, strict=True)
    ]
    assert_allclose(np.hstack([batch.angular_rate, batch.specific_force]), single, rtol=1e-12)


def test_no_intrinsics_change_nothing(rng):
    raw = samples_of(rng)
    same = calibrate(raw, None)
    assert np.array_equal(same.angular_rate, raw.angular_rate)
    assert np.array_equal(same.specific_force, raw.specific_force)
