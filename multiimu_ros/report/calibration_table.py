"""The verdicts of a calibration as sections of a page: what to do again, then every parameter."""

from collections.abc import Sequence
from html import escape

from multiimu_ros.rig_calibration.verdicts import GOOD, GRADES, REDO, USABLE, Verdict

FEW = 3  # IMUs whose parts of the page stand open
TRIPLE = 3
MARKS = {GOOD: '✓', USABLE: '~', REDO: '✗'}
HEADS = ('quantity', 'value', 'sigma', 'unit', 'verdict')


def folded(summary: str, content: str, *, open_: bool) -> str:
    """Return HTML under a summary (text) that a click opens and closes."""
    state = ' open' if open_ else ''
    return f'<details{state}><summary>{escape(summary)}</summary>{content}</details>'


def grade_mark(grade: str) -> str:
    """Return a grade as a word with a sign and a colour of its own."""
    return f'<span class="grade {grade}">{MARKS[grade]} {grade}</span>'


def in_triples(numbers: str) -> str:
    """Return numbers with three in a line, as a matrix has; others stay as they are."""
    parts = numbers.split(' ')
    if len(parts) <= TRIPLE or len(parts) % TRIPLE:
        return escape(numbers)
    rows = [' '.join(parts[k : k + TRIPLE]) for k in range(0, len(parts), TRIPLE)]
    return '<br>'.join(map(escape, rows))


def tally(verdicts: Sequence[Verdict]) -> str:
    """Return how many verdicts there are of each grade, as `3 redo, 2 usable, 30 good`."""
    grades = [verdict.grade for verdict in verdicts]
    counts = {grade: grades.count(grade) for grade in reversed(GRADES)}
    return ', '.join(f'{count} {grade}' for grade, count in counts.items() if count) or 'none'


def again(verdicts: Sequence[Verdict]) -> str:
    """Return the section with all that is not good, the worst first, like figures in one row."""
    title = '<h2>What to do again</h2>'
    if not verdicts:
        return f'<section>{title}<p>Nothing was fitted, so nothing is judged.</p></section>'
    alike: dict[tuple[str, str], list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.grade != GOOD:
            alike.setdefault((verdict.grade, verdict.quantity), []).append(verdict)
    if not alike:
        return f'<section>{title}<p>Nothing: every figure is good.</p></section>'
    groups = sorted(alike.values(), key=lambda group: group[0].grade != REDO)
    head = '<th>verdict</th>' + ''.join(
        f'<th class="why">{text}</th>' for text in ('quantity', 'IMUs', 'why')
    )
    return (
        f'<section>{title}<p class="soft"><b>redo</b>: no better than the data sheet says. '
        '<b>usable</b>: filters can live with it, as its sigma tells them. Where several IMUs are '
        'named, the reason is that of the worst.</p>'
        f'{_table(head, "".join(map(_advice, groups)))}</section>'
    )


def _advice(group: Sequence[Verdict]) -> str:
    """Return a row for verdicts of one grade on one quantity."""
    worst = max(group, key=lambda verdict: verdict.size)
    names = ', '.join(dict.fromkeys(escape(verdict.imu) for verdict in group))
    return (
        f'<tr><td>{grade_mark(worst.grade)}</td><td class="why">{escape(worst.quantity)}</td>'
        f'<td class="why">{names}</td><td class="why">{escape(worst.why)}</td></tr>'
    )


def parameters(verdicts: Sequence[Verdict]) -> str:
    """Return the section with all verdicts, IMU by IMU."""
    names = list(dict.fromkeys(verdict.imu for verdict in verdicts))
    head = ''.join(f'<th>{text}</th>' for text in HEADS) + '<th class="why">why</th>'
    parts = []
    for name in names:
        own = [verdict for verdict in verdicts if verdict.imu == name]
        table = _table(head, ''.join(map(_row, own)))
        parts.append(folded(f'{name}: {tally(own)}', table, open_=len(names) <= FEW))
    return f'<section><h2>Parameters</h2>{"".join(parts)}</section>' if parts else ''


def _row(verdict: Verdict) -> str:
    return (
        f'<tr><td>{escape(verdict.quantity)}</td><td>{in_triples(verdict.value)}</td>'
        f'<td>{in_triples(verdict.sigma)}</td><td>{escape(verdict.unit)}</td>'
        f'<td>{grade_mark(verdict.grade)}</td><td class="why">{escape(verdict.why)}</td></tr>'
    )


def _table(head: str, rows: str) -> str:
    return (
        f'<div class="scroll"><table class="verdicts"><thead><tr>{head}</tr></thead>'
        f'<tbody>{rows}</tbody></table></div>'
    )
