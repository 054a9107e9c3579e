"""Is each number of a calibration good enough, and what to do where it is not.

The limits are those at which an error shows: `good` is below what the noise of a cheap IMU hides
in a second, `usable` is what the filters downstream can live with, because their covariances say
so, and `redo` is no better than the data sheet.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from multiimu_ros.calibration.cleaning import clean, CleanTrack
from multiimu_ros.calibration.coverage import missing_poses
from multiimu_ros.rig import Imu
from multiimu_ros.rig_calibration.calibrate import Calibration, rest_rms, spread_per_imu
from multiimu_ros.rig_calibration.intrinsics_stage import IntrinsicsFit
from multiimu_ros.rig_calibration.recording_faults import (
    fault_shares,
    looks_like_degrees,
    MISSING,
    SATURATED,
    UNSOUND,
)
from multiimu_ros.rig_calibration.wording import as_text, roll_pitch_yaw
from multiimu_ros.samples import ImuSamples
from multiimu_ros.synchronization.delay import TimeMap

GOOD, USABLE, REDO = 'good', 'usable', 'redo'
GRADES = (GOOD, USABLE, REDO)
AT_REST, TURN, AMONG = '|f| - g at rest', 'gravity after a turn', 'force beside the other IMUs'
ROTATION = 'rotation (roll, pitch, yaw)'
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
    ROTATION: (0.05, 0.3),
    'lever arm': (1.0, 10.0),
    'time offset': (200.0, 2000.0),
    'noise of the accelerometer': (5.0, 20.0),
    'noise of the gyroscope': (5.0, 20.0),
    AT_REST: (5.0, 25.0),
    TURN: (150.0, 1000.0),
    AMONG: (10.0, 50.0),
    'jitter of stamps': (700.0, 3000.0),
    MISSING: (0.5, 10.0),
    SATURATED: (2.0, 10.0),
    UNSOUND: (0.1, 5.0),
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
    'noise': MORE_POSES,
    'rotation': MORE_POSES,
    'lever arm': WAVE,
    'time offset': WAVE,
    AT_REST: 'warm the IMUs up for ten minutes, and lay the board down, off the hand',
    TURN: SLOWER,
    AMONG: 'fix all IMUs to one stiff body, and record again',
    'jitter of stamps': 'let the board stamp its readings, not the program that receives them',
    MISSING: 'look at cable, driver and load of the computer, and record again',
    SATURATED: 'turn more slowly, or set a wider range, and record again',
    UNSOUND: 'look at the driver, which sends NaN or stamps that go back, and record again',
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
    tracks = calibration.board.tracks
    apart = _apart(calibration)
    for k, imu in enumerate(calibration.after.imus):
        found += _recording(imu.name, tracks[k], tracks)
        if calibration.intrinsics:
            found += _intrinsics(imu, calibration.intrinsics[k])
        found += _placement(calibration, k, imu)
        if apart:
            found.append(_measured(imu.name, AMONG, 1e3 * apart[k], 'mm/s^2'))
        if imu.noise is not calibration.before.imus[k].noise:  # that stage makes a new block
            found += _noise(imu)
    return tuple(found)


def why_it_failed(error: str, names: Sequence[str], samples: Sequence[ImuSamples]) -> str:
    """Return the sentence of an error, and with it what is wrong with the recording, if anything.

    Parameters
    ----------
    error : str
        What a stage says that it could not do.
    names : sequence of str
        The K IMUs.
    samples : sequence of K ImuSamples
        What they recorded.
    """
    for name, own in zip(names, samples, strict=True):
        track = clean(own)
        if looks_like_degrees(track.samples):
            return (
                f'`{name}` turned some 57 times less than its rates say: they look like deg/s, '
                f'and must be rad/s; convert them in the driver and record again.'
            )
    tracks = [clean(own) for own in samples]
    faults = [
        verdict
        for name, track in zip(names, tracks, strict=True)
        for verdict in _recording(name, track, tracks)
        if verdict.grade != GOOD
    ]
    if not faults:
        return error
    fault = max(faults, key=lambda verdict: verdict.size)
    return (
        f'{error.rstrip(".?")}; the reason may be that `{fault.imu}` has '
        f'{as_text(fault.size, 3)} % {fault.quantity}: {REMEDIES[fault.quantity]}.'
    )


def worst(verdicts: tuple[Verdict, ...]) -> str:
    """Return the worst grade among them."""
    return max((verdict.grade for verdict in verdicts), key=GRADES.index, default=GOOD)


def _grade(size: float, quantity: str) -> str:
    good, usable = LIMITS[quantity]
    return GOOD if size <= good else USABLE if size <= usable else REDO


def _graded(imu: Imu, quantity: str, value: ArrayLike, sigma: ArrayLike, unit: str) -> Verdict:
    """Judge an estimate by its worst sigma."""
    largest = float(np.max(sigma))
    grade = _grade(largest, quantity)
    why = ''
    if grade != GOOD:
        remedy = REMEDIES.get(quantity) or REMEDIES[_kind(quantity)]
        good = LIMITS[quantity][0]
        why = f'sigma is {as_text(largest, 3)} {unit}, good is up to {good:g}; {remedy}'
    return Verdict(imu.name, quantity, as_text(value), as_text(sigma), unit, grade, why, largest)


def _kind(quantity: str) -> str:
    """Return the key of the remedies that a quantity falls under."""
    return next(key for key in REMEDIES if quantity.startswith(key))


def _measured(name: str, quantity: str, value: float, unit: str) -> Verdict:
    """Judge a figure that ought to be small."""
    grade, good = _grade(value, quantity), LIMITS[quantity][0]
    why = ''
    if grade != GOOD:
        why = f'{as_text(value, 3)} {unit}, good is up to {good:g}; {REMEDIES[quantity]}'
    return Verdict(name, quantity, as_text(value), '', unit, grade, why, value)


def _recording(name: str, track: CleanTrack, tracks: Sequence[CleanTrack]) -> Iterator[Verdict]:
    stamps = [one.samples.stamp_ns for one in tracks if len(one.samples)]
    begin = min((int(own[0]) for own in stamps), default=0)
    end = max((int(own[-1]) for own in stamps), default=0)
    for quantity, share in fault_shares(track, begin, end).items():
        yield _measured(name, quantity, share, '%')


def _apart(calibration: Calibration) -> list[float]:
    """Return how far each IMU's force at rest is from that of all, if they were fitted [m/s^2]."""
    imus = calibration.after.imus
    if not calibration.mountings or any(imu.intrinsics is None for imu in imus):
        return []
    apart = spread_per_imu(calibration.board, calibration.intervals)
    return [rest_rms(own, calibration.intervals.duration_s) for own in apart.T]


def _noise(imu: Imu) -> Iterator[Verdict]:
    """Judge the noise by how far it may be off, in percent; how large it is, is the sensor's."""
    if imu.noise is None or imu.noise.noise_density_sigma is None:
        return
    units = {
        'gyroscope': ('mdeg/s/sqrt(Hz)', 1e3 * DEGREE),
        'accelerometer': ('mm/s^2/sqrt(Hz)', 1e3),
    }
    for triad, (unit, factor) in units.items():
        quantity = f'noise of the {triad}'
        density = np.array(getattr(imu.noise.noise_density, triad))
        sigma = np.array(getattr(imu.noise.noise_density_sigma, triad))
        percent = 100 * float(np.max(sigma / density))
        grade, why = _grade(percent, quantity), ''
        if grade != GOOD:
            good = LIMITS[quantity][0]
            why = f'sigma is {as_text(percent, 3)} %, good is up to {good:g}; {MORE_POSES}'
        value = as_text(factor * density), as_text(factor * sigma)
        yield Verdict(imu.name, quantity, *value, unit, grade, why, percent)


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
        yield _graded(imu, f'{name} scale', ppm, 1e6 * np.array(triad.scale_sigma), 'ppm')
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
    yield _with_missing_poses(_measured(imu.name, AT_REST, 1e3 * steady, 'mm/s^2'), fit)
    turn = 1e3 * DEGREE * float(np.sqrt(np.mean(np.square(fit.turn_residual))))
    yield _measured(imu.name, TURN, turn, 'mdeg')


def _with_missing_poses(verdict: Verdict, fit: IntrinsicsFit) -> Verdict:
    """Name the faces that were never on top, where the poses leave something to wish for."""
    felt = fit.poses.specific_force[fit.poses.known]
    lacking = missing_poses(felt / np.linalg.norm(felt, axis=1, keepdims=True))
    faces = [name for name in lacking if len(name) == len('+x up')]
    if not faces:
        return verdict
    why = f'it never lay with {", ".join(faces)}: record that, too'
    grade = USABLE if verdict.grade == GOOD else verdict.grade
    text = f'{verdict.why}; {why}' if verdict.why else why
    return replace(verdict, grade=grade, why=text)


def _placement(calibration: Calibration, k: int, imu: Imu) -> Iterator[Verdict]:
    pose = imu.extrinsics
    if calibration.lever_arms is not None and pose is not None and np.any(pose.lever_arm_sigma):
        sigma = 1e3 * np.array(pose.lever_arm_sigma)
        yield _graded(imu, 'lever arm', 1e3 * pose.lever_arm_b, sigma, 'mm')
    if k == 0:
        return  # rotations and clocks are told relative to the first
    if calibration.mountings and pose is not None and pose.rotation_sigma is not None:
        sigma = DEGREE * np.array(pose.rotation_sigma)
        yield _graded(imu, ROTATION, roll_pitch_yaw(pose.R_bs), sigma, 'deg')
    alignment = calibration.alignments[k] if calibration.alignments else None
    if alignment is not None and alignment.fine is not None:
        yield from _clock(imu, alignment.fine)


def _clock(imu: Imu, fine: TimeMap) -> Iterator[Verdict]:
    offset = 1e6 * imu.time_offset
    yield _graded(imu, 'time offset', offset, 1e6 * (imu.time_offset_sigma or 0.0), 'us')
    yield _measured(imu.name, 'jitter of stamps', 1e6 * fine.jitter, 'us')
    ppm, sigma = 1e6 * fine.skew, 1e6 * fine.skew_sigma
    if not ppm:
        return
    grade, why = GOOD, ''
    if abs(ppm) > SKEW_PPM:
        grade = USABLE
        why = (
            f'its clock parts from the first by {as_text(60e-3 * abs(ppm), 2)} ms a minute, so '
            f'the offset holds for this recording only; stamp all IMUs with one clock'
        )
    yield Verdict(
        imu.name, 'clock skew', as_text(ppm), as_text(sigma), 'ppm', grade, why, abs(ppm)
    )
