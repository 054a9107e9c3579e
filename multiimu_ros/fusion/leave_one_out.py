"""Each IMU's running means beside those of the others: chi-squared, and the vote on it.

Readings of one triad are averaged over four memories, from one scan to seconds; the averages are
compared with the mean of the others', weighted by information:

    chi-squared = sum over axes (y_i - m_i)^2 / (V_i + (sum_{j != i} V_j^-1)^-1)            (1)

Averages are linear: (1) is the average of the residual, whoever was left out of m meanwhile.
"""

import numpy as np

from multiimu_ros.arrays import Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.fault_state import (
    AGREES,
    BLOCK,
    CALMS_S,
    CHI,
    EXCLUDE,
    INFORMATION,
    INTERPOLATED,
    MEAN,
    MEMORY_S,
    NOISE,
    PAST,
    SCALES,
    SLOW,
    SUSPECT,
    UNREST,
    VOTER,
    WIDTH,
)
from multiimu_ros.fusion.median import insert, middle

MEDIAN_CHI = 2.37  # of chi-squared with three degrees of freedom
MISSED = 0.7  # of a third difference; a parabola misses 0.064 of it, and more where a burst begins
UNEXPLAINED = 180.0  # 3 sigma squared of a third difference of white noise, 1 - 3 3 -1


@compiled
def average(guard: Vectors, triad: int, z: Vectors, R: Vectors, slow: Vectors, dt: float) -> None:
    """Bring the running means and their variances up to this scan."""
    between = _between_samples(guard, triad, z, R)
    for scale in range(SCALES):
        at = triad * BLOCK + UNREST + scale
        guard[0, at] = 1.0 + (guard[0, at] - 1.0) * np.exp(-dt / CALMS_S)
    for i in range(len(guard)):
        row = guard[i]
        total = 0.0
        for axis in range(3):
            total += z[i, axis] + R[i, axis] + slow[i, axis]
        if not np.isfinite(total):
            row[INFORMATION] = 0.0
            continue
        for scale in range(SCALES):
            gain = dt / max(dt, MEMORY_S[scale])
            keep = 1.0 - gain
            for axis in range(3):
                place = 3 * scale + axis
                at = triad * BLOCK + place
                mean = keep * row[at + MEAN] + gain * z[i, axis]
                noise = keep * keep * row[at + NOISE] + gain * gain * R[i, axis]
                lasts = slow[i, axis] + row[INTERPOLATED] * between
                lasting = keep * row[at + SLOW] + gain * lasts
                row[at + MEAN], row[at + NOISE], row[at + SLOW] = mean, noise, lasting
                row[INFORMATION + place] = 1.0 / (noise + lasting)


@compiled
def _between_samples(guard: Vectors, triad: int, z: Vectors, R: Vectors) -> float:
    """Return the variance of what interpolation misses between samples; sampled together, nothing.

    IMUs are read one after the other and put on one instant by a parabola, which misses up to
    0.064 of the third difference: nothing in a hand, metres per second squared in a heel strike.
    The difference is that of the median over the IMUs, as far as noise does not explain it.
    """
    missed = 0.0
    row, ordered = guard[0], np.empty(len(z))
    for axis in range(3):
        at = triad * BLOCK + PAST + 3 * axis
        now, noise = _median(z, R, axis, ordered)
        third = now - 3.0 * row[at] + 3.0 * row[at + 1] - row[at + 2]
        row[at + 2], row[at + 1], row[at] = row[at + 1], row[at], now
        excess = third * third - UNEXPLAINED * noise
        if excess > 0.0:  # never for NaN
            missed += MISSED * MISSED * excess
    return missed


@compiled
def _median(z: Vectors, R: Vectors, axis: int, ordered: Vector) -> tuple[float, float]:
    """Return the median of an axis over the readings, and the mean of their variances."""
    count, noise = 0, 0.0
    for i in range(len(z)):
        value = z[i, axis]
        if not np.isfinite(value + R[i, axis]):
            continue
        noise += R[i, axis]
        insert(ordered, count, value)
        count += 1
    if count == 0:
        return np.nan, np.nan
    return middle(ordered, count), noise / count


@compiled
def is_present(guard: Vectors, i: int) -> bool:
    """Say whether IMU i has a reading in this scan."""
    return bool(guard[i, INFORMATION] > 0.0)


@compiled
def elect(guard: Vectors, triad: int) -> int:
    """Set the worst voter aside until the rest agree; return how many do, 0 for no majority.

    Those set aside win if as many of them agree with each other.
    """
    candidates = 0
    for i in range(len(guard)):
        guard[i, AGREES] = guard[i, VOTER]  # the candidates, for the time being
        candidates += guard[i, VOTER] == 1.0
    agree = _eliminate(guard, triad)
    if agree == 0 or 2 * agree > candidates:
        return agree
    for i in range(len(guard)):
        aside = guard[i, AGREES] - guard[i, VOTER]
        guard[i, AGREES], guard[i, VOTER] = guard[i, VOTER], aside
    rival = _eliminate(guard, triad)
    for i in range(len(guard)):
        guard[i, VOTER] = guard[i, AGREES]
    compare(guard, triad)
    return agree if agree > rival else 0


@compiled
def _eliminate(guard: Vectors, triad: int) -> int:
    """Return how many voters are left when all agree; 0 if the last two do not.

    Whoever is not far worse than the tightest half of all is no exception: in a knock all IMUs
    disagree, by stamps and by the bending of the board, and none of them is broken.
    """
    voters = 0
    for i in range(len(guard)):
        voters += guard[i, VOTER] == 1.0
    while True:
        worst, scale = compare(guard, triad)
        if worst < 0:
            return voters
        if voters == 2:
            return 0
        apart = _tightest(guard, triad, scale)
        at = triad * BLOCK + UNREST + scale
        unrest = apart / MEDIAN_CHI
        chi = guard[worst, triad * BLOCK + CHI + scale] * _unrest(guard, triad, scale)
        if apart > SUSPECT and chi < EXCLUDE * unrest:
            guard[0, at] = max(guard[0, at], unrest)
            continue
        guard[worst, VOTER] = 0.0
        voters -= 1


@compiled
def _tightest(guard: Vectors, triad: int, scale: int) -> float:
    """Return how far apart the closest half of the members is: chi-squared of three.

    The half has (K - 1) // 2 + 1 of the K candidates of `elect`; its middle is the one from which
    the farthest of the half is nearest.  As many of the others may be wrong, each in its own way.
    """
    members = guard[:, AGREES].sum()
    rank = (int(members) - 1) // 2
    tightest = np.inf
    for i in range(len(guard)):
        if guard[i, AGREES] == 0.0:
            continue
        apart = np.full(len(guard), np.inf)
        for j in range(len(guard)):
            if j != i and guard[j, AGREES] == 1.0:
                apart[j] = _between(guard, triad, scale, i, j)
        tightest = min(tightest, np.sort(apart)[rank - 1])
    return float(tightest)


@compiled
def _between(guard: Vectors, triad: int, scale: int, i: int, j: int) -> float:
    """Return the chi-squared of the distance of two IMUs."""
    total = 0.0
    for place in range(3 * scale, 3 * scale + 3):
        at = triad * BLOCK + MEAN + place
        variance = 1.0 / guard[i, INFORMATION + place] + 1.0 / guard[j, INFORMATION + place]
        total += (guard[i, at] - guard[j, at]) ** 2 / variance
    return total


@compiled
def compare(guard: Vectors, triad: int) -> tuple[int, int]:
    """Compare everybody with the voters (1); return the worst voter beyond and the scale, or -1.

    What the unrest of the last moments explains is divided out of chi-squared.
    """
    for i in range(len(guard)):
        for scale in range(SCALES):
            guard[i, triad * BLOCK + CHI + scale] = np.nan
    worst, worst_at, largest = -1, 0, EXCLUDE
    for scale in range(SCALES):
        for axis in range(3):
            _add_axis(guard, triad, scale, 3 * scale + axis, axis == 0)
        for i in range(len(guard)):
            guard[i, triad * BLOCK + CHI + scale] /= _unrest(guard, triad, scale)
            chi = guard[i, triad * BLOCK + CHI + scale]
            if guard[i, VOTER] == 1.0 and chi > largest:
                worst, worst_at, largest = i, scale, chi
    return worst, worst_at


@compiled
def _unrest(guard: Vectors, triad: int, scale: int) -> float:
    """Return what is divided out at a scale; a knock is over before 50 ms are, but not in them."""
    at = triad * BLOCK + UNREST
    if scale == 1:
        return float(max(guard[0, at], guard[0, at + 1]))
    return float(guard[0, at + scale])


@compiled
def _add_axis(guard: Vectors, triad: int, scale: int, place: int, first: bool) -> None:
    """Add one axis at one scale to chi-squared."""
    information, moment = voters_mean(guard, triad, place)
    for i in range(len(guard)):
        own = guard[i, INFORMATION + place]
        if not is_present(guard, i):
            continue
        y = guard[i, triad * BLOCK + MEAN + place]
        others, mean = information, moment
        if guard[i, VOTER] == 1.0:
            others, mean = information - own, moment - own * y
        if others <= 1e-9 * information:  # nobody but itself
            continue
        apart = y - mean / others
        at = triad * BLOCK + CHI + scale
        before = 0.0 if first else guard[i, at]
        guard[i, at] = before + apart * apart / (1.0 / own + 1.0 / others)


@compiled
def voters_mean(guard: Vectors, triad: int, place: int) -> tuple[float, float]:
    """Return the sum of the voters' information, and of it times their means."""
    information, moment = 0.0, 0.0
    for i in range(len(guard)):
        if guard[i, VOTER] == 1.0:
            own = guard[i, INFORMATION + place]
            information += own
            moment += own * guard[i, triad * BLOCK + MEAN + place]
    return information, moment


@compiled
def begin_anew(guard: Vectors, triad: int, i: int, first: int) -> None:
    """Forget what the scales from `first` on know of IMU i.

    It begins at the voters' mean, so that later averages contain its own residuals and no others.
    """
    for place in range(3 * first, WIDTH):
        information, moment = voters_mean(guard, triad, place)
        at = triad * BLOCK + place
        guard[i, at + MEAN] = moment / information if information > 0.0 else 0.0
        guard[i, at + NOISE] = guard[i, at + SLOW] = 0.0
