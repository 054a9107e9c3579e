"""What one demonstration showed: its figures, and the page with its pictures."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.report import figures as draw
from multiimu_ros.report.comparison import ALIGNED_AT, ARRAY, Comparison, SETTLING
from multiimu_ros.report.page import facts, notes, picture, score_table, write_page
from multiimu_ros.report.recorded import Recorded
from multiimu_ros.report.scores import not_won
from multiimu_ros.report.tracks import Track
from multiimu_ros.report.truth import MAX_SCATTER
from multiimu_ros.rig import Rig

CLOSE_UP = 10.0  # [s] of error that the eye can still resolve


@dataclass(frozen=True)
class Outcome:
    """All that a demonstration found.

    Parameters
    ----------
    motion : str
        Of the board.
    duration : float
        Of the motion [s].
    rig : Rig
        As the nodes loaded it.
    recorded : Recorded
        What the nodes were given and said.
    again : Track
        The same raw readings through the pipeline afterwards, with the weights.
    comparison : Comparison
        Scores, tracks and errors.
    last : dict
        What the monitor saw last.
    """

    motion: str
    duration: float
    rig: Rig
    recorded: Recorded
    again: Track
    comparison: Comparison
    last: dict[str, Any]

    @property
    def unfused(self) -> int:
        """Scans between the first and the last fused one that have no fused message.

        A scan lasts until the next one begins; whose reading in it is the reference may change.
        """
        scans, fused = self.recorded.raw[0].stamp_ns, self.recorded.track.stamp_ns
        inside = scans[(scans >= fused[0]) & (scans <= fused[-1])]
        fused_until = np.searchsorted(fused, np.append(inside, fused[-1] + 1))
        return int((np.diff(fused_until) == 0).sum())

    @property
    def replay_difference(self) -> float:
        """Most by which rate, force or position of the replayed bag differ from the live ones."""
        live, again = self.recorded.track, self.again
        _, i, j = np.intersect1d(live.stamp_ns, again.stamp_ns, return_indices=True)
        names = ('angular_rate', 'specific_force', 'position_n')
        apart = [np.abs(getattr(live, name)[i] - getattr(again, name)[j]) for name in names]
        return float(np.max(apart, initial=0.0))

    def figures(self) -> dict[str, float]:
        """Return the figures beside the table, in SI."""
        p50, p99 = np.quantile(self.recorded.ages, [0.5, 0.99])
        seconds = np.ptp(self.recorded.track.stamp_ns) / NANOSECONDS
        return {
            'duration_s': float(seconds),
            'fused_messages': len(self.recorded.track),
            'scans_without_fused_message': self.unfused,
            'age_p50_s': float(p50),
            'age_p99_s': float(p99),
            'replay_difference': self.replay_difference,
            'lateness_s': self.comparison.lateness.seconds,
            'lateness_sigma_s': self.comparison.lateness.sigma,
        }

    @property
    def lateness(self) -> str:
        """Say by how much the stamps are late, if the motion was able to show it."""
        late = self.comparison.lateness
        if late.sigma > MAX_SCATTER:
            return 'this motion cannot show it, and nothing is taken out'
        return f'{1e3 * late.seconds:.3f} ± {1e3 * late.sigma:.3f} ms, taken out'

    def footnote(self) -> str:
        """Return what the table needs to be understood."""
        figures = self.figures()
        return (
            f'Rate and force are per axis, attitude is the angle, position the distance, from '
            f'{SETTLING:g} s on. The best single IMU went through the same pipeline alone, and '
            f'is chosen with hindsight for each line. Ideal is one IMU over '
            f'√{len(self.rig.imus)}: its noise for rate and force, its error for attitude and '
            f'position. Scans without a fused message: {self.unfused}. Age on arrival: '
            f'{1e3 * figures["age_p50_s"]:.1f} ms (p99 {1e3 * figures["age_p99_s"]:.1f} ms). '
            f'Lateness of the stamps: {self.lateness}.'
        )

    def cpu(self) -> dict[str, float]:
        """Return the load of each node as it said itself, in percent of a core."""
        seen = self.last.get('figures', {})
        names = ('driver', 'calibration', 'registration', 'fusion')
        loads = {name: seen.get(f'{name}: node', {}).get('cpu [%]') for name in names}
        return {name: float(load) for name, load in loads.items() if load is not None}


def write_report(path: Path, outcome: Outcome) -> None:
    """Draw everything and write it as one HTML file."""
    comparison = outcome.comparison
    count = len(outcome.rig.imus)
    title = f'{count} IMUs become one'
    note = (
        'Root mean square errors against the truth: rate and force per axis, attitude as the '
        'angle, position as the distance. <b>Best single IMU</b>: each IMU alone went through '
        'the very same pipeline; for every line the best of them was picked with hindsight. '
        '<b>Plain mean</b>: the registered readings of a scan averaged, then the same pipeline. '
        f'<b>Ideal</b>: one IMU over √{count}, its white noise for rate and force, its rms '
        'error for attitude and position, as if all errors were independent. An array can '
        'fall below the ideal, for bringing all IMUs to one instant averages neighbours in time.'
    )
    sections = [
        score_table(comparison.rows, count, note),
        facts(_facts(outcome)),
        *_pictures(outcome),
        notes('How this was measured', _notes(outcome)),
    ]
    write_page(path, title, _lead(outcome), sections)


def _lead(outcome: Outcome) -> str:
    rows = {row.quantity.key: row for row in outcome.comparison.rows}
    gains = ', '.join(
        f'<b>{rows[key].gain:.1f} times</b> smaller in {rows[key].quantity.name}'
        for key in ('angular_rate', 'specific_force', 'attitude_n')
    )
    lost = not_won(outcome.comparison.rows)
    verdict = f' It did not win in {" and ".join(lost)}.' if lost else ''
    return (
        f'An emulated board of {len(outcome.rig.imus)} BMI160 on a ring, carried along the '
        f'motion <b>{outcome.motion}</b> for {outcome.duration:g} s; driver, calibration, '
        f'registration and fusion ran live as ROS 2 processes. Beside the best of its single '
        f'IMUs the array is {gains}.{verdict}'
    )


def _facts(outcome: Outcome) -> dict[str, str]:
    figures = outcome.figures()
    loads = outcome.cpu()
    shown = {f'{name}, % of a core': f'{load:.0f}' for name, load in loads.items()}
    return {
        'fused messages': f'{figures["fused_messages"]:.0f}',
        'scans without one': f'{outcome.unfused}',
        'age on arrival, p50 / p99': f'{1e3 * figures["age_p50_s"]:.1f} / '
        f'{1e3 * figures["age_p99_s"]:.1f} ms',
        'the replayed bag differs by': f'{outcome.replay_difference:.0e}',
        **shown,
    }


def _pictures(outcome: Outcome) -> list[str]:
    comparison = outcome.comparison
    errors, rig = comparison.errors, outcome.rig
    array, track = errors[ARRAY], comparison.tracks[ARRAY]
    best = {key: errors[comparison.best(key)] for key in vars(array) if key != 'stamp_ns'}
    window = (SETTLING, min(SETTLING + CLOSE_UP, outcome.duration - ALIGNED_AT))
    root = float(np.sqrt(len(rig.imus)))
    densities = _densities(rig)
    ideal = densities[0] / root, densities[1] / root
    age = {'p50': np.quantile(outcome.recorded.ages, 0.5)}
    age['p99'] = np.quantile(outcome.recorded.ages, 0.99)
    singles = {name: comparison.scored[name] for name in rig.names}
    return [
        picture(
            'Every IMU alone, their mean, the array',
            'Shorter is better. The dashed line is what independent errors would average to.',
            draw.scoreboard(comparison.rows, singles),
        ),
        picture(
            'Errors of rate and force',
            'Ten seconds, x axis, against the truth. Shaded: the rig was found to be still.',
            draw.rate_and_force_errors(best['angular_rate'], array, track.still, window),
        ),
        picture(
            'Where the errors are',
            'Flat is white noise, which more IMUs average away. What rises to the left is '
            'bias; a peak near 1 Hz is the motion itself, through scale and interpolation.',
            draw.spectra(best['angular_rate'], array, comparison.rate_hz, ideal),
        ),
        picture(
            'Attitude',
            "Errors about the fixed axes and three of the array's own standard deviations: an "
            'honest filter stays inside. Yaw has no reference, so its band can only grow.',
            draw.attitude(best['attitude_n'], array, track),
        ),
        picture(
            'Path',
            'Position from inertia alone, corrected only where the rig was found to be still.',
            draw.trajectory(track, comparison.truth),
        ),
        picture(
            'Position error',
            'It grows while the rig moves, and falls back when it is laid down.',
            draw.position_error(errors, comparison.best('position_n')),
        ),
        picture(
            'Who is trusted',
            'Share of each IMU in the fused rate. Like IMUs share alike; one that fails '
            'loses its share, and gets it back gradually when it returns.',
            draw.weights(outcome.again, rig.names),
        ),
        picture(
            'Latency',
            'From the instant of the measurement to the arrival of the fused message in '
            'another process: serial port, driver, calibration, registration and fusion.',
            draw.latency(outcome.recorded.ages, age),
        ),
    ]


def _densities(rig: Rig) -> tuple[float, float]:
    """Return the rms noise density of the IMUs [rad/s/√Hz], [m/s²/√Hz]."""
    noises = [imu.noise.noise_density for imu in rig.imus if imu.noise is not None]
    squares = [[np.square(noise.gyroscope), np.square(noise.accelerometer)] for noise in noises]
    rate, force = np.sqrt(np.mean(squares, axis=(0, 2)))
    return float(rate), float(force)


def _notes(outcome: Outcome) -> list[str]:
    return [
        (
            'The IMUs are drawn from the BMI160 data sheet: noise, flicker, bias, scale, '
            'misalignment, g-sensitivity, steps of the converter. The rig file that the nodes '
            'load differs from the truth by what a careful calibration leaves '
            '(scale 35 and 50 ppm, biases 0.035 mg and 0.003 deg/s, lever arms 0.05 mm).'
        ),
        (
            f'The first {SETTLING:g} s are not scored: the driver is still learning the speed '
            "of the board's clock."
        ),
        (
            'Yaw and origin are aligned to the truth in the rest before the motion, from '
            f'{ALIGNED_AT:g} to {ALIGNED_AT + 1:g} s, for no IMU knows north or its place.'
        ),
        (
            'The driver can only know when bytes arrived, so all stamps are late by what the '
            'quickest took on their way. It is fitted once, on the plain mean of the readings, '
            f'and taken out of every estimate alike. Here: {outcome.lateness}. Jitter and drift '
            'of the stamps are not taken out.'
        ),
        (
            'The array is what the nodes published live. The IMUs alone and the plain mean '
            'went through the same pipeline afterwards, from the recorded raw topics; so did '
            'the array once more, and its rate, force and position differ from the live ones '
            f'by at most {outcome.replay_difference:.0e} (SI).'
        ),
    ]
