"""Faults put into the raw readings of one IMU, and what the chain makes of them.

The error is compared with that of the same readings without that IMU while the fault lasts: what
a guard that knew beforehand would have left.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Flags, NANOSECONDS, Scalars, Vectors
from multiimu_ros.pipeline import Pipeline, PipelineConfig
from multiimu_ros.report.tracks import in_order
from multiimu_ros.rig import Rig
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

RATE_HZ = 200.0
SECONDS = 20.0  # of a recording: a hand rests for four, moves for six to ten, and again
START, STOP = 6.0, 9.0  # [s] of the fault, within the first motion
BACK = 2.0  # [s] after its end, from which on the error is that of `after`
FAULTY = 1  # not the reference of the synchroniser
TRIADS = ('gyroscope', 'accelerometer')
DEGREE = np.pi / 180
Injection = Callable[[Scalars, Vectors, float, np.random.Generator], Vectors]


@dataclass(frozen=True)
class Fault:
    """What is done to the readings (N, 3) of a triad while it lasts.

    `inject(times, readings, sigma, rng)`, readings from a second before it on; a gross fault is
    one that no array may feel.
    """

    name: str
    inject: Injection
    gross: bool = False


def _stuck(times: Scalars, readings: Vectors, _sigma: float, _rng: np.random.Generator) -> Vectors:
    return np.where(times[:, None] >= 0.0, readings[np.searchsorted(times, 0.0)], readings)


def _bias(size: float) -> Injection:
    return lambda _times, readings, _sigma, _rng: readings + np.array([size, 0.0, 0.0])


def _spikes(times: Scalars, readings: Vectors, sigma: float, rng: np.random.Generator) -> Vectors:
    hit = rng.random(len(times)) < 0.05
    return readings + 100.0 * sigma * hit[:, None] * rng.choice([-1.0, 1.0], (len(times), 3))


def _noise(_times: Scalars, readings: Vectors, sigma: float, rng: np.random.Generator) -> Vectors:
    return readings + np.sqrt(99.0) * sigma * rng.standard_normal(readings.shape)


def _saturation(
    _times: Scalars, readings: Vectors, _sigma: float, _rng: np.random.Generator
) -> Vectors:
    limit = 0.3 * np.abs(readings - readings.mean(axis=0)).max(axis=0)
    return np.clip(readings, readings.mean(axis=0) - limit, readings.mean(axis=0) + limit)


def _delay(seconds: float) -> Injection:
    return lambda times, readings, _sigma, _rng: np.column_stack(
        [np.interp(times - seconds, times, axis) for axis in readings.T]
    )


def _nan(_times: Scalars, readings: Vectors, _sigma: float, _rng: np.random.Generator) -> Vectors:
    return np.full_like(readings, np.nan)


DROPOUT = 'dropout'


def faults(triad: int) -> list[Fault]:
    """Return the faults of a triad: 0 gyroscope, 1 accelerometer."""
    large, small = ((5.0 * DEGREE, 1.0 * DEGREE), (5.0, 0.5))[triad]
    unit = ('deg/s', 'm/s²')[triad]
    shown = (('5', '1'), ('5', '0.5'))[triad]
    return [
        Fault('stuck', _stuck, gross=True),
        Fault(f'bias {shown[0]} {unit}', _bias(large), gross=True),
        Fault(f'bias {shown[1]} {unit}', _bias(small)),
        Fault('spikes', _spikes, gross=True),
        Fault('noise x10', _noise, gross=True),
        Fault('saturation', _saturation),
        Fault('delay 5 ms', _delay(0.005)),
        Fault('delay 20 ms', _delay(0.020)),
        Fault('NaN', _nan, gross=True),
        Fault(DROPOUT, _nan, gross=True),
    ]


class Window(NamedTuple):
    """When a fault lasts [s after the first sample], and until when the error is followed."""

    start: float
    stop: float
    end: float


@dataclass(frozen=True)
class Case:
    """One recording, without faults."""

    rig: Rig
    raw: Sequence[ImuSamples]
    window: Window
    truth: Callable[[Scalars], Vectors] | None  # (N, 6) at times [s]; None for a real recording
    profile: str = 'hand'


@dataclass(frozen=True)
class Run:
    """What the chain said: times (N,) [s], values (N, 6), whether it uses each IMU (N, K).

    `exclusions` says how often the guard excluded each.
    """

    times: Scalars
    values: Vectors
    used: Flags
    exclusions: tuple[int, ...]


def simulated(count: int, seed: int, seconds: float = SECONDS, motion: str = 'hand') -> Case:
    """Return a calibrated ring of IMUs in motion."""
    path = trajectory(motion, seconds, seed)
    recording = simulate(ring(count), path, RATE_HZ, seed=seed)

    def truth(times: Scalars) -> Vectors:
        motion_at = path.at(times)
        return np.hstack([motion_at.angular_rate_b, motion_at.specific_force_b])

    rig = calibrated_rig(recording.rig, seed)
    return Case(rig, recording.raw, Window(START, STOP, seconds), truth, motion)


def with_fault(case: Case, fault: Fault | None, triad: int, seed: int) -> Sequence[ImuSamples]:
    """Return the readings with the fault of `FAULTY` in them."""
    if fault is None:
        return case.raw
    raw, samples = list(case.raw), case.raw[FAULTY]
    times = (samples.stamp_ns - case.raw[0].stamp_ns[0]) / NANOSECONDS
    first, last = np.searchsorted(times, [case.window.start, case.window.stop])
    if fault.name == DROPOUT:
        raw[FAULTY] = samples.select((times < times[first]) | (times >= times[last]))
        return raw
    fields = ('angular_rate', 'specific_force')
    readings = getattr(samples, fields[triad]).copy()
    noise = case.rig.imus[FAULTY].noise
    density = (noise.noise_density.gyroscope, noise.noise_density.accelerometer)[triad][0]
    lead = slice(first - round(samples.rate_hz / 5), last)
    rng = np.random.default_rng(seed)
    sigma = density * np.sqrt(samples.rate_hz)
    changed = fault.inject(times[lead] - times[first], readings[lead], sigma, rng)
    readings[first:last] = changed[first - last :]
    raw[FAULTY] = replace(samples, **{fields[triad]: readings})
    return raw


def onset(case: Case, raw: Sequence[ImuSamples]) -> float:
    """Return when the first reading is not what it was [s]."""
    was, now = case.raw[FAULTY], raw[FAULTY]
    if len(now) < len(was):
        return case.window.start
    changed = np.zeros(len(was), bool)
    for field in ('angular_rate', 'specific_force'):
        changed |= (getattr(was, field) != getattr(now, field)).any(axis=1)
    return float(was.stamp_ns[changed][0] - case.raw[0].stamp_ns[0]) / NANOSECONDS


def run(case: Case, raw: Sequence[ImuSamples], *, guard: bool = True) -> Run:
    """Send readings through the chain."""
    pipeline = Pipeline(case.rig, PipelineConfig(profile=case.profile, guard=guard))
    frames = list(pipeline.push_block(*in_order(raw)))
    begin = case.raw[0].stamp_ns[0]
    return Run(
        np.array([frame.stamp_ns - begin for frame in frames]) / NANOSECONDS,
        np.array([np.hstack([f.angular_rate, f.specific_force]) for f in frames]),
        np.array([frame.weights for frame in frames]) > 0.0,
        tuple(health.fault.exclusions for health in pipeline.health()),
    )


def errors(case: Case, result: Run, reference: Run) -> Vectors:
    """Return the errors (N, 6): from the truth, or from the run without a fault."""
    if case.truth is not None:
        return result.values - case.truth(result.times)
    columns = [np.interp(result.times, reference.times, axis) for axis in reference.values.T]
    return result.values - np.column_stack(columns)


class Outcome(NamedTuple):
    """What became of one fault.

    Parameters
    ----------
    delay : float
        From its first reading to the first scan without the IMU [s]; infinite if there is none.
    wrong : int
        How often healthy IMUs were excluded.
    during, after : float
        Squared error of the triad, mean over the time of the fault and after it; ideal guard.
    during_ideal, after_ideal : float
        The same for the readings without the IMU.
    """

    delay: float
    wrong: int
    during: float
    during_ideal: float
    after: float
    after_ideal: float


def outcome(case: Case, fault: Fault, triad: int, seed: int, clean: Run, ideal: Run) -> Outcome:
    """Put a fault in and see; `clean` had none, `ideal` no such IMU while the fault lasted."""
    raw = with_fault(case, fault, triad, seed)
    result, first_ill = run(case, raw), onset(case, raw)
    start, stop, end = case.window
    # The scan that a reading first counts in is up to a period older: it is interpolated.
    left_out = result.times[~result.used[:, FAULTY] & (result.times >= start - 1e-6)]
    seen = left_out[left_out < stop]
    wrong = sum(result.exclusions) - result.exclusions[FAULTY]
    figures = []
    for first, last, best in ((start, stop, ideal), (stop + BACK, end, clean)):
        for each in (result, best):
            error = errors(case, each, clean)
            inside = (each.times >= first) & (each.times < last)
            figures.append(float(np.mean(error[inside, 3 * triad : 3 * triad + 3] ** 2)))
    delay = max(float(seen[0]) - first_ill, 0.0) if len(seen) else np.inf
    return Outcome(delay, wrong, *figures)


def baseline(case: Case) -> tuple[Run, Run]:
    """Return the runs without a fault, and without the IMU while a fault would last."""
    silent = with_fault(case, Fault(DROPOUT, _nan), 0, 0)
    return run(case, case.raw), run(case, silent)
