"""The fused array beside each of its IMUs alone and their plain mean, all against one truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.pipeline_config import PipelineConfig, ProfileName
from multiimu_ros.report.scores import compare, Errors, errors_of, noise_of_one_sample, Row
from multiimu_ros.report.tracks import alone, fused_track, mean_rig, plain_mean, Track
from multiimu_ros.report.truth import fit_lateness, Lateness, Truth
from multiimu_ros.rig import Rig
from multiimu_ros.samples import ImuSamples

ALIGNED_AT = 1.0  # [s] after the start, at rest: yaw and origin are those of the truth
SETTLING = 6.0  # [s] not scored: the driver is still learning how fast the board's clock runs
MEAN, ARRAY = 'mean', 'array'


@dataclass(frozen=True)
class Comparison:
    """All that a report shows; `errors` and `tracks` are by name: each IMU's, `mean`, `array`.

    They begin where they are aligned; `rows` are over what comes after the settling.
    """

    rows: tuple[Row, ...]
    tracks: Mapping[str, Track]
    errors: Mapping[str, Errors]
    truth: Truth  # at the stamps of the array
    lateness: Lateness
    rate_hz: float
    scored: Mapping[str, Errors]  # `errors` without the settling

    def best(self, key: str) -> str:
        """Name the best single IMU in a quantity."""
        return next(row.best_imu for row in self.rows if row.quantity.key == key)


def rerun(
    rig: Rig, raw: Sequence[ImuSamples], profile: ProfileName
) -> Iterator[tuple[str, Track]]:
    """Yield the tracks of the array, the plain mean and each IMU alone, by name."""
    config = PipelineConfig(profile=profile)
    yield ARRAY, fused_track(rig, raw, config)
    ready = PipelineConfig(profile=profile, input='registered')
    yield MEAN, fused_track(mean_rig(rig), [mean_of(rig, raw)], ready)
    for k, name in enumerate(rig.names):
        yield name, fused_track(alone(rig, k), [raw[k]], config)


def mean_of(rig: Rig, raw: Sequence[ImuSamples]) -> ImuSamples:
    """Return the plain mean; the readings of one scan lie within one period."""
    return plain_mean(rig, raw, round(NANOSECONDS / raw[0].rate_hz))


def score(
    rig: Rig, raw: Sequence[ImuSamples], tracks: Mapping[str, Track], truth: Truth
) -> Comparison:
    """Hold tracks against the truth, over the instants that all of them cover.

    Parameters
    ----------
    rig : Rig
        Calibration, registration and noise.
    raw : sequence of ImuSamples
        Raw readings; their plain mean tells how late the stamps are.
    tracks : mapping
        As `rerun` yields them; the array's may be what the nodes said instead.
    truth : Truth
        On the host's clock.
    """
    mean = mean_of(rig, raw)
    lateness = fit_lateness(truth, mean.stamp_ns, mean.angular_rate)
    start = max(int(track.stamp_ns[0]) for track in tracks.values())
    begin = start + round(ALIGNED_AT * NANOSECONDS)
    end = min(int(track.stamp_ns[-1]) for track in tracks.values())
    end = min(end, int(truth.stamp_ns[-1]))
    kept = {name: track.between(begin, end) for name, track in tracks.items()}
    truths = {name: truth.at(track.stamp_ns, lateness.seconds) for name, track in kept.items()}
    errors = {name: errors_of(track, truths[name]) for name, track in kept.items()}
    scored = {n: e.after(start + round(SETTLING * NANOSECONDS)) for n, e in errors.items()}
    singles = {name: scored[name] for name in rig.names}
    rate_hz = float(np.median([samples.rate_hz for samples in raw]))
    noise = noise_of_one_sample(rig, rate_hz)
    rows = compare(singles, scored[MEAN], scored[ARRAY], noise)
    return Comparison(rows, kept, errors, truths[ARRAY], lateness, rate_hz, scored)
