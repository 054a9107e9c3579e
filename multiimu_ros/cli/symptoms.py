"""What is wrong with one topic of a running graph, and what to do: numbers in, sentences out.

The figures are those of `multiimu inspect`, with what only a running graph can tell.  A rig rests
where its specific force hardly scatters; its mean then points up, whatever the unit.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from multiimu_ros.arrays import Scalars, Vector
from multiimu_ros.cli.inspect import inspect_track, TURN
from multiimu_ros.nodes.heard import ImuTopic

ERROR, WARNING, HINT = 'error', 'warning', 'hint'
AT_REST = 0.02  # scatter of the force over its mean: 1 degree of sway, five times a cheap noise
STUCK = 20  # samples, all alike: noise never does that
STALE_S = 0.5  # what is older is of no use to a controller
AHEAD_S = 0.01  # two machines on NTP agree better
UNSTEADY = 0.25  # periods by which steps may scatter
ACROSS = 0.2  # [rad/s] across gravity, which stands still: four times the worst bias (rig.py)
SCALE = 0.05  # of gravity: what a nominal scale and bias may be off (rig.py)
FIELDS = ('orientation', 'angular_velocity', 'linear_acceleration')
UPRIGHT = np.cos(np.deg2rad(20.0))
Figures = dict[str, Any]


class Finding(NamedTuple):
    """One thing that is wrong: how bad, with what, and what to do."""

    level: str
    subject: str
    text: str


# How bad, when to say so, and in which words; the names are figures of `examine`.
SYMPTOMS: tuple[tuple[str, Callable[[Figures], bool], str], ...] = (
    (
        ERROR,
        lambda f: f['malformed'],
        '{malformed} messages are no sensor_msgs/Imu; build both sides against one version.',
    ),
    (
        ERROR,
        lambda f: f['unstamped'],
        (
            '{unstamped} messages carry no stamp; let the driver write the instant of the '
            'measurement into header.stamp.'
        ),
    ),
    (
        ERROR,
        lambda f: f['not_finite'],
        '{not_finite} messages hold a NaN or infinity; let the driver drop such readings.',
    ),
    (
        ERROR,
        lambda f: f['stuck'],
        'every message says the same; unplug the sensor and plug it in again.',
    ),
    (ERROR, lambda f: f['backward'], '{backward} stamps go back; let only one clock stamp them.'),
    (
        WARNING,
        lambda f: f['duplicate'],
        '{duplicate} stamps repeat; let the driver send each reading once.',
    ),
    (
        WARNING,
        lambda f: f['gaps'],
        '{gaps} gaps, the longest {longest_gap_s:.2g} s; look at the driver and at the load.',
    ),
    (
        WARNING,
        lambda f: f['jitter_s'] > UNSTEADY / f['rate_hz'],
        (
            'steps between stamps scatter by {jitter_s:.2g} s at {rate_hz:.0f} Hz; let the board '
            'stamp its readings, not the program that receives them.'
        ),
    ),
    (
        WARNING,
        lambda f: f['age_s'] > STALE_S,
        'stamps are {age_s:.2g} s old; where no bag is being played, set the clock of the driver.',
    ),
    (
        WARNING,
        lambda f: f['age_s'] < -AHEAD_S,
        'stamps lie {ahead_s:.2g} s in the future; synchronise the clocks (chrony).',
    ),
    (
        ERROR,
        lambda f: 0.5 < f['median_force'] < 1.5,
        'the force is {median_force:.2g}: that is g, and must be m/s^2; multiply by 9.80665.',
    ),
    (
        ERROR,
        lambda f: f['median_force'] <= 0.5,
        (
            'the force is {median_force:.2g} m/s^2: gravity was taken out; publish what the '
            'accelerometer feels.'
        ),
    ),
    (
        ERROR,
        lambda f: f['median_force'] > 100.0,
        'the force is {median_force:.2g}: these are counts or milli-g, and must be m/s^2.',
    ),
    (
        ERROR,
        lambda f: f['median_rate'] > TURN or f['across'] > ACROSS,
        (
            'the rate is {median_rate:.2g}, which the force does not confirm: it looks like deg/s '
            'and must be rad/s; multiply by pi/180.'
        ),
    ),
    (
        WARNING,
        lambda f: f['resting'] and f['misfit'] > SCALE and 1.5 < f['median_force'] <= 100.0,
        (
            'at rest it reads {median_force:.3g} m/s^2, not {gravity:.3g}; compare the range that '
            'is set with the one that the driver assumes, then calibrate.'
        ),
    ),
    (
        WARNING,
        lambda f: not f['resting'] and f['saturated_rate'] + f['saturated_force'],
        'readings end the range; set a wider one, or move less.',
    ),
    (WARNING, lambda f: not f['frame_id'], 'its frame_id is empty; set `frame_id` in the driver.'),
    (
        WARNING,
        lambda f: f['frame_id'].startswith('/'),
        'its frame_id `{frame_id}` begins with a slash, which tf2 refuses; drop it.',
    ),
    (
        ERROR,
        lambda f: f['frames'] > 1,
        'it carries {frames} frames; give each IMU a topic of its own.',
    ),
    (
        ERROR,
        lambda f: f['publishers'] > 1,
        '{publishers} nodes publish it; stop all but one.',
    ),
)


def examine(
    imu: ImuTopic, gravity: float = 9.80665, *, simulated_time: bool = False
) -> tuple[Figures, list[Finding]]:
    """Return the figures of one topic, and a finding for all that looks wrong.

    Parameters
    ----------
    gravity : float
        What it must read at rest [m/s^2].
    simulated_time : bool
        Its stamps are not of this machine's clock; their age is not judged.
    """
    figures = _figures(imu, gravity, simulated_time)
    topic = imu.track.topic
    if imu.silence:
        return figures, [Finding(ERROR, topic, imu.silence)]
    found = [
        Finding(level, topic, text.format(**figures))
        for level, wrong, text in SYMPTOMS
        if wrong(figures)
    ]
    if len(imu.covariances):
        found += [Finding(level, topic, text) for level, text in lint_covariances(imu)]
    return figures, found


def _figures(imu: ImuTopic, gravity: float, simulated_time: bool) -> Figures:
    samples = imu.track.samples
    stamped = samples.stamp_ns > 0
    track = replace(
        imu.track, samples=samples.select(stamped), received_ns=imu.track.received_ns[stamped]
    )
    readings = np.hstack([samples.angular_rate, samples.specific_force])
    finite = np.isfinite(readings).all(axis=1)
    up, across = _attitude(readings[finite])
    rate, force = np.linalg.norm(readings[finite].reshape(-1, 2, 3), axis=2).T
    median_rate, median_force = map(_median, (rate, force))  # unstamped readings count, too
    figures = inspect_track(track)
    age_s = float('nan') if simulated_time else figures['clock_offset_s']
    return figures | {
        'stage': imu.stage,
        'count': len(samples),
        'malformed': imu.malformed,
        'unstamped': int((~stamped).sum()),
        'not_finite': int((~finite).sum()),
        'stuck': len(readings) >= STUCK and bool((readings == readings[0]).all()),
        'median_rate': median_rate,
        'median_force': median_force,
        'age_s': age_s,
        'ahead_s': -age_s,
        'resting': up is not None,
        'up': None if up is None else up.tolist(),
        'across': across,
        'gravity': gravity,
        'misfit': abs(median_force / gravity - 1.0),
        'frames': len(imu.frames),
        'publishers': len(imu.publishers),
        'subscribers': len(imu.subscribers),
    }


def _median(values: Scalars) -> float:
    return float(np.median(values)) if len(values) else float('nan')


def _attitude(readings: NDArray[np.float64]) -> tuple[Vector | None, float]:
    """Return which way is up at rest, and how fast the gyroscope claims to turn across it.

    Turning about the vertical leaves the force where it is; turning across it does not.
    """
    if not len(readings):
        return None, 0.0
    rate, force = readings.mean(axis=0).reshape(2, 3)
    length = np.linalg.norm(force)
    if np.linalg.norm(readings[:, 3:].std(axis=0)) >= AT_REST * length:
        return None, 0.0
    up = force / length
    return up, float(np.linalg.norm(rate - up * rate.dot(up)))


def name_axis(up: Vector) -> str:
    """Say which axis of a resting sensor points which way: `z up`, `x down`, or `tilted`."""
    axis = int(np.argmax(np.abs(up)))
    if abs(up[axis]) < UPRIGHT:
        return 'tilted'
    return f'{"xyz"[axis]} {"up" if up[axis] > 0 else "down"}'


def lint_covariances(imu: ImuTopic) -> Iterator[tuple[str, str]]:
    """Yield how bad each covariance is that no filter should trust, and why (REP 145)."""
    for k, name in enumerate(FIELDS):
        field = f'{name}_covariance'
        matrices = imu.covariances[:, k]
        present = matrices[matrices[:, 0, 0] != -1.0]
        if len(present):
            problem = _flaw(present)
            if problem:
                yield ERROR, f'{field} {problem}; correct what fills it in.'
        elif k or imu.stage == 'fused':
            yield WARNING, f'{field}[0] is -1: there is no {name}, and consumers will not use it.'
    yield from _lint_unknown(imu)


def _flaw(matrices: NDArray[np.float64]) -> str:
    """Return what is wrong with some (N, 3, 3) covariances; nothing if they may be true."""
    if not np.isfinite(matrices).all():
        return 'holds a NaN or infinity'
    if (np.diagonal(matrices, axis1=1, axis2=2) < 0).any():
        return 'has a negative variance'
    rounding = 1e-9 * np.abs(matrices).max()
    if np.abs(matrices - matrices.transpose(0, 2, 1)).max() > rounding:
        return 'is not symmetric'
    if np.linalg.eigvalsh(matrices[-1]).min() < -rounding:
        return 'is not positive semi-definite'
    return ''


def _lint_unknown(imu: ImuTopic) -> Iterator[tuple[str, str]]:
    """Yield what is wrong with the zeros of the last message: zeros mean unknown."""
    unknown = [
        name for name, last in zip(FIELDS, imu.covariances[-1], strict=True) if not last.any()
    ]
    if imu.stage in ('raw', 'other') and 'orientation' in unknown:
        if abs(np.linalg.norm(imu.orientation[-1]) - 1.0) > 1e-3:
            yield (
                WARNING,
                (
                    'orientation is no unit quaternion, and orientation_covariance does not '
                    'say so; set orientation_covariance[0] to -1.'
                ),
            )
    elif imu.stage in ('calibrated', 'registered', 'fused') and unknown:
        yield (
            WARNING,
            (
                f'the covariance of {" and ".join(unknown)} is zero, which means unknown; '
                'give `noise` in the rig file.'
            ),
        )
