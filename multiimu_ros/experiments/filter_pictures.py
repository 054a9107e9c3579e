"""The figures of the comparison of filters, as data."""

import numpy as np

from multiimu_ros.arrays import Scalars
from multiimu_ros.experiments.filter_trials import CORRUPTED, LEAST_RATIO, MILLIDEGREE
from multiimu_ros.report.experiment_figures import Line, Panel, Picture


def by_smoothing(curves: dict[str, list[Scalars]]) -> Picture:
    """Show error and ratio against the believed change of rate; all [rad/s]."""
    lines, ratios = [], []
    for place, role in (('at rest', 'single'), ('in motion', 'array')):
        steps, like, corrupted = (values / MILLIDEGREE for values in curves[place])
        lines += [
            Line(label=place, x=steps, y=like, role=role, dots=True),
            Line(label=f'{place}, one corrupted', x=steps, y=corrupted, role=role, dashed=True),
        ]
        ratios.append(Line(label=place, x=steps, y=corrupted / like, role=role, dots=True))
    flat = np.full_like(steps, LEAST_RATIO)
    ratios.append(Line(label='1/σ² weights, no smoothing', x=steps, y=flat, role='ideal',
                       dashed=True))  # fmt: skip
    x_label = 'believed change per scan [mdeg/s]'
    return Picture(
        title='What smoothing does at rest and in motion',
        caption=(
            'Carlson, noise told. Left: at rest less process noise is always better; in motion '
            'the error explodes, for the filter lags. Right: a corrupted IMU costs nothing where '
            'noise is not what errs: a ratio near 1 says that the filter smooths too much.'
        ),
        panels=(
            Panel(title='rms error [mdeg/s]', x_label=x_label, y_label='', lines=tuple(lines),
                  log_x=True, log_y=True),
            Panel(title='corrupted / like', x_label=x_label, y_label='', lines=tuple(ratios),
                  log_x=True),
        ),
    )  # fmt: skip


def by_time(errors: dict[str, float], times: dict[str, float]) -> Picture:
    """Show what the filters err [rad/s] and take for a step [s]; who diverged is left out."""
    points = {
        name: (1e3 * times[name], error / MILLIDEGREE)
        for name, error in errors.items()
        if np.isfinite(error)
    }
    return Picture(
        title='Time and error (Figure 8.7), in motion, one corrupted',
        caption='Left and low is good. Times are of this machine.',
        panels=(
            Panel(title='', x_label='time of a step [ms]', y_label='rms error [mdeg/s]',
                  names=points, log_x=True),
        ),
    )  # fmt: skip


def by_scan(shares: dict[float, Scalars]) -> Picture:
    """Show the share (scans,) of the third IMU, by how many times noisier it is."""
    lines = tuple(
        Line(label=f'{ratio:g} times', x=np.arange(1.0, len(shown) + 1), y=shown, dots=True)
        for ratio, share in shares.items()
        if ratio in (1.0, 1.1, CORRUPTED)
        for shown in [share[:40]]
    )
    return Picture(
        title='How the printed master ends',
        caption=(
            'Its share of the third IMU from scan to scan, by how much noisier that IMU is. The '
            'logarithm of the ratio of two shares is multiplied by -2 at each scan: equal IMUs '
            'stay equal, any other difference grows until a share is zero.'
        ),
        panels=(
            Panel(title='', x_label='scan', y_label='share of the third IMU', lines=lines),
        ),
    )  # fmt: skip
