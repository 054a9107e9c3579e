"""How IMUs are turned against the first: within their sigma, and from both sources."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from rig_runs import calibrated, recorded, rests_of, true_mountings, turn_between
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from multiimu_ros.calibration.sensor_model import affine
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig import GyroscopeTriad, Intrinsics, Triad
from multiimu_ros.rig_calibration.motion import common_motion, CommonMotion
from multiimu_ros.rig_calibration.rotation_stage import error_modes, fit_mountings

SEEDS = (0, 1)


def errors_of(seed):
    """Return rotation errors over sigma (K - 1, 3), and the errors [rad]."""
    true, _ = true_mountings(seed)
    found = calibrated(seed).mountings
    theta = [turn_between(m.R, R) for m, R in zip(found[1:], true[1:], strict=True)]
    sigma = [np.sqrt(np.diag(m.covariance)) for m in found[1:]]
    return np.array(theta) / sigma, np.array(theta)


def test_rotations_are_within_their_sigma_and_a_hundredth_of_a_degree():
    z, theta = (np.concatenate(part) for part in zip(*map(errors_of, SEEDS), strict=True))
    assert np.rad2deg(np.abs(theta)).max() < 0.01
    assert np.sum(z**2) < chi2(z.size).ppf(1 - 1e-3)
    for seed in SEEDS:
        for mounting in calibrated(seed).mountings[1:]:
            # 0.0023 deg from gravity, 0.0035 from the rates, three axes, and three sigma.
            assert np.rad2deg(mounting.disagreement) < 3 * np.sqrt(3) * 0.0042


def test_the_share_of_the_accelerometers_does_not_average_out():
    # Both rotations stand on them: the mean is hardly better known than gravity alone says.
    run = calibrated(0)
    rates = common_motion(run.board)
    silent = CommonMotion(rates.grid, np.full_like(rates.readings, np.nan))
    alone = fit_mountings(run.board, run.intervals, silent)
    for both, gravity in zip(run.mountings[1:], alone[1:], strict=True):
        ratio = np.sqrt(np.trace(both.covariance) / np.trace(gravity.covariance))
        assert 0.9 < ratio < 1.05
        assert np.isnan(gravity.disagreement)


def test_rates_alone_tell_the_rotation():
    run = calibrated(0)
    nowhere = rests_of(run.board, (1e6, 1e6 + 3))
    found = fit_mountings(run.board, nowhere, common_motion(run.board))
    true, _ = true_mountings(0)
    for mounting, R in zip(found[1:], true[1:], strict=True):
        assert np.linalg.norm(turn_between(mounting.R, R)) < np.deg2rad(0.02)


def test_without_poses_and_motion_the_imu_is_named():
    run = calibrated(0)
    motion = common_motion(run.board)
    silent = CommonMotion(motion.grid, np.full_like(motion.readings, np.nan))
    with pytest.raises(
        CalibrationError, match='Nothing tells how `imu1` is turned against `imu0`'
    ):
        fit_mountings(run.board, rests_of(run.board, (1.0, 5.0)), silent)


def triad_like(rng, kind):
    M = np.eye(3) + 0.01 * rng.standard_normal((3, 3)) * (1 - np.eye(3))
    return kind(
        misalignment=M.tolist(),
        misalignment_sigma=(2e-4 * (1 - np.eye(3))).tolist(),
        scale=tuple(1 + 0.02 * rng.standard_normal(3)),
        scale_sigma=(1e-4, 2e-4, 3e-4),
        bias=tuple(rng.standard_normal(3)),
        bias_sigma=(1e-3, 2e-3, 3e-3),
    )


@pytest.mark.parametrize(('name', 'rows'), [('accelerometer', 3), ('gyroscope', 0)])
def test_error_modes_are_the_derivatives_of_the_sensor_model(rng, name, rows):
    triad = triad_like(rng, Triad if rows else GyroscopeTriad)
    raw = rng.standard_normal(3)
    part = slice(rows, rows + 3)

    def apply(triad):
        A, c = affine(Intrinsics(**{name: triad}))
        return A[part, part] @ raw + c[part]

    def moved(key, index, by):
        values = np.array(getattr(triad, key))
        values[index] += by * np.array(getattr(triad, f'{key}_sigma'))[index]
        return apply(triad.model_copy(update={key: values.tolist()}))

    v = apply(triad)
    places = [('scale', j) for j in range(3)]
    places += [('misalignment', ij) for ij, s in np.ndenumerate(triad.misalignment_sigma) if s]
    places += [('bias', j) for j in range(3)]
    modes = list(error_modes(triad))
    assert len(modes) == len(places) == 12
    for (D, d), (key, index) in zip(modes, places, strict=True):
        difference = (moved(key, index, 0.5) - moved(key, index, -0.5)) / 1.0
        # The model is linear in each parameter: only rounding is left.
        assert_allclose(D @ v + d, difference, rtol=0, atol=1e-12)


def test_a_turn_of_one_imu_turns_its_mounting(rng):
    run = calibrated(0)
    motion = common_motion(run.board)
    turn = Rotation.random(random_state=5)
    turned = motion.readings.copy()
    for part in (slice(0, 3), slice(3, 6)):
        turned[:, 1, part] = turn.apply(turned[:, 1, part])
    nowhere = rests_of(run.board, (1e6, 1e6 + 3))
    before = fit_mountings(run.board, nowhere, motion)[1].R
    after = fit_mountings(run.board, nowhere, CommonMotion(motion.grid, turned))[1].R
    assert_allclose(after, before @ turn.as_matrix().T, rtol=0, atol=1e-9)
    assert len(recorded(0).raw) == len(run.mountings)
