"""Thesis 8.1 and 8.2: filters against each other, on three like IMUs and with one corrupted.

The thesis scores at rest.  There, the more a filter smooths the better it looks; so everything is
scored in motion too, where what a filter believes of the motion is that of the motion itself.
"""

import numpy as np

from multiimu_ros.arrays import Scalars
from multiimu_ros.experiments.board import Progress
from multiimu_ros.experiments.filter_pictures import by_scan, by_smoothing, by_time
from multiimu_ros.experiments.filter_trials import (
    CORRUPTED,
    DRAWS,
    DURATION,
    Filter,
    LEAST_RATIO,
    make_record,
    MILLIDEGREE,
    noise_of,
    PARTICLE_DURATION,
    RATE_HZ,
    Record,
    resting_noise,
    run_trial,
    score,
    SETTLING,
    step_time,
    Trial,
    WHITE,
)
from multiimu_ros.report.experiment_page import Cell, Result, Table

PRINTED_ERROR = 3.5  # [mdeg/s] of KF_AVE on like IMUs: the smoothing at rest is chosen to match
# Time [ms], error on like IMUs and with one corrupted [mdeg/s].
PAPER = {
    'KF_AVE': (4.025, 3.50, 5.71),
    'UKF_AVE': (5.664, 3.50, 5.71),
    'KF_MFKF': (5.030, 3.08, 3.11),
    'UKF_MFKF': (6.440, 2.95, 3.01),
}
PRINTED = {
    'KF_AVE': Filter('kf', 'average', 'alike'),
    'UKF_AVE': Filter('ukf', 'average', 'alike'),
    'KF_MFKF': Filter('kf', 'mfkf_printed', 'alike'),
    'UKF_MFKF': Filter('ukf', 'mfkf_printed', 'alike'),
}
FILTERS = {
    'average': Filter('kf', 'average'),
    'average, not told': Filter('kf', 'average', 'alike'),
    'mfkf as printed': Filter('kf', 'mfkf_printed'),
    '1/sigma': Filter('kf', 'inverse_sigma'),
    '1/variance': Filter('kf', 'inverse_variance'),
    'carlson': Filter('kf', 'carlson'),
    'carlson, ukf': Filter('ukf', 'carlson'),
    'centralised': Filter('kf', 'centralised'),
    'carlson, R learnt': Filter('kf', 'carlson', 'learnt'),
    'adaptive carlson': Filter('adaptive', 'carlson', 'alike'),
    'fading carlson': Filter('afukf', 'carlson'),
    'particle carlson': Filter('particle', 'carlson'),
}
BEST = 'carlson, R learnt'
SCATTERED = tuple(
    name for name in FILTERS if name not in ('average, not told', '1/variance', BEST)
)
RATIOS = (1.0, 1.01, 1.1, 1.5, 2.45, 5.0)  # of the noise of the third IMU to that of the others
Scores = dict[str, list[Trial]]  # like and corrupted at rest, like and corrupted in motion


def run(seed: int, progress: Progress, *, duration: float = DURATION, sweep: int = 11) -> Result:
    """Rerun both tables, in motion too, with `sweep` strengths of smoothing for the figure."""
    rng = np.random.default_rng(seed)
    rest = make_record('static', rng, duration, resting_noise(PRINTED_ERROR * MILLIDEGREE))
    moving = make_record('hand', rng, duration)
    scores: Scores = {}
    kinds = PRINTED | FILTERS
    for k, (name, kind) in enumerate(kinds.items()):
        scores[name] = [
            score(kind, record, corrupted=corrupted, seed=seed)
            for record in (rest, moving)
            for corrupted in (False, True)
        ]
        progress(0.7 * (k + 1) / len(kinds))
    ends = {ratio: _end_of_print(ratio, rest) for ratio in RATIOS}
    curves = _smoothing(rest, moving, sweep)
    progress(0.95)
    times = {name: step_time(kind) for name, kind in kinds.items()}
    progress(1.0)
    return _result(scores, times, ends, curves, seed, duration)


def _end_of_print(ratio: float, record: Record) -> Trial:
    """Run the printed master with an IMU of `ratio` times the noise, which it is told."""
    R = noise_of(corrupted=False) * np.array([[1.0], [1.0], [ratio**2]])
    z = record.truth[:, None, :] + np.array([1.0, 1.0, ratio])[:, None] * (
        record.like - record.truth[:, None, :]
    )
    return run_trial(PRINTED['KF_MFKF'], z, R, record.Q, record.truth)


def _smoothing(rest: Record, moving: Record, count: int) -> dict[str, list[Scalars]]:
    """Return the assumed change of rate per scan [rad/s], and errors like and corrupted there."""
    steps = WHITE * np.geomspace(1e-3, 1e2, count)
    curves: dict[str, list[Scalars]] = {}
    for place, record in (('at rest', rest), ('in motion', moving)):
        found = []
        for step in steps:
            Q = np.full_like(record.Q, step**2)
            part = Record(record.truth, record.like, record.corrupted, Q)
            kind = FILTERS['carlson']
            found.append([score(kind, part, corrupted=c).error for c in (False, True)])
        curves[place] = [steps, *np.array(found).T]
    return curves


def _result(
    scores: Scores,
    times: dict[str, float],
    ends: dict[float, Trial],
    curves: dict[str, list[Scalars]],
    seed: int,
    duration: float,
) -> Result:
    return Result(
        name='filters',
        title='The filters of the thesis, side by side',
        source='Thesis 8.3, Tables 8.1 and 8.2, Figures 8.6 and 8.7.',
        question='Which filter is best on three like IMUs, and which when one of them is bad?',
        answer=_answer(scores, ends),
        setting=(
            f'Three BMI160 gyroscopes, {duration:g} s at {RATE_HZ:g} Hz, {3 * DRAWS} independent '
            f'series, white noise of {WHITE / MILLIDEGREE:.0f} mdeg/s a reading plus flicker. '
            f'Corrupted: the third has {CORRUPTED} times the noise. At rest the process noise is '
            f'set so that KF_AVE errs by the printed {PRINTED_ERROR} mdeg/s; in motion (a hand) '
            'it is that of the motion. Errors are rms after '
            f'{SETTLING:g} s. Told: the filter knows the noise of each IMU; alike: it believes '
            'that all are like the first; learnt: by the three-cornered hat.'
        ),
        seed=seed,
        tables=(_printed_table(scores, times), _table(scores, times), _ends(ends)),
        pictures=(
            by_smoothing(curves),
            by_time({name: scores[name][3].error for name in SCATTERED}, times),
            by_scan({ratio: trial.shares for ratio, trial in ends.items()}),
        ),
        differs=_differs(scores, times, ends),
    )


def _ratio(trials: list[Trial], place: int) -> float:
    """Return error with one corrupted over error with like IMUs, at rest (0), in motion (1)."""
    return trials[2 * place + 1].error / trials[2 * place].error


def _answer(scores: Scores, ends: dict[float, Trial]) -> str:
    average, best = scores['average, not told'], scores[BEST]
    scans = ends[CORRUPTED].scans
    return (
        'On like IMUs in motion all masters are one, the mean; with one corrupted the mean errs '
        f'{_ratio(average, 1):.2f} times as much, at rest too ({_ratio(average, 0):.2f}; print: '
        f'1.63), and Carlson with the noise learnt from the data {_ratio(best, 1):.2f} times, '
        f'where {LEAST_RATIO:.2f} is the least possible; at rest the printed master ends after '
        f'{scans} scans as soon as it is told that the IMUs differ.'
    )


def _printed_table(scores: Scores, times: dict[str, float]) -> Table:
    rows: list[dict[str, Cell]] = []
    for name, (printed_ms, like, corrupted) in PAPER.items():
        ours = [trial.error / MILLIDEGREE for trial in scores[name]]
        lines = {
            'paper': (like, corrupted, corrupted / like, printed_ms),
            'ours at rest': (*ours[:2], _ratio(scores[name], 0), 1e3 * times[name]),
            'ours in motion': (*ours[2:], _ratio(scores[name], 1), 1e3 * times[name]),
        }
        for whose, (a, b, ratio, ms) in lines.items():
            rows.append(
                {'filter': name, 'whose': whose, 'like [mdeg/s]': a, 'corrupted [mdeg/s]': b,
                 'ratio': ratio, 'step [ms]': ms}
            )  # fmt: skip
    return Table(title='Tables 8.1 and 8.2; all IMUs believed alike', rows=tuple(rows))


def _table(scores: Scores, times: dict[str, float]) -> Table:
    rows: list[dict[str, Cell]] = []
    for name, kind in FILTERS.items():
        errors = [trial.error / MILLIDEGREE for trial in scores[name]]
        rows.append(
            {
                'filter': name,
                'noise': kind.noise,
                'rest': errors[0],
                'rest, one bad': errors[1],
                'motion': errors[2],
                'motion, one bad': errors[3],
                'ratio': _ratio(scores[name], 1),
                'step [ms]': 1e3 * times[name],
            }
        )
    return Table(
        title='Ours, all filters [mdeg/s]; bad: one corrupted; a dash: diverged; ratio: in motion',
        rows=tuple(rows),
    )


def _ends(ends: dict[float, Trial]) -> Table:
    rows = tuple(
        {
            'noise of the third IMU': f'{ratio:g} times',
            'ours': f'diverged after {trial.scans} scans' if trial.diverged else 'went on',
        }
        for ratio, trial in ends.items()
    )
    return Table(title='The printed master at rest, told the noise', rows=rows)


def _differs(scores: Scores, times: dict[str, float], ends: dict[float, Trial]) -> tuple[str, ...]:
    average, printed = scores['KF_AVE'], scores['KF_MFKF']
    slowest = max(ends[ratio].scans for ratio in RATIOS if ends[ratio].diverged)
    told = scores['average'][1].error / scores['average'][0].error
    return (
        (
            f'KF_AVE is reproduced: {average[0].error / MILLIDEGREE:.2f} and '
            f'{average[1].error / MILLIDEGREE:.2f} mdeg/s (print 3.50 and 5.71), if the filters '
            f'do not know that an IMU is corrupted; told, the ratio would be {told:.2f} at rest, '
            'for the local filter of the noisy IMU then smooths more.'
        ),
        (
            f'KF_MFKF is not: as printed it errs by {printed[0].error / MILLIDEGREE:.1f} mdeg/s '
            'at rest, for it counts its prior (2 - b) times, believes itself after a few scans '
            'and holds on to what it read first; and told of unequal noise it diverges, at the '
            f'latest after {slowest} scans in these runs. Whatever gave 3.08 and 3.11 was not '
            'the printed recursion with unequal noise. In motion Q is so much larger than R that '
            'it hides what is fed back: there it goes on, and is the mean or Carlson.'
        ),
        (
            'A ratio of 1.01 is below what any use of three such IMUs can have without '
            f'smoothing, {LEAST_RATIO:.2f}: it says that noise is not what errs in that record, '
            'but what all filters share (bias, or lag). The first picture shows where it is so.'
        ),
        (
            'KF and UKF are the same here to rounding, as they must be on a linear model; the '
            'printed difference of 4 % between KF_MFKF and UKF_MFKF must come from elsewhere: '
            'the misprinted weights (5.96, 5.97) would make one.'
        ),
        (
            f'A step takes {1e3 * times["KF_AVE"]:.2g} ms here and 4.0 ms in print, UKF_AVE '
            f'{times["UKF_AVE"] / times["KF_AVE"]:.1f} times as long (print: 1.4): another '
            'machine and language, and all axes at once. The live path has a compiled kernel.'
        ),
        (
            'The adaptive filter learns R and Q from its innovations; of a hand that rests and '
            'moves they are never constant: in motion with one corrupted it errs by '
            f'{scores["adaptive carlson"][3].error / MILLIDEGREE:.0f} mdeg/s, the mean by '
            f'{scores["average"][3].error / MILLIDEGREE:.0f}. The particle filter ran over '
            f'{PARTICLE_DURATION:g} s of six series only.'
        ),
    )
