"""Thesis 9.1.3: zero-velocity updates on a table, on a foot and in a hand, and none at all.

The thesis resets the velocity wherever the rate is below a threshold (9.6), shows that a board at
rest drifts without that (Figures 9.8 to 9.11), and borrows a picture of a walk (9.3).  It prints
no errors.  Here the same reset is tried on three motions with one threshold: as printed, with a
duration that it must last, and with the likelihood ratio of IJAMCE (8) in its place.
"""

from typing import NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from multiimu_ros.arrays import Flags, Matrix, Vectors
from multiimu_ros.experiments.board import DEGREE, Progress, registered, rms
from multiimu_ros.experiments.foot_walk import carry, RATE_HZ, run_chain, Walk
from multiimu_ros.odometry.attitude import level
from multiimu_ros.odometry.strapdown import attitude_rk4
from multiimu_ros.odometry.zero_velocity import glrt_statistic, GlrtConfig, SHORTEST
from multiimu_ros.pipeline_config import PipelineConfig, ProfileName
from multiimu_ros.report.experiment_figures import Boxes, Line, Panel, Picture
from multiimu_ros.report.experiment_page import Cell, Result, Table
from multiimu_ros.simulation.gait import duration_of
from multiimu_ros.simulation.trajectories import trajectory

BOARDS = 8
ALIGNING = 3.0  # [s] of rest from which level, gyro bias and gravity are taken
SLOW = 0.6  # [rad/s] the threshold of (9.6); the thesis prints none, a stance rolls at 0.1 to 0.3
LASTING = 0.1  # [s] a foot in mid-swing is slow for up to 0.06 s
DISTANCE = 40.0  # [m] of the walk


class Case(NamedTuple):
    """One kind of motion: its name, duration [s], profile of the chain, `rough` of `make_walk`."""

    motion: str
    duration: float
    profile: ProfileName
    rough: bool


CASES = {
    'table, at rest': Case('static', 60.0, 'hand', False),
    'foot, walking': Case('foot_rough', duration_of(DISTANCE), 'foot', True),
    # One bout of 6 to 7.5 s: a hand that is not laid down.
    'hand, no rest': Case('hand', 12.0, 'hand', False),
}
SCHEMES = ('no update', 'rate, as printed', 'rate, for 0.1 s', 'likelihood ratio', 'error state')
RESETS = SCHEMES[:4]  # those that reset; the last is the chain's filter
# IJAMCE (8) with its threshold, 0.3e-5 read as 0.3e5, and the sigmas of Skog et al. (2010).
RATIO = GlrtConfig(
    angular_rate_sigma=0.1 * DEGREE,
    specific_force_sigma=0.01,
    resting_rate_sigma=0.1 * DEGREE,
    resting_force_sigma=0.01,
    threshold=0.3e5,
)


class Found(NamedTuple):
    """One walk under one scheme: errors (N, 3) of velocity and position, NaN where unknown."""

    velocity: Vectors
    position: Vectors


def run(seed: int, progress: Progress, *, boards: int = BOARDS) -> Result:
    """Rerun the comparison with newly drawn IMUs and motions."""
    errors = np.empty((boards, len(CASES), len(SCHEMES), 2))  # end, rms along the path [m]
    shown: dict[str, tuple[Walk, dict[str, Found]]] = {}
    for k in range(boards):
        for c, (name, case) in enumerate(CASES.items()):
            rng = np.random.default_rng([seed, k, c])
            path = trajectory(case.motion, case.duration, int(rng.integers(2**31)))
            walk = carry(path, rng, rough=case.rough, count=1)
            found = _all_schemes(walk, case)
            shown.setdefault(name, (walk, found))
            for s, scheme in enumerate(SCHEMES):
                errors[k, c, s] = _scored(walk, found[scheme].position)
            progress((k * len(CASES) + c + 1) / (boards * len(CASES)))
    return _result(errors, shown, seed)


def _all_schemes(walk: Walk, case: Case) -> dict[str, Found]:
    values = registered(walk.rig, walk.raw)[:, 0]
    truth = walk.trajectory.at(walk.times)
    acceleration = acceleration_n(values)
    found: dict[str, Found] = {}
    for scheme, still in zip(RESETS, flags(values), strict=True):
        velocity, position = reset(acceleration, still)
        found[scheme] = Found(velocity - truth.velocity_n, position - truth.position_n)
    track = run_chain(walk, PipelineConfig(profile=case.profile))
    said = np.column_stack([np.interp(walk.times, track.times, x) for x in track.position_n.T])
    found[SCHEMES[-1]] = Found(np.full_like(said, np.nan), said - truth.position_n)
    return found


def _scored(walk: Walk, error: Vectors) -> Matrix:
    """Return the error at the end of the motion and its rms along the path, (2,) [m]."""
    moving = (walk.times > ALIGNING) & (walk.times <= walk.end + 1e-9)
    if not moving.any():  # a board at rest: all of it
        moving = walk.times > ALIGNING
    length = np.linalg.norm(error[moving], axis=1)
    return np.array([length[-1], rms(length)])


def acceleration_n(values: Vectors) -> Vectors:
    """Return the acceleration (N, 3) of one IMU (N, 6): (9.1) by Runge-Kutta, then (9.4)."""
    first = round(ALIGNING * RATE_HZ)
    force = values[:, 3:]
    rate = values[:, :3] - values[:first, :3].mean(axis=0)
    start = force[:first].mean(axis=0)
    attitude = attitude_rk4(level(start), rate, np.full(len(rate) - 1, 1 / RATE_HZ))
    gravity = np.array([0.0, 0.0, np.linalg.norm(start)])
    return np.asarray(np.einsum('nij,nj->ni', attitude, force) - gravity)


def flags(values: Vectors) -> tuple[Flags, ...]:
    """Return where each of the schemes that reset takes an IMU (N, 6) for still, (N,) each."""
    rate = values[:, :3] - values[: round(ALIGNING * RATE_HZ), :3].mean(axis=0)
    slow = np.linalg.norm(rate, axis=1) < SLOW
    ratio = np.zeros(len(values), dtype=bool)
    ratio[SHORTEST - 1 :] = glrt_statistic(rate, values[:, 3:], RATIO) < RATIO.threshold
    return np.zeros(len(values), dtype=bool), slow, lasting(slow, round(LASTING * RATE_HZ)), ratio


def lasting(slow: Flags, count: int) -> Flags:
    """Flag the instants (N,) at which the last `count` flags were all set."""
    run_length = np.convolve(slow, np.ones(count))[: len(slow)]
    return np.asarray(run_length > count - 0.5)


def reset(acceleration: Vectors, still: Flags) -> tuple[Vectors, Vectors]:
    """Return velocity and position (N, 3) from rest; the velocity is zero where `still` (N,)."""
    free = cumulative_trapezoid(acceleration, dx=1 / RATE_HZ, axis=0, initial=0)
    last = np.maximum.accumulate(np.where(still, np.arange(len(still)), 0))
    velocity = free - free[last]
    return velocity, cumulative_trapezoid(velocity, dx=1 / RATE_HZ, axis=0, initial=0)


def _result(errors: Matrix, shown: dict[str, tuple[Walk, dict[str, Found]]], seed: int) -> Result:
    over = rms(errors, axis=0)  # (cases, schemes, 2)
    return Result(
        name='zupt',
        title='Zero-velocity updates, and none',
        source='Thesis 9.1.3, eq. (9.6), Figures 9.3 and 9.8 to 9.11; IJAMCE eq. (8).',
        question='What does setting the velocity to zero gain, and where does it harm?',
        answer=_answer(over),
        setting=(
            f'One newly drawn BMI160, calibrated by the simulated calibration, {RATE_HZ:g} Hz, '
            f'{len(errors)} times: a minute on a table; a rough walk of {DISTANCE:g} m around a '
            'loop; a hand that waves for 6 to 7.5 s and is not laid down. Attitude by '
            'Runge-Kutta (9.1), gravity removed (9.4), integrated twice. "No update" does no '
            f'more; "as printed" sets the velocity to zero wherever the rate is below {SLOW:g} '
            f'rad/s (9.6), "for {LASTING:g} s" where it has been for as long, "likelihood ratio" '
            'where IJAMCE (8) with its threshold of 0.3e5 says so. "Error state" is the filter of '
            'this package, profile foot on the foot and hand elsewhere. Errors are rms over the '
            'runs; the path error is the rms from the start of the motion to its end.'
        ),
        seed=seed,
        tables=tuple(_table(over, c, name) for c, name in enumerate(CASES)),
        pictures=_pictures(errors, shown),
        differs=_differs(over),
    )


def _table(over: Matrix, case: int, name: str) -> Table:
    rows: list[dict[str, Cell]] = []
    for scheme, (end, path) in zip(SCHEMES, over[case].tolist(), strict=True):
        rows.append({'velocity update': scheme, 'ours, end [m]': end, 'ours, path [m]': path})
    return Table(title=f'Error of the position, {name}; the thesis prints none', rows=tuple(rows))


def _answer(over: Matrix) -> str:
    table, hand = over[0, :, 0], over[2, :, 0]
    path = over[1, :, 1]
    return (
        f'On a table it takes {table[0]:.0f} m of drift in a minute to less than '
        f'{max(1e3 * table[1:].max(), 1.0):.0f} mm, along a walk {path[0]:.1f} m to '
        f'{path[2]:.1f} m if the rate must be small for {LASTING:g} s, and to {path[1]:.1f} m as '
        f'printed; in a hand that never rests it makes {hand[0]:.2f} m into {hand[1]:.1f} m.'
    )


def _pictures(
    errors: Matrix, shown: dict[str, tuple[Walk, dict[str, Found]]]
) -> tuple[Picture, ...]:
    names = list(CASES)
    return (_still_board(*shown[names[0]]), _swing(*shown[names[1]]), _spread(errors))


def _still_board(walk: Walk, found: dict[str, Found]) -> Picture:
    after = walk.times > ALIGNING
    panels = tuple(
        Panel(
            title=title,
            x_label='time [s]',
            y_label=unit,
            lines=tuple(
                Line(label=label, x=walk.times[after],
                     y=np.linalg.norm(getattr(found[scheme], quantity)[after], axis=1),
                     role=role)
                for scheme, label, role in (('no update', 'without', 'single'),
                                            ('rate, as printed', 'with updates', 'array'))
            ),
        )
        for quantity, title, unit in (('velocity', 'velocity (9.10)', 'error [m/s]'),
                                      ('position', 'position (9.11)', 'error [m]'))
    )  # fmt: skip
    caption = (
        'A board at rest, one IMU. Without updates what is left of bias and tilt grows with time '
        'and with its square; with them neither moves.'
    )
    return Picture(title='On the table (Figures 9.8 to 9.11)', caption=caption, panels=panels)


def _swing(walk: Walk, found: dict[str, Found]) -> Picture:
    begin = 12.0
    seen = (walk.times >= begin) & (walk.times < begin + 4.0)
    truth = np.linalg.norm(walk.trajectory.at(walk.times[seen]).velocity_n, axis=1)
    exact = walk.trajectory.at(walk.times).velocity_n
    lines = [Line(label='truth', x=walk.times[seen], y=truth, role='ideal', dashed=True)]
    for scheme, role in zip(RESETS, ('other', 'single', 'mean', 'array'), strict=True):
        speed = np.linalg.norm((found[scheme].velocity + exact)[seen], axis=1)
        lines.append(Line(label=scheme, x=walk.times[seen], y=speed, role=role))
    caption = (
        'Three strides of one walk. Where a swinging foot turns neither way the printed rule '
        'stops it, and so may the likelihood ratio, for the foot does not speed up there either: '
        'the rest of the stride is lost. A rule that must last waits for the stance.'
    )
    speed = Panel(title='', x_label='time [s]', y_label='speed [m/s]', lines=tuple(lines))
    return Picture(title='On the foot (Figure 9.3)', caption=caption, panels=(speed,))


def _spread(errors: Matrix) -> Picture:
    roles = ('other', 'single', 'mean', 'array', 'array')
    panels = tuple(
        Boxes(
            title=name,
            y_label='path error [m]',
            values={scheme: errors[:, c, s, 1] for s, scheme in enumerate(SCHEMES)},
            roles=roles,
            log_y=True,
        )
        for c, name in enumerate(CASES)
        if c > 0
    )
    caption = f'{len(errors)} runs each; boxes from quartile to quartile. Logarithmic.'
    return Picture(title='The same threshold on a foot and in a hand', caption=caption,
                   panels=panels)  # fmt: skip


def _differs(over: Matrix) -> tuple[str, ...]:
    foot, hand = over[1], over[2]
    return (
        (
            'The thesis shows curves without numbers, of one axis of one record at rest; ours are '
            'simulated, in all three axes, and the rest of the table is new.'
        ),
        (
            'As printed (9.6) looks at one instant. A foot in mid-swing turns from heel up to toe '
            f'up and for up to 0.06 s hardly at all; a rule that must last {LASTING:g} s takes '
            f'the path error from {foot[1, 1]:.2g} m to {foot[2, 1]:.2g} m.'
        ),
        (
            f'A threshold for feet does harm in a hand: {hand[1, 0]:.2g} m at the end, '
            f'{hand[0, 0]:.2g} m without updates, {hand[4, 0]:.2g} m with the profile for hands, '
            'which takes only a rig that is laid down for still. Updates are therefore a matter '
            'of the profile, and must be optional.'
        ),
        (
            f'The reset forgets what the error says of tilt and bias. The error-state filter '
            f'learns from it: {foot[4, 1]:.2g} m along the path of the walk, where the best '
            f'reset has {foot[1:4, 1].min():.2g} m.'
        ),
    )
