"""How many IMUs are enough?  The question that TUM 6.2.3 and the thesis leave open, 1 to 16.

Independent errors average out as 1/sqrt(N), whatever they are: noise, bias, scale.  What all IMUs
have in common does not: with a common variance c and an own one s the error is sqrt(c + s / N),
and more IMUs than s / c are of little use.
"""

from collections.abc import Sequence
import time

import numpy as np
from scipy.spatial.transform import Rotation

from multiimu_ros.arrays import Matrix, Scalars, Vectors
from multiimu_ros.experiments.board import (
    DEGREE,
    drawn_rig,
    fuse,
    instants,
    part_of,
    Progress,
    Readings,
    record,
    registered,
    rms,
)
from multiimu_ros.odometry.strapdown import mechanise
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.report.experiment_figures import Line, Panel, Picture
from multiimu_ros.report.experiment_page import Cell, Result, Table
from multiimu_ros.rig import Intrinsics, Rig
from multiimu_ros.simulation.calibrated import calibrated_rig, Residuals
from multiimu_ros.simulation.errors import BMI160
from multiimu_ros.simulation.motion import Motion
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.trajectories import make_motion, REST_FIRST

RATE_HZ = 100.0
BOARDS = 24
COUNTS = (1, 2, 3, 4, 6, 8, 12, 16)
ATTITUDE_TIME, POSITION_TIME = 60.0, 10.0  # [s]
DRAWS = 3  # of the common error of a board; each is tried with both signs
COARSE = (1, 4, 16)  # counts at which the uncalibrated board is tried as well
COMMON = 0.1  # [-] variance of the errors that all IMUs share, per that of their own
CALIBRATED, SHARED, UNSCALED = 'calibrated', 'with a common error', 'scale not calibrated'
KINDS = (CALIBRATED, SHARED, UNSCALED)
TIMED_SCANS = 300
# Columns of what is measured of one fused IMU, and per SI what is shown.
QUANTITIES = ('rate noise [mdeg/s]', 'force noise [mm/s²]', 'attitude [deg]', 'position [cm]')
HALVES = tuple(enumerate(QUANTITIES))[:2], tuple(enumerate(QUANTITIES))[2:]
PER_SI = np.array([1e3 / DEGREE, 1e3, 1 / DEGREE, 1e2])


def run(
    seed: int, progress: Progress, *, boards: int = BOARDS, counts: Sequence[int] = COUNTS
) -> Result:
    """Measure newly drawn boards of the largest count, and parts of them."""
    errors = np.empty((boards, len(KINDS), len(counts), len(QUANTITIES)))
    for k in range(boards):
        motion = make_motion('hand', REST_FIRST + ATTITUDE_TIME + 0.5, RATE_HZ, seed + k)
        errors[k] = _board(motion, counts, np.random.default_rng([seed, k]))
        progress(0.9 * (k + 1) / boards)
    costs = np.array([frame_time(count) for count in counts])
    progress(1.0)
    return _result(rms(errors, axis=0) * PER_SI, costs, np.array(counts), seed, boards)


def _board(motion: Motion, counts: Sequence[int], rng: np.random.Generator) -> Matrix:
    """Return the errors (kinds, counts, quantities) of one board in SI."""
    most = max(counts)
    true = drawn_rig(ring(most), [BMI160] * most, rng)
    raw = record(true, motion, RATE_HZ, [BMI160] * most, rng)
    shared = [common_error(rng) for _ in range(DRAWS)]
    files = {CALIBRATED: calibrated_rig(true, int(rng.integers(2**31))), UNSCALED: biases_of(true)}
    values = {name: registered(rig, raw) for name, rig in files.items()}
    errors = np.full((len(KINDS), len(counts), len(QUANTITIES)), np.nan)
    for column, count in enumerate(counts):
        some = np.round(np.arange(count) * (most / count)).astype(int).tolist()
        for name, rig in files.items():
            if name == UNSCALED and count not in COARSE:
                continue
            fused = fuse(part_of(rig, some), values[name][:, some], RATE_HZ)
            errors[KINDS.index(name), column] = _errors(fused, motion)
            if name == CALIBRATED:
                each = [_errors(with_error(fused, e * sign), motion)
                        for e in shared for sign in (1, -1)]  # fmt: skip
                errors[KINDS.index(SHARED), column] = rms(np.array(each), axis=0)
    return errors


def biases_of(true: Rig) -> Rig:
    """Return the rig file that knows the biases, and takes scale and misalignment as nominal."""
    imus = []
    for imu in true.imus:
        own = imu.intrinsics or Intrinsics()
        known = {name: {'bias': getattr(own, name).bias} for name in vars(Intrinsics())}
        imus.append(imu.model_copy(update={'intrinsics': Intrinsics.model_validate(known)}))
    return true.model_copy(update={'imus': tuple(imus)})


def common_error(rng: np.random.Generator) -> Matrix:
    """Draw a bias and a scale error (2, 6) that all IMUs of a board share."""
    left = Residuals()
    bias = [left.gyroscope_bias, left.accelerometer_bias]
    scale = [left.gyroscope_scale, left.accelerometer_scale]
    sigma = np.sqrt(COMMON) * np.repeat([bias, scale], 3, axis=1)
    return np.asarray(sigma * rng.standard_normal((2, 6)))


def with_error(fused: Vectors, error: Matrix) -> Vectors:
    """Return a fused IMU (N, 6) whose IMUs share a bias and a scale error (2, 6)."""
    return np.asarray(fused * (1 + error[1]) + error[0])


def _errors(fused: Vectors, motion: Motion) -> Scalars:
    """Return noise of rate and force at rest, attitude error, position error, (4,) in SI."""
    rest = round(REST_FIRST * RATE_HZ)
    noise = [fused[:rest, part].std(axis=0) for part in (slice(0, 3), slice(3, 6))]
    stop, near = rest + round(ATTITUDE_TIME * RATE_HZ), rest + round(POSITION_TIME * RATE_HZ)
    stamps = instants(len(fused), RATE_HZ)[rest:stop]
    start, still = motion.R_nb[rest], np.zeros(3)
    run = mechanise(stamps, fused[rest:stop, :3], fused[rest:stop, 3:], start, still)
    turn = Rotation.from_matrix(run.R_nb[-1] @ motion.R_nb[stop - 1].T).magnitude()
    way = motion.position_n[near - 1] - motion.position_n[rest]
    off = np.linalg.norm(run.position_n[near - rest - 1] - way)
    return np.array([rms(noise[0]), rms(noise[1]), turn, off])


def frame_time(count: int) -> float:
    """Return what a fused frame of `count` IMUs takes in the whole pipeline, median [s]."""
    rig = ring(count)
    motion = make_motion('hand', 10.0, RATE_HZ)
    raw: Readings = record(rig, motion, RATE_HZ, [BMI160] * count, np.random.default_rng(0))
    pipeline = Pipeline(rig, PipelineConfig())
    spent = []
    for stamp_ns, scan in zip(instants(TIMED_SCANS, RATE_HZ).tolist(), raw, strict=False):
        rows = scan.tolist()
        begin = time.perf_counter()
        for k, reading in enumerate(rows):
            pipeline.push(k, stamp_ns, reading)
        spent.append(time.perf_counter() - begin)
    return float(np.median(spent))


def _result(errors: Matrix, costs: Scalars, counts: Scalars, seed: int, boards: int) -> Result:
    return Result(
        name='count',
        title='How many IMUs are enough?',
        source='Left open by TUM 6.2.3 and the thesis; no printed numbers.',
        question='What does each further IMU gain, and where does it end?',
        answer=_answer(errors, costs, counts),
        setting=(
            f'{boards} newly drawn rings of {counts[-1]} BMI160, {RATE_HZ:g} Hz, N of them evenly '
            'spaced and fused, on a hand in motion. Noise: standard deviation at rest. '
            f'Attitude: angle after {ATTITUDE_TIME:g} s, position: distance after '
            f'{POSITION_TIME:g} s, both by integration from the true start, without any update; '
            'rms over the boards. Calibrated: by the simulated calibration. With a common error: '
            f'to bias and scale comes an error that all IMUs share, {COMMON:.0%} of the variance '
            'of what calibration leaves (as of a temperature or a wrong g that all have felt). '
            'Scale not calibrated: biases are known, scale and misalignment are not.'
        ),
        seed=seed,
        tables=_tables(errors, costs, counts),
        pictures=(_noise(errors, counts), _drift(errors, counts), _cost(costs, counts)),
        differs=_differs(errors, counts),
    )


def common_part(own: Scalars, shared: Scalars, counts: Scalars) -> float:
    """Return c / s of errors sqrt(s / N) and sqrt(c + s / N), mean over the counts (M,)."""
    c = np.mean(np.square(shared) - np.square(own))
    return float(c / np.mean(np.square(own) * counts))


def _answer(errors: Matrix, costs: Scalars, counts: Scalars) -> str:
    ideal = _one_reading() * PER_SI[:2] / np.sqrt(counts[-1])
    above = errors[0, -1, :2] / ideal
    alone, shared = errors[0, :, 2], errors[1, :, 2]
    end = 1 / common_part(alone, shared, counts)
    return (
        f'The noise of {counts[-1]} IMUs is {above[0]:.3f} (rate) and {above[1]:.3f} (force) of '
        f'that of one over √{counts[-1]}; the attitude error falls {_gain(alone):.1f} times from '
        f'1 to {counts[-1]} where all errors are independent, but {_gain(shared):.1f} times where '
        f'a tenth as much is common, and beyond some {end:.0f} IMUs the common part is the '
        f'larger. A frame of {counts[-1]} costs {costs[-1] / costs[0]:.1f} times that of one.'
    )


def _one_reading() -> Scalars:
    """Return the noise (2,) of one reading of a BMI160, quantisation included, in SI."""
    triads = (BMI160.gyroscope, BMI160.accelerometer)
    return np.array([np.sqrt(t.noise_density**2 * RATE_HZ + t.step**2 / 12) for t in triads])


def _gain(errors: Scalars) -> float:
    return float(errors[0] / errors[-1])


def _tables(errors: Matrix, costs: Scalars, counts: Scalars) -> tuple[Table, Table]:
    noise: list[dict[str, Cell]] = []
    drift: list[dict[str, Cell]] = []
    for k, count in enumerate(counts):
        row: dict[str, Cell] = {'IMUs': f'{count}', '1/√N': float(1 / np.sqrt(count))}
        first, last = ({name: float(errors[0, k, q]) for q, name in pairs} for pairs in HALVES)
        noise.append(row | first | {'frame [µs]': 1e6 * float(costs[k])})
        common = {'attitude, common': errors[1, k, 2], 'position, common': errors[1, k, 3]}
        drift.append(row | last | {name: float(value) for name, value in common.items()})
    return (
        Table(title='Noise of N fused IMUs, and what a frame costs', rows=tuple(noise)),
        Table(title='Drift of N fused IMUs, without and with a common error', rows=tuple(drift)),
    )


def _panel(q: int, lines: Sequence[Line], counts: Scalars, ideal: float) -> Panel:
    return Panel(
        title=QUANTITIES[q],
        x_label='IMUs',
        y_label='',
        lines=(*lines, Line(label='1/√N', x=counts, y=ideal / np.sqrt(counts), role='ideal',
                            dashed=True)),
        log_x=True,
        log_y=True,
        x_ticks=(1, 2, 4, 8, 16),
    )  # fmt: skip


def _noise(errors: Matrix, counts: Scalars) -> Picture:
    one = _one_reading() * PER_SI[:2]
    panels = []
    for q in (0, 1):
        line = Line(label='fused', x=counts, y=errors[0, :, q], role='array', dots=True)
        panels.append(_panel(q, [line], counts, float(one[q])))
    caption = (
        'It follows that of one reading over √N to the end. One IMU off the centre pays for '
        'taking its lever arm out: the angular acceleration that this needs is noisy.'
    )
    return Picture(title='Noise', caption=caption, panels=tuple(panels))


def _drift(errors: Matrix, counts: Scalars) -> Picture:
    panels = []
    for q in (2, 3):
        lines = []
        for k, (kind, role) in enumerate(zip(KINDS, ('array', 'single', 'mean'), strict=True)):
            seen = np.isfinite(errors[k, :, q])
            lines.append(
                Line(label=kind, x=counts[seen], y=errors[k, seen, q], role=role, dots=True)
            )
        panels.append(_panel(q, lines, counts, float(errors[0, 0, q])))
    caption = (
        'Errors of scale are large but independent: they fall like the rest. What ends the gain '
        'is what the IMUs have in common.'
    )
    return Picture(title='Drift', caption=caption, panels=tuple(panels))


def _cost(costs: Scalars, counts: Scalars) -> Picture:
    panel = Panel(
        title='', x_label='IMUs', y_label='time per frame [µs]',
        lines=(Line(label='', x=counts, y=1e6 * costs, role='array', dots=True),),
    )  # fmt: skip
    return Picture(
        title='What it costs',
        caption='Whole pipeline with its guard, raw readings in, odometry out; on this machine.',
        panels=(panel,),
    )


def _differs(errors: Matrix, counts: Scalars) -> tuple[str, ...]:
    unscaled = errors[2] / errors[0]
    one = float(_one_reading()[1] * PER_SI[1])
    parts = [common_part(errors[0, :, q], errors[1, :, q], counts) for q in (2, 3)]
    return (
        (
            'No source has numbers; the report only asks for a point of inflection. There is '
            'none: the gain per IMU falls steadily, until what is common is all that is left.'
        ),
        (
            f'The force of one IMU at the rim is {errors[0, 0, 1] / one:.1f} times as noisy as '
            'its accelerometer, for the lever arm is taken out with an angular acceleration from '
            f'one gyroscope; with {counts[1]} in balance it is '
            f'{errors[0, 1, 1] / one * np.sqrt(counts[1]):.2f} times what averaging gives.'
        ),
        (
            'With scale and misalignment as they come from the factory the attitude is '
            f'{unscaled[0, 2]:.0f} times worse with one IMU and {unscaled[-1, 2]:.0f} times with '
            f'{counts[-1]}: uncalibrated errors average as well as noise does, but {counts[-1]} '
            'IMUs do not make up for a calibration.'
        ),
        (
            f'The common part of the error variance is {parts[0]:.2f} (attitude) and '
            f'{parts[1]:.2f} (position) of that of one IMU; put in were {COMMON:g} for bias and '
            'scale, beside which noise, flicker and misalignment are independent.'
        ),
        (
            'How much real IMUs have in common depends on the board: one temperature, one supply '
            'and one wafer make errors alike. A tenth is an assumption; two calibrations of one '
            'board on different days tell yours.'
        ),
    )
