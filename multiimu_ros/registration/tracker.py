"""Registration to an outside-in tracker's target, thesis 6.2.2: offset, rotation, lever arm.

For each IMU, its samples smoothed as the poses are (`pose_stream`), in three steps:

1. time offset: Pearson's correlation of |w|, each lag over its own overlap (`correlation`);
2. rotation: Wahba's problem on rates about their means, which takes the gyro bias out; then
   least squares on w_t(t) = R_ts (w_s(t - offset) - b) for rotation, bias and offset at once;
3. lever arm r: with K r = a x r + w x (w x r), least squares on

       R_ts f_s(t - offset) - R_wt' p'' = R_wt' up + K r + b                               (1)

   for up (gravity turned round, so the tracker need not stand level), r and the bias b.

Residuals are as coloured as derivatives of noise are. So the covariance of a least-squares fit
with rows J and residuals e is the sandwich (J'J)^-1 S (J'J)^-1, where S sums the products of
J_k' e_k over all pairs of instants closer than a few windows (Newey and West [1]_). What step 2
leaves uncertain is taken up by b and up in step 3: on the lever arm's sigma it is below 2 %.

.. [1] W. K. Newey, K. D. West, "A simple, positive semi-definite, heteroskedasticity and
   autocorrelation consistent covariance matrix", Econometrica 55(3), 1987.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Flags, Matrix, NANOSECONDS, Scalars, Stamps, Vector, Vectors
from multiimu_ros.errors import CalibrationError
from multiimu_ros.registration.correlation import correlate_rates
from multiimu_ros.registration.pose_stream import (
    differentiate,
    fit_polynomials,
    TargetMotion,
    TrackerPoses,
    windows_around,
)
from multiimu_ros.registration.wahba import fit_rotation
from multiimu_ros.rig import Extrinsics
from multiimu_ros.samples import ImuSamples

MIN_INSTANTS = 200  # of common motion, for 15 unknowns
LAGS = 3  # windows over which residuals may be correlated


@dataclass(frozen=True, kw_only=True)
class TrackerConfig:
    """Settings of a registration to a tracker.

    Parameters
    ----------
    half_width : float
        Of the windows in which poses are differentiated [s]. At order 6 motion passes within 1 %
        up to 0.45 / half_width [Hz], and half of its power at 0.9 / half_width. White noise of
        the poses at 100 Hz becomes rates of 8.9 and accelerations of 404 times its sigma at 0.15
        s; it grows as half_width^-1.5 and half_width^-2.5, and as the root of the poses' spacing.
    order : int
        Of the polynomials in them.
    min_overlap : float
        What share of the shorter stream the two must have in common [-].
    """

    half_width: float = 0.15
    order: int = 6
    min_overlap: float = 0.5

    def __post_init__(self) -> None:
        if not (self.half_width > 0 and self.order >= 2 and 0 < self.min_overlap <= 1):
            msg = '`half_width` must be positive, `order` 2 or more, `min_overlap` in (0, 1], got '
            msg += f'{self.half_width}, {self.order} and {self.min_overlap}.'
            raise ValueError(msg)


@dataclass(frozen=True)
class TrackerFit:
    """One IMU on the target of a tracker.

    Parameters
    ----------
    extrinsics : Extrinsics
        R_ts and lever arm in the target's frame t, with sigmas.
    time_offset, time_offset_sigma : float
        To be added to the IMU's stamps to put them on the tracker's clock [s].
    up_w : (3,) array
        Gravity turned round in the tracker's frame, as found [m/s^2].
    angular_rate_bias, specific_force_bias : (3,) arrays
        Of the IMU during the recording, in its own frame [rad/s], [m/s^2].
    angular_rate_rms, specific_force_rms : float
        What the fit leaves, per axis, mostly the tracker's noise [rad/s], [m/s^2].
    correlation : float
        Of |w| at the offset [-].
    """

    extrinsics: Extrinsics
    time_offset: float
    time_offset_sigma: float
    up_w: Vector
    angular_rate_bias: Vector
    specific_force_bias: Vector
    angular_rate_rms: float
    specific_force_rms: float
    correlation: float


def fit_tracker(
    poses: TrackerPoses, imus: Mapping[str, ImuSamples], config: TrackerConfig = TrackerConfig()
) -> dict[str, TrackerFit]:
    """Register calibrated IMUs to the target that a tracker saw move with them.

    Parameters
    ----------
    poses : TrackerPoses
        Of the target; drop-outs are NaN or left out.
    imus : mapping of ImuSamples
        Calibrated readings, each in its sensor's frame, by name.
    config : TrackerConfig
        Bandwidth and order of the differentiation.

    Raises
    ------
    CalibrationError
        If the motion cannot determine the pose of an IMU; says what to record instead.
    SyncError
        If the rates of an IMU fit those of the target at no offset.
    """
    motion = differentiate(poses, config.half_width, config.order)
    return {name: _register(name, motion, samples, config) for name, samples in imus.items()}


@dataclass(frozen=True)
class _Smoothed:
    """An IMU at the instants of the poses: smoothed readings and the slope of the rate (N, 3)."""

    rate: Vectors
    rate_slope: Vectors
    force: Vectors


@dataclass(frozen=True)
class _Alignment:
    R_ts: Rotation
    bias: Vector
    offset: float
    covariance: Matrix  # (7, 7) of theta, bias, offset
    rms: float


def _register(
    name: str, motion: TargetMotion, samples: ImuSamples, config: TrackerConfig
) -> TrackerFit:
    times = _seconds(motion.stamp_ns)
    peak = correlate_rates(
        times,
        np.linalg.norm(motion.angular_rate_t, axis=1),
        _seconds(samples.stamp_ns),
        np.linalg.norm(samples.angular_rate, axis=1),
        config.min_overlap,
        name,
    )
    try:
        alignment, smoothed = _align(motion, times, samples, peak.offset, config)
    except CalibrationError as error:
        msg = f'`{name}` cannot be registered to the tracker: {error}'
        raise CalibrationError(msg) from error
    solution, covariance, rms = _fit_lever_arm(motion, smoothed, alignment, config)
    sigma = np.sqrt(np.diag(alignment.covariance))
    extrinsics = Extrinsics.model_validate(
        {
            'rotation': alignment.R_ts.as_quat().tolist(),
            'rotation_sigma': sigma[:3].tolist(),
            'lever_arm': solution[3:6].tolist(),
            'lever_arm_sigma': np.sqrt(np.diag(covariance)[3:6]).tolist(),
        }
    )
    between = int(motion.stamp_ns[0]) - int(samples.stamp_ns[0])  # the clocks may be years apart
    return TrackerFit(
        extrinsics,
        alignment.offset + between / NANOSECONDS,
        float(sigma[6]),
        solution[:3],
        alignment.bias,
        alignment.R_ts.inv().apply(solution[6:]),
        alignment.rms,
        rms,
        peak.correlation,
    )


def _seconds(stamp_ns: Stamps) -> Scalars:
    return np.asarray((stamp_ns - stamp_ns[0]) / NANOSECONDS)


def _smooth(samples: ImuSamples, centres: Scalars, config: TrackerConfig) -> _Smoothed:
    """Smooth an IMU as its target was, at instants since its own first sample [s]."""
    windows = windows_around(_seconds(samples.stamp_ns), centres, config.half_width)
    readings = np.hstack([samples.angular_rate, samples.specific_force])[windows.index]
    fit, _ = fit_polynomials(windows, readings, config.half_width, config.order)
    return _Smoothed(fit[:, 0, :3], fit[:, 1, :3], fit[:, 0, 3:])


def _align(
    motion: TargetMotion,
    times: Scalars,
    samples: ImuSamples,
    offset: float,
    config: TrackerConfig,
) -> tuple[_Alignment, _Smoothed]:
    """Return rotation, gyro bias and offset by least squares on rates, from a first offset."""
    w_t = motion.angular_rate_t
    for _ in range(2):  # the parabola is good to 1 ms, one step to 1 us, two to rounding
        smoothed = _smooth(samples, times - offset, config)
        good: Flags = np.asarray(np.isfinite(w_t + smoothed.rate).all(axis=1), dtype=np.bool_)
        if good.sum() < MIN_INSTANTS:
            msg = f'only {good.sum()} poses have readings beside them, {MIN_INSTANTS} are needed; '
            msg += 'record longer.'
            raise CalibrationError(msg)
        w_s, slope = smoothed.rate, smoothed.rate_slope
        means = w_t[good].mean(axis=0), w_s[good].mean(axis=0)
        R = fit_rotation(w_t[good] - means[0], w_s[good] - means[1]).rotation
        bias = means[1] - R.inv().apply(means[0])
        # e = R' w_t - (w_s - b), linear in theta, b and the offset.
        J = np.concatenate([_skews(w_s - bias), _eyes(len(w_s)), slope[..., np.newaxis]], axis=2)
        step, covariance, rms = _least_squares(
            -J, R.inv().apply(np.nan_to_num(w_t)) - (w_s - bias), good, times, config
        )
        offset += float(step[6])
    alignment = _Alignment(
        R * Rotation.from_rotvec(step[:3]), bias + step[3:6], offset, covariance, rms
    )
    return alignment, smoothed


def _fit_lever_arm(
    motion: TargetMotion, smoothed: _Smoothed, alignment: _Alignment, config: TrackerConfig
) -> tuple[Vector, Matrix, float]:
    """Return up, lever arm and force bias (9,) in t by (1), their covariance, and the rms."""
    R, times = alignment.R_ts, _seconds(motion.stamp_ns)
    R_tw = motion.R_wt.transpose(0, 2, 1)
    # From the gyroscope, for noise in K shortens r: the tracker's shortened it by 0.3 %.
    rate = _skews(_turn(R, smoothed.rate - alignment.bias))
    turn = _skews(_turn(R, smoothed.rate_slope))
    J = np.concatenate([R_tw, turn + rate @ rate, _eyes(len(times))], axis=2)
    y = _turn(R, smoothed.force) - np.einsum('nij,nj->ni', R_tw, motion.acceleration_w)
    good = np.asarray(np.isfinite(y).all(axis=1) & np.isfinite(J).all(axis=(1, 2)), dtype=np.bool_)
    return _least_squares(J, y, good, times, config)


def _least_squares(
    J: Matrix, y: Vectors, good: Flags, times: Scalars, config: TrackerConfig
) -> tuple[Vector, Matrix, float]:
    """Solve y = J x over the good instants; the covariance allows for coloured residuals."""
    J, y, t = J[good], y[good], times[good]
    inverse = np.linalg.inv(np.einsum('nip,niq->pq', J, J))
    x = inverse @ np.einsum('nip,ni->p', J, y)
    residuals = y - J @ x
    scores = np.einsum('nip,ni->np', J, residuals)
    lags = int(np.ceil(2 * LAGS * config.half_width / np.median(np.diff(t))))
    S = scores.T @ scores
    for lag in range(1, min(lags, len(scores) - 1) + 1):
        product = scores[lag:].T @ scores[:-lag]
        S += (1 - lag / (lags + 1)) * (product + product.T)
    rms = float(np.sqrt(np.sum(residuals**2) / (3 * len(y) - len(x))))
    return x, np.asarray(inverse @ S @ inverse), rms


def _skews(v: Vectors) -> Matrix:
    """Return the (N, 3, 3) matrices of the cross products with `v` (N, 3)."""
    S = np.zeros((len(v), 3, 3))
    S[:, 0, 1], S[:, 0, 2], S[:, 1, 2] = -v[:, 2], v[:, 1], -v[:, 0]
    return np.asarray(S - S.transpose(0, 2, 1))


def _eyes(count: int) -> Matrix:
    return np.tile(np.eye(3), (count, 1, 1))


def _turn(R: Rotation, v: Vectors) -> Vectors:
    return np.asarray(v @ R.as_matrix().T)
