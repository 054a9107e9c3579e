"""Pivot calibration of a pointer: to rounding, against plain least squares, honest, refused."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.errors import CalibrationError
from multiimu_ros.registration.pivot import fit_pivot

TIP, PIVOT = np.array([0.01, -0.02, 0.18]), np.array([0.5, -1.2, 0.9])


def swing(rng, count=100, tilt=0.5):
    """Return rotations of a pointer swung by some `tilt` [rad] about its tip, and positions."""
    R = Rotation.from_rotvec([0.4, 1.0, -0.3]) * Rotation.from_rotvec(
        tilt * rng.standard_normal((count, 3))
    )
    return R, PIVOT - R.apply(TIP)


def test_the_tip_is_found_to_rounding(rng):
    fit = fit_pivot(*swing(rng))
    assert_allclose(fit.tip, TIP, atol=1e-14)
    assert_allclose(fit.pivot, PIVOT, atol=1e-14)


def test_the_tip_solves_the_published_least_squares(rng):
    R, p = swing(rng, 20)
    p = p + 1e-3 * rng.standard_normal(p.shape)
    A = np.concatenate([np.hstack([matrix, -np.eye(3)]) for matrix in R.as_matrix()])
    solution, square, *_ = np.linalg.lstsq(A, -p.ravel(), rcond=None)  # (1), stacked
    fit = fit_pivot(R, p)
    assert_allclose(np.concatenate([fit.tip, fit.pivot]), solution, rtol=1e-10)
    assert_allclose(fit.point_sigma, np.sqrt(square[0] / (60 - 6)), rtol=1e-10)
    covariance = fit.point_sigma**2 * np.linalg.inv(A.T @ A)
    assert_allclose(fit.covariance, covariance[:3, :3], rtol=1e-8, atol=1e-16)


def test_the_covariance_is_honest(rng):
    R, p = swing(rng)
    distances = []
    for _ in range(400):
        # Position and attitude of an optical tracker: 0.2 mm and 0.05 deg.
        seen = R * Rotation.from_rotvec(np.deg2rad(0.05) * rng.standard_normal((100, 3)))
        fit = fit_pivot(seen, p + 2e-4 * rng.standard_normal((100, 3)))
        error = fit.tip - TIP
        distances.append(error @ np.linalg.solve(fit.covariance, error))
    # chi-squared with 3 degrees of freedom: 3 +- sqrt(6 / 400) = 0.12.
    assert abs(np.mean(distances) - 3.0) < 4 * 0.12


def test_poses_that_were_not_seen_are_left_out(rng):
    R, p = swing(rng)
    p[10:30] = np.nan
    assert_allclose(fit_pivot(R, p).tip, TIP, atol=1e-14)


def test_a_pointer_that_turns_about_one_axis_only_is_refused(rng):
    spin = Rotation.from_rotvec(np.outer(rng.uniform(-1, 1, 50), [0.0, 0.0, 1.0]))
    noise = 2e-4 * rng.standard_normal((50, 3))
    with pytest.raises(CalibrationError, match=r'hardly turns across \[0\.00, 0\.00, 1\.00\]'):
        fit_pivot(spin, PIVOT - spin.apply(TIP) + noise)


def test_too_few_poses_and_bad_input_are_named(rng):
    R, p = swing(rng, 3)
    with pytest.raises(CalibrationError, match='needs 3 poses or more, got 2'):
        fit_pivot(R[:2], p[:2])
    with pytest.raises(ValueError, match='one for each of 2 positions, got 3'):
        fit_pivot(R, p[:2])
