"""Is each number of a calibration good enough, and what to do where it is not.

The limits are those at which an error shows: `good` is below what the noise of a cheap IMU hides
in a second, `usable` is what the filters downstream can live with, because their covariances say
so, and `redo` is no better than the data sheet.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from multiimu_ros.calibration.coverage import missing_poses
from multiimu_ros.rig import Imu
from multiimu_ros.rig_calibration.calibrate import Calibration, rest_rms
from multiimu_ros.rig_calibration.intrinsics_stage import IntrinsicsFit

GOOD, USABLE, REDO = 'good', 'usable', 'redo'
GRADES = (GOOD, USABLE, REDO)
DEGREE = 180 / np.pi
# Largest sigma of a `good` and of a `usable` figure, in the unit that is printed.
LIMITS = {
    'accelerometer scale': (300.0, 3000.0),
    'accelerometer misalignment': (0.3, 3.0),
    'accelerometer bias': (5.0, 50.0),
    'gyroscope scale': (1000.0, 5000.0),
    'gyroscope misalignment': (1.0, 5.0),
    'gyroscope bias': (20.0, 200.0),
    'gyroscope g-sensitivity': (5.0, 30.0),
    'rotation': (50.0, 300.0),
    'lever arm': (1.0, 10.0),
    'time offset': (200.0, 2000.0),
    '|f| - g at rest': (5.0, 25.0),
    'gravity after a turn': (150.0, 1000.0),
    'jitter of stamps': (700.0, 3000.0),
    'missing samples': (0.5, 10.0),
    'saturated samples': (2.0, 10.0),
}
SKEW_PPM = 2.0  # beyond it two clocks part by 0.1 ms in a minute
MORE_POSES = 'record longer poses, and more of them'
SLOWER = 'turn the board more smoothly between the poses, by 90 degrees about all axes'
WAVE = 'wave the board about for a minute, turning it fast about all three axes'
REMEDIES = {
    'accelerometer': MORE_POSES,
    'gyroscope': SLOWER,
    'gyroscope bias': MORE_POSES,
    'gyroscope g-sensitivity': MORE_POSES,
    'rotation': MORE_POSES,
    'lever arm': WAVE,
    'time offset': WAVE,
    '|f| - g at rest': 'warm the IMUs up for ten minutes, and lay the board down, off the hand',
    'gravity after a turn': SLOWER,
    'jitter of stamps': 'let the board stamp its readings; lever arms suffer most',
    'missing samples': 'look at the driver and the load; record again',
    'saturated samples': 'turn more slowly, or set a wider range',
}


@dataclass(frozen=True)
class Verdict:
    """One figure of one IMU: value and sigma as people read them, and what to think of it."""

    imu: str
    quantity: str
    value: str
    sigma: str
    unit: str
    grade: str
    why: str
    size: float = 0.0  # what was judged, in `unit`: the largest sigma, or the figure itself


def judge(calibration: Calibration) -> tuple[Verdict, ...]:
    """Return a verdict on every figure that the stages found, IMU by IMU."""
    found: list[Verdict] = []
    for k, imu in enumerate(calibration.after.imus):
        found += _recording(calibration, k, imu)
        if calibration.intrinsics:
            found += _intrinsics(imu, calibration.intrinsics[k])
        found += _placement(calibration, k, imu)
    return tuple(found)


def worst(verdicts: tuple[Verdict, ...]) -> str:
    """Return the worst grade among them."""
    return max((verdict.grade for verdict in verdicts), key=GRADES.index, default=GOOD)


def _graded(imu: Imu, quantity: str, value: ArrayLike, sigma: ArrayLike, unit: str) -> Verdict:
    """Judge an estimate by its worst sigma."""
    good, usable = LIMITS[quantity]
    largest = float(np.max(sigma))
    grade = GOOD if largest <= good else USABLE if largest <= usable else REDO
    why = ''
    if grade != GOOD:
        remedy = REMEDIES.get(quantity) or REMEDIES[quantity.partition(' ')[0]]
        why = f'sigma is {largest:.3g} {unit}, good is {good:g}; {remedy}'
    return Verdict(imu.name, quantity, _text(value), _text(sigma), unit, grade, why, largest)


def _measured(imu: Imu, quantity: str, value: float, unit: str) -> Verdict:
    """Judge a figure that ought to be small."""
    good, usable = LIMITS[quantity]
    grade = GOOD if value <= good else USABLE if value <= usable else REDO
    why = (
        ''
        if grade == GOOD
        else f'{value:.3g} {unit}, good is up to {good:g}; {REMEDIES[quantity]}'
    )
    return Verdict(imu.name, quantity, _text(value), '', unit, grade, why, value)


def _text(value: ArrayLike) -> str:
    return ' '.join(f'{x:.4g}' for x in np.atleast_1d(np.asarray(value, np.float64)))


def _recording(calibration: Calibration, k: int, imu: Imu) -> Iterator[Verdict]:
    track = calibration.board.tracks[k]
    span = float(np.ptp(track.samples.stamp_ns)) * 1e-9
    if track.gaps:
        yield _measured(imu, 'missing samples', 100 * track.missing_s / span, '%')
    if track.saturated:
        share = 100 * track.saturated / len(track.samples)
        yield _measured(imu, 'saturated samples', share, '%')


def _intrinsics(imu: Imu, fit: IntrinsicsFit) -> Iterator[Verdict]:
    known = imu.intrinsics
    if known is None:
        return
    upper = np.triu_indices(3, 1)
    off = ~np.eye(3, dtype=bool)
    a, g = known.accelerometer, known.gyroscope
    triads = (('accelerometer', a, 1e3, 'mm/s^2'), ('gyroscope', g, 1e3 * DEGREE, 'mdeg/s'))
    for name, triad, unit_bias, unit in triads:
        entries = upper if name == 'accelerometer' else np.nonzero(off)
        ppm = 1e6 * (np.array(triad.scale) - 1)
        yield _graded(imu, f'{name} scale', ppm, 1e6 * np.array(triad.scale_sigma), 'ppm from 1')
        M, M_sigma = np.array(triad.misalignment), np.array(triad.misalignment_sigma)
        yield _graded(
            imu, f'{name} misalignment', 1e3 * M[entries], 1e3 * M_sigma[entries], 'mrad'
        )
        bias, sigma = unit_bias * np.array(triad.bias), unit_bias * np.array(triad.bias_sigma)
        yield _graded(imu, f'{name} bias', bias, sigma, unit)
    leak = 1e3 * DEGREE * 9.80665  # mdeg/s per g
    G, G_sigma = np.array(g.g_sensitivity), np.array(g.g_sensitivity_sigma)
    yield _graded(
        imu, 'gyroscope g-sensitivity', leak * G.ravel(), leak * G_sigma.ravel(), 'mdeg/s/g'
    )
    model = fit.fit.accelerometer
    steady = rest_rms(model.residual - model.drift, fit.poses.duration[fit.poses.known])
    yield _with_missing_poses(_measured(imu, '|f| - g at rest', 1e3 * steady, 'mm/s^2'), fit)
    turn = 1e3 * DEGREE * float(np.sqrt(np.mean(np.square(fit.turn_residual))))
    yield _measured(imu, 'gravity after a turn', turn, 'mdeg')


def _with_missing_poses(verdict: Verdict, fit: IntrinsicsFit) -> Verdict:
    """Name the faces that were never on top, where the poses leave something to wish for."""
    felt = fit.poses.specific_force[fit.poses.known]
    lacking = missing_poses(felt / np.linalg.norm(felt, axis=1, keepdims=True))
    faces = [name for name in lacking if len(name) == len('+x up')]
    if not faces:
        return verdict
    why = f'never lay with {", ".join(faces)}'
    grade = USABLE if verdict.grade == GOOD else verdict.grade
    text = f'{verdict.why}; {why}' if verdict.why else why
    return replace(verdict, grade=grade, why=text)


def _placement(calibration: Calibration, k: int, imu: Imu) -> Iterator[Verdict]:
    if k == 0:
        return  # everything is told relative to the first
    pose = imu.extrinsics
    if calibration.mountings and pose is not None and pose.rotation_sigma is not None:
        degrees = DEGREE * np.array(pose.rotation_sigma)
        yield _graded(imu, 'rotation', pose.rotation, 1e3 * degrees, 'mdeg')
    if calibration.lever_arms is not None and pose is not None and pose.lever_arm_sigma:
        sigma = 1e3 * np.array(pose.lever_arm_sigma)
        yield _graded(imu, 'lever arm', 1e3 * pose.lever_arm_b, sigma, 'mm')
    alignment = calibration.alignments[k] if calibration.alignments else None
    if alignment is None or alignment.fine is None:
        return
    offset = 1e6 * imu.time_offset
    yield _graded(imu, 'time offset', offset, 1e6 * (imu.time_offset_sigma or 0.0), 'us')
    yield _measured(imu, 'jitter of stamps', 1e6 * alignment.fine.jitter, 'us')
    ppm, sigma_ppm = 1e6 * alignment.fine.skew, 1e6 * alignment.fine.skew_sigma
    if ppm:
        grade, why = GOOD, ''
        if abs(ppm) > SKEW_PPM:
            grade = USABLE
            why = (
                f'its clock parts from the first by {60e-3 * abs(ppm):.2g} ms a minute, so the '
                f'offset holds for this recording only; stamp all IMUs with one clock'
            )
        yield Verdict(imu.name, 'clock skew', _text(ppm), _text(sigma_ppm), 'ppm', grade, why)
