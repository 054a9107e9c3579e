"""The six-position test: thesis (4.3)-(4.7) written naively, honest sigmas, named mistakes."""

from hypothesis import given, strategies as st
import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import ttest_1samp

from multiimu_ros.calibration.sensor_model import calibrate
from multiimu_ros.calibration.six_position import (
    fit_accelerometer,
    fit_gyroscope,
    fit_two_position,
    INPUTS,
    POSITIONS,
)
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig import GyroscopeTriad, Intrinsics
from multiimu_ros.samples import ImuSamples

G, RATE = 9.81, 1.5  # [m/s^2], [rad/s]
T = np.array([[1.02, 0.01, -0.02], [-0.015, 0.97, 0.005], [0.02, -0.01, 1.01]])
B = np.array([0.3, -0.2, 0.1])
TRUE = np.linalg.inv(T)


def readings_of(reference, linear=T, tilts=None):
    """Return what the six positions read; `tilts` (6, 3) turns the IMU in each [rad]."""
    inputs = reference * INPUTS
    return (inputs if tilts is None else Rotation.from_rotvec(tilts).apply(inputs)) @ linear.T + B


def linear_of(triad):
    return np.array(triad.misalignment) @ np.diag(triad.scale)


def test_at_rest_with_z_up_a_calibrated_accelerometer_reads_plus_g():
    model = Intrinsics(accelerometer=fit_accelerometer(readings_of(G), G).triad)
    rest = ImuSamples(np.array([0]), np.zeros((1, 3)), readings_of(G)[4:5])
    # At rest specific_force_n = [0, 0, +9.81], for gravity_n = [0, 0, -9.81].
    assert_allclose(calibrate(rest, model).specific_force, [[0, 0, 9.81]], rtol=1e-12, atol=1e-12)


def test_the_inverse_model_of_both_triads_is_found_to_rounding():
    for fit in (fit_accelerometer(readings_of(G), G), fit_gyroscope(readings_of(RATE), RATE)):
        assert_allclose(linear_of(fit.triad), TRUE, rtol=1e-12)
        assert_allclose(fit.triad.bias, B, rtol=1e-12)
        assert_allclose(np.diag(fit.triad.misalignment), 1.0, rtol=1e-15)
        assert fit.residual_rms < 1e-14


def test_the_fit_is_the_published_least_squares(rng):
    u = readings_of(G) + 0.01 * rng.standard_normal((6, 3))
    a = G
    A = np.array([[a, -a, 0, 0, 0, 0], [0, 0, a, -a, 0, 0], [0, 0, 0, 0, a, -a], [1] * 6])  # (4.6)
    printed = u.T @ A.T @ np.linalg.inv(A @ A.T)  # (4.4)
    fit = fit_accelerometer(u, G)
    assert_allclose(linear_of(fit.triad), np.linalg.inv(printed[:, :3]), rtol=1e-10)
    assert_allclose(fit.triad.bias, printed[:, 3], rtol=1e-12)
    residual = u.T - printed @ A
    assert_allclose(fit.residual_rms, np.sqrt(np.mean(residual**2)), rtol=1e-9)


def test_with_variances_the_fit_is_the_published_weighted_one(rng):
    sigma = np.array([1.0, 3.0, 2.0, 0.5, 4.0, 1.5]) * 1e-3
    u = readings_of(G) + 0.1 * sigma[:, np.newaxis] * rng.standard_normal((6, 3))  # no tilt to see
    A, P = np.vstack([G * INPUTS.T, np.ones(6)]), np.diag(1 / sigma**2)
    printed = u.T @ P @ A.T @ np.linalg.inv(A @ P @ A.T)  # (4.7)
    fit = fit_accelerometer(u, G, np.repeat(sigma[:, np.newaxis] ** 2, 3, axis=1))
    assert fit.tilt_sigma == 0.0
    assert_allclose(linear_of(fit.triad), np.linalg.inv(printed[:, :3]), rtol=1e-10)
    assert_allclose(fit.triad.bias, printed[:, 3], rtol=1e-10)


def test_two_positions_are_the_published_formulas():
    u = readings_of(G, np.diag(np.diag(T)))
    triad = fit_two_position(u[[0, 2, 4], [0, 1, 2]], u[[1, 3, 5], [0, 1, 2]], G)
    # (4.3): u_up + u_down = 2 B and u_up - u_down = 2 (1 + S) G; the rig's scale is 1 / (1 + S).
    assert_allclose(triad.bias, B, rtol=1e-12)
    assert_allclose(triad.scale, 1 / np.diag(T), rtol=1e-12)
    assert triad.bias_sigma is None


def test_two_positions_have_honest_sigmas(rng):
    sigma = np.array([[0.02, 0.05, 0.01], [0.03, 0.01, 0.02]])
    up, down = np.array([[1.02, 0.97, 1.01], [-1.02, -0.97, -1.01]]) * G + B
    errors = []
    for _ in range(2000):
        noise = sigma * rng.standard_normal((2, 3))
        triad = fit_two_position(up + noise[0], down + noise[1], G, sigma**2)
        errors.append([(np.array(triad.bias) - B) / triad.bias_sigma,
                       (triad.scale - 1 / np.diag(T)) / triad.scale_sigma])  # fmt: skip
    # A standard deviation from 2000 draws: 1 +- 1.6 %.
    assert_allclose(np.std(errors, axis=0), 1.0, atol=4 * 0.016)


def scores(rng, fit_once, count=300):
    """Return mean square error over mean square sigma, (15,), of misalignment, scale, bias."""
    errors, variances = [], []
    truth_m, truth_s = TRUE / np.diag(TRUE), np.diag(TRUE)
    for _ in range(count):
        triad = fit_once(rng).triad
        errors.append([*(np.array(triad.misalignment) - truth_m).ravel(),
                       *(triad.scale - truth_s), *(np.array(triad.bias) - B)])  # fmt: skip
        variances.append([*np.ravel(triad.misalignment_sigma), *triad.scale_sigma,
                          *triad.bias_sigma])  # fmt: skip
    unknown = np.array(errors).std(axis=0) > 0
    assert unknown.sum() == 15 - 3  # the diagonal is 1 by definition
    squares = np.mean(np.square([errors, variances]), axis=1)[:, unknown]
    return squares[0] / squares[1]


def test_sigmas_from_residuals_are_honest(rng):
    ratio = scores(
        rng, lambda rng: fit_accelerometer(readings_of(G) + 0.02 * rng.normal(size=(6, 3)), G)
    )
    # chi-squared with 300 degrees of freedom over one with 1800: 1 +- 8.8 %.
    assert_allclose(ratio, 1.0, atol=4 * 0.088)


def test_sigmas_from_variances_are_honest_or_a_little_wide(rng):
    sigma = rng.uniform(0.5e-3, 3e-3, (6, 3))
    ratio = scores(
        rng,
        lambda rng: fit_gyroscope(
            readings_of(RATE) + sigma * rng.normal(size=(6, 3)), RATE, sigma**2
        ),
    )
    # Chance residuals above their mean pass for tilt: sigmas up to a half wide, never narrow.
    assert np.all(ratio < 1 + 4 * 0.082)
    assert np.all(ratio > 1 / 1.5**2 - 4 * 0.082)


def test_sigmas_of_a_jig_that_is_known_are_honest(rng):
    sigma, tilt = rng.uniform(0.5e-3, 3e-3, (6, 3)), 1e-3

    def fit_once(rng):
        u = readings_of(RATE, tilts=tilt * rng.normal(size=(6, 3)))
        return fit_gyroscope(u + sigma * rng.normal(size=(6, 3)), RATE, sigma**2, tilt_sigma=tilt)

    # chi-squared with 300 degrees of freedom: 1 +- 8.2 %; T is not quite 1 and costs 2 %.
    assert_allclose(scores(rng, fit_once), 1.0, atol=0.02 + 4 * 0.082)


def test_a_jig_that_tilts_from_placement_to_placement_is_found_and_paid_for(rng):
    tilt, sigma = np.deg2rad(0.1), 1e-3
    tilts = []

    def fit_once(rng):
        u = readings_of(G, tilts=tilt * rng.normal(size=(6, 3)))
        fit = fit_accelerometer(u + sigma * rng.normal(size=(6, 3)), G, np.full((6, 3), sigma**2))
        tilts.append(fit.tilt_sigma**2)
        return fit

    ratio = scores(rng, fit_once)
    # 1 +- 8.8 %, as above; T is not quite 1 and costs 2 %.
    assert_allclose(ratio, 1.0, atol=0.02 + 4 * 0.088)
    # The mean square comes out at 6 degrees of freedom each, 300 times: +- 1.7 % and as above.
    assert_allclose(np.sqrt(np.mean(tilts)), tilt, rtol=0.1)


@given(st.integers(0, 2**32 - 1))
def test_the_upper_triangular_convention_is_the_same_model_in_another_frame(seed):
    rng = np.random.default_rng(seed)
    linear = T + 0.02 * rng.standard_normal((3, 3))
    jig = fit_accelerometer(readings_of(G, linear), G)
    own = fit_accelerometer(readings_of(G, linear), G, upper_triangular=True)
    M = np.array(own.triad.misalignment)
    assert np.array_equal(M, np.triu(M))
    assert np.array_equal(np.diag(M), np.ones(3))
    assert_allclose(own.R_js.as_matrix() @ linear_of(own.triad), linear_of(jig.triad), atol=1e-13)
    assert np.array_equal(np.tril(own.triad.misalignment_sigma), np.zeros((3, 3)))


@pytest.mark.long
def test_the_frame_of_the_accelerometer_has_an_honest_sigma(rng):
    clean = fit_accelerometer(readings_of(G), G, upper_triangular=True)
    distances = []
    for _ in range(250):
        u = readings_of(G) + 0.02 * rng.normal(size=(6, 3))
        fit = fit_accelerometer(u, G, np.full((6, 3), 4e-4), upper_triangular=True)
        if fit.tilt_sigma == 0:
            theta = (fit.R_js.inv() * clean.R_js).as_rotvec()
            distances.append(theta @ np.linalg.solve(fit.rotation_covariance, theta))
    # Residuals and estimates of a linear fit are independent, so the selection does not bias:
    # chi-squared with 3 degrees of freedom.
    assert ttest_1samp(distances, 3.0).pvalue > 1e-3


def test_the_gyroscope_follows_into_the_frame_of_the_accelerometer(rng):
    noise = 0.01 * rng.standard_normal((6, 3))
    own = fit_accelerometer(readings_of(G, T.T) + noise, G, upper_triangular=True)
    gyroscope = fit_gyroscope(readings_of(RATE), RATE, accelerometer=own)
    assert_allclose(
        own.R_js.as_matrix() @ linear_of(gyroscope.triad), np.linalg.inv(T), rtol=1e-12
    )
    assert_allclose(gyroscope.rotation_covariance, own.rotation_covariance, atol=1e-20)
    GyroscopeTriad.model_validate(gyroscope.triad.model_dump())  # as the rig file holds it


@pytest.mark.long
def test_the_gyroscope_pays_for_the_uncertain_frame_of_the_accelerometer(rng):
    def fit_once(rng):
        u = readings_of(G, np.eye(3)) + 0.05 * rng.normal(size=(6, 3))
        frame = fit_accelerometer(u, G, upper_triangular=True)
        return fit_gyroscope(
            readings_of(RATE) + 1e-5 * rng.normal(size=(6, 3)), RATE, accelerometer=frame
        )

    # Three of the 12 are biases, and the scales turn with the frame to second order only.
    # The frame has 150 draws of 6 degrees of freedom: sqrt(2 / 150 + 2 / 900) = 12.5 %.
    ratio = scores(rng, fit_once, count=150)
    assert_allclose(ratio[:6], 1.0, atol=4 * 0.125)


@pytest.mark.parametrize('fit', [fit_accelerometer, fit_gyroscope])
def test_a_position_that_is_missing_repeated_or_upside_down_is_named(fit):
    good = readings_of(G)
    for k, name in enumerate(POSITIONS):
        missing, flipped, repeated = good.copy(), good.copy(), good.copy()
        missing[k] = np.nan
        with pytest.raises(CalibrationError, match=rf'Position `\{name}` is missing'):
            fit(missing, G)
        flipped[k] = good[k ^ 1]
        with pytest.raises(CalibrationError, match=rf'Position `\{name}` is upside down'):
            fit(flipped, G)
        other = (k + 2) % 6
        repeated[k] = good[other]
        with pytest.raises(
            CalibrationError, match=rf'Position `\{name}` repeats `\{POSITIONS[other]}`'
        ):
            fit(repeated, G)


def test_a_position_that_is_exchanged_or_tilted_is_named():
    with pytest.raises(CalibrationError, match=r'Position `\+x` shows \+z; record \+x up there'):
        fit_accelerometer(readings_of(G)[[4, 5, 2, 3, 0, 1]], G)
    tilts = np.zeros((6, 3))
    tilts[2] = [0.7, 0.0, 0.0]  # 40 deg
    with pytest.raises(CalibrationError, match=r'Position `\+y` points no axis straight up'):
        fit_accelerometer(readings_of(G, tilts=tilts), G)
    with pytest.raises(CalibrationError, match=r'Position `\+x` points no axis straight up'):
        fit_accelerometer(readings_of(1.0), G)  # in units of g
    with pytest.raises(CalibrationError, match=r'Axis y reads .* upside down'):
        fit_two_position(np.array([G, -G, G]), np.array([-G, G, -G]), G)


def test_a_tilt_without_variances_is_refused():
    with pytest.raises(ValueError, match='`tilt_sigma` needs `variances`'):
        fit_accelerometer(readings_of(G), G, tilt_sigma=1e-3)


def test_bad_input_is_named_in_the_message():
    with pytest.raises(ValueError, match=r'`readings` must have shape \(6, 3\)'):
        fit_accelerometer(np.zeros((5, 3)), G)
    with pytest.raises(ValueError, match='must be positive and finite, got -1'):
        fit_gyroscope(readings_of(G), -1.0)
    with pytest.raises(ValueError, match=r'`variances` must be positive and finite, got 0\.0'):
        fit_accelerometer(readings_of(G), G, np.zeros((6, 3)))
