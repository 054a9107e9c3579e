"""What a recording of one board suffices for, and what to record instead, before any fit.

The figures follow from where the board rested and how it moved; which of them is enough is said
here, once, for a bag and for a recording under way.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from multiimu_ros.arrays import Vectors
from multiimu_ros.calibration.coverage import (
    CANDIDATES,
    lever_arm_coverage,
    lever_arm_information,
    missing_poses,
    name_direction,
    pose_sigmas,
    rotation_coverage,
    TURN,
)
from multiimu_ros.calibration.rests import Motion
from multiimu_ros.cli.units import find_units

YES, POOR, NO = 'yes', 'poor', 'no'
Figures = dict[str, Any]

NOISE_S = (10.0, 2.0)  # [s] of rest: yes from the first on, poor from the second
ALLAN_S = (3600.0, 600.0)  # white noise to 1 % takes 10 min, the random walk an hour
REST_S = (5.0, 2.0)  # [s] in one piece: 10 times the bias of a gyroscope's flicker
POSES = (12, 9)  # nine parameters, and some poses more to see a misfit
AMPLIFIED = (2.5, 10.0)  # worst parameter over the noise of one pose; 18 even poses have 1
TURNED = (TURN, TURN / 2)  # [rad] about the axis about which it was turned least
SHARED_POSES = (5, 2)  # of two IMUs: two directions fix a rotation, five show an outlier
SPUN = (10.0, 1.0)  # [rad^2/s] integral of rate squared across any axis: 30 s of waving have 50
LEVER = (1e-4, 1e-3)  # [m] that white noise alone leaves
WAVED_S = (15.0, 5.0)  # [s]
OFFSET = (2e-5, 1e-3)  # [s] that white noise alone leaves
CLIPPED = 0.05  # share of readings at the end of the range
LONGEST_S = 60.0  # of waving to ask for at a time
SIDES = {f'{name_direction(v, signed=True)} up': v for v in CANDIDATES}


class Verdict(NamedTuple):
    """Whether a recording suffices for a task: yes, poor or no, why, and what to record."""

    task: str
    answer: str
    why: str
    instead: tuple[str, ...] = ()


def examine_motion(motion: Motion) -> Figures:
    """Return what the preflight knows of one IMU, under the keys that `--json` shows."""
    rests, units = motion.rests, find_units(motion)
    up, new, soon = rests.up_s, rests.is_new, rests.turned_soon
    durations = rests.duration_s
    turns = rotation_coverage(units.rate_unit * rests.turned[soon], up[soon])
    rate, slope, dt = motion.accelerations(units.rate_unit)
    levers = lever_arm_coverage(lever_arm_information(rate, slope, dt))
    noise = motion.noise_density * [units.rate_unit, units.force_unit]
    sharpness = float((np.square(slope).sum(axis=1) * dt).sum())
    spins = np.einsum('qi,qj,q->ij', rate, rate, dt)
    across = np.trace(spins) - np.linalg.eigvalsh(spins)[2]
    return {
        'rest': {
            'first_s': float(durations[0]) if len(rests) else 0.0,
            'longest_s': float(durations.max(initial=0.0)),
            'total_s': float(durations.sum()),
            'count': len(rests),
        },
        'units': {**vars(units), 'complaints': units.complaints()},
        'poses': {
            'distinct': int(new.sum()),
            'up': up[new].tolist(),
            'missing': list(missing_poses(up)),
            'amplification': float(pose_sigmas(up, 1.0, 1.0).max()),
        },
        'turns': {
            'turned_deg': np.rad2deg(turns.turned).tolist(),
            'least_deg': float(np.rad2deg(turns.principal[0])),
            'lacking': list(turns.lacking),
        },
        'waving': {
            'time_s': motion.waving_s(0.5 / units.rate_unit),
            'spun': float(across),
            'weakest': levers.weakest,
            'lever_arm_sigma': float(levers.sigmas(noise[1])[0]),
            'time_offset_sigma': np.sqrt(2.0 / sharpness) * noise[0] if sharpness else np.inf,
        },
        'noise_density': noise.tolist(),
    }


def judge(figures: Mapping[str, Any], companions: int, clipped: float = 0.0) -> list[Verdict]:
    """Say what one IMU's recording suffices for.

    Parameters
    ----------
    figures : mapping
        As of `examine_motion`.
    companions : int
        Other IMUs that move with it.
    clipped : float
        Share of its readings that end the range [-].
    """
    own = [_noise(figures), _allan(figures), _accelerometer(figures), _gyroscope(figures)]
    if not companions:
        return own
    together = [_registration(figures), _lever_arms(figures), _time_offsets(figures)]
    return own + [_less_clipped(verdict, clipped) for verdict in together]


def _grade(value: float, limits: tuple[float, float]) -> str:
    """Return yes, poor or no; limits that fall mean that more is better."""
    good, fair = limits if limits[0] > limits[1] else (-limits[0], -limits[1])
    value = value if limits[0] > limits[1] else -value
    return YES if value >= good else POOR if value >= fair else NO


def _worst(*answers: str) -> str:
    return max(answers, key=[YES, POOR, NO].index)


def _rest(seconds: float, limits: tuple[float, float], how: str) -> tuple[str, ...]:
    return () if seconds >= limits[0] else (f'let it lie still for {limits[0]:g} s {how}',)


def _noise(figures: Mapping[str, Any]) -> Verdict:
    total = figures['rest']['total_s']
    return Verdict(
        'noise density',
        _grade(total, NOISE_S),
        f'{total:.3g} s of rest',
        _rest(total, NOISE_S, 'in all'),
    )


def _allan(figures: Mapping[str, Any]) -> Verdict:
    longest = figures['rest']['longest_s']
    answer = _grade(longest, ALLAN_S)
    instead = () if answer == YES else ('record an hour of rest, as a bag of its own',)
    return Verdict('Allan', answer, f'the longest rest is {longest:.4g} s', instead)


def _accelerometer(figures: Mapping[str, Any]) -> Verdict:
    poses = figures['poses']
    count, amplified = poses['distinct'], poses['amplification']
    answer = _worst(_grade(count, POSES), _grade(amplified, AMPLIFIED))
    spread = (
        'leave parameters open'
        if np.isinf(amplified)
        else f'make {amplified:.2g} of the noise of one'
    )
    needed = () if answer == YES else tuple(_needed(np.array(poses['up']), poses['missing']))
    return Verdict('accelerometer', answer, f'{count} poses, which {spread}', needed)


def _needed(up: Vectors, missing: Sequence[str]) -> Iterator[str]:
    """Yield poses, the most useful first, until with them it suffices."""
    up = up.reshape(-1, 3)
    for name in missing:
        worst = pose_sigmas(up, 1.0, 1.0).max() if len(up) else np.inf
        if len(up) >= POSES[0] and worst <= AMPLIFIED[0]:
            return
        yield pose_in_words(name)
        up = np.vstack([up, SIDES[name]])


def pose_in_words(name: str) -> str:
    """Say how to lay a board so that `+x up` or `+x+y up` holds."""
    down = [f'{"-" if x > 0 else "+"}{"xyz"[k]}' for k, x in enumerate(SIDES[name]) if x]
    if len(down) == 1:
        return f'lay it on its {down[0]} side ({name})'
    return f'prop it on the edge of its {down[0]} and {down[1]} sides ({name})'


def _gyroscope(figures: Mapping[str, Any]) -> Verdict:
    turns, longest = figures['turns'], figures['rest']['longest_s']
    answer = _worst(
        _grade(longest, REST_S),
        _grade(np.deg2rad(turns['least_deg']), TURNED),
        POOR if np.isinf(figures['poses']['amplification']) else YES,
    )
    x, y, z = turns['turned_deg']
    why = f'a rest of {longest:.3g} s; turned by {x:.0f}, {y:.0f}, {z:.0f} deg about x, y, z'
    turn = tuple(
        f'turn it by 90 deg about {axis}, not about the vertical, between two poses'
        for axis in turns['lacking']
    )
    return Verdict('gyroscope', answer, why, _rest(longest, REST_S, 'in one piece') + turn)


def _registration(figures: Mapping[str, Any]) -> Verdict:
    poses, spun = figures['poses']['distinct'], figures['waving']['spun']
    answer = min(_grade(poses, SHARED_POSES), _grade(spun, SPUN), key=[YES, POOR, NO].index)
    instead = () if answer == YES else (f'lay it down in {SHARED_POSES[0]} poses or more',)
    return Verdict('registration', answer, f'{poses} poses shared', instead)


def _lever_arms(figures: Mapping[str, Any]) -> Verdict:
    waving = figures['waving']
    time_s, sigma = waving['time_s'], waving['lever_arm_sigma']
    answer = _worst(_grade(time_s, WAVED_S), _grade(sigma, LEVER))
    left = f'{1e3 * sigma:.2g} mm' if np.isfinite(sigma) else 'all'
    why = f'waved about for {time_s:.3g} s; noise leaves {left} along {waving["weakest"]}'
    if answer == YES:
        return Verdict('lever arms', answer, why)
    lacks = time_s * ((sigma / LEVER[0]) ** 2 - 1) if np.isfinite(sigma) else LONGEST_S / 2
    more = np.clip(max(lacks, WAVED_S[0] - time_s), 5.0, LONGEST_S)
    across = [axis for axis in 'xyz' if axis != waving['weakest']]
    about = ' and '.join(across) if len(across) == 2 and time_s > WAVED_S[1] else 'all axes'
    return Verdict(
        'lever arms', answer, why, (f'wave it about for {more:.0f} s more, about {about}',)
    )


def _time_offsets(figures: Mapping[str, Any]) -> Verdict:
    sigma = figures['waving']['time_offset_sigma']
    answer = _grade(sigma, OFFSET)
    why = f'noise leaves {1e6 * sigma:.2g} us' if np.isfinite(sigma) else 'it was not turned'
    instead = () if answer == YES else ('wave it about briskly, several turns a second',)
    return Verdict('time offsets', answer, why, instead)


def _less_clipped(verdict: Verdict, clipped: float) -> Verdict:
    if clipped <= CLIPPED or verdict.task == 'registration':
        return verdict
    why = f'{verdict.why}; {100 * clipped:.0f} % of its readings end the range'
    instead = (*verdict.instead, 'wave it more gently, or set a wider range')
    return verdict._replace(answer=_worst(verdict.answer, POOR), why=why, instead=instead)


def judge_board(verdicts: Mapping[str, Sequence[Verdict]]) -> list[Verdict]:
    """Return for each task the verdict on the worst IMU of a board, by name if it is not alone."""
    if not verdicts:
        return []
    judged = []
    for same in zip(*verdicts.values(), strict=True):
        worst = _worst(*(verdict.answer for verdict in same))
        index = next(k for k, verdict in enumerate(same) if verdict.answer == worst)
        verdict = same[index]
        if any(other.answer != worst for other in same):
            verdict = verdict._replace(why=f'{list(verdicts)[index]}: {verdict.why}')
        judged.append(verdict)
    return judged
