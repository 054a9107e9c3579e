"""A recording made fit for estimation: what cannot be used is taken out, flagged and counted."""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import binary_dilation

from multiimu_ros.arrays import Flags, NANOSECONDS, Scalars, Vectors
from multiimu_ros.calibration.static_intervals import GAP_PERIODS
from multiimu_ros.samples import ImuSamples

LEAST_SAMPLES = 100
PILE = 5  # readings at the very same extreme: noise never does that
SPOILT = 2  # samples on either side of a saturated one: the filter smears the clipped peak


@dataclass(frozen=True)
class CleanTrack:
    """One IMU's samples: finite, in order of time.

    Parameters
    ----------
    samples : ImuSamples
        N samples, raw.
    usable : (N,) bool array
        False at and around readings that end the range.
    not_finite, backward, saturated : int
        Samples left out, and samples flagged.
    gaps, missing_s : int, float
        Holes, and how long they are altogether [s].
    """

    samples: ImuSamples
    usable: Flags
    not_finite: int
    backward: int
    saturated: int
    gaps: int
    missing_s: float

    def restamped(self, stamp_ns: np.ndarray) -> 'CleanTrack':
        """Return the track with other stamps (N,), which must increase."""
        samples = self.samples
        moved = ImuSamples(stamp_ns, samples.angular_rate, samples.specific_force)
        return CleanTrack(moved, *list(vars(self).values())[1:])

    def seconds_since(self, start_ns: int) -> Scalars:
        """Return the instants (N,) since a stamp [s]."""
        return np.asarray((self.samples.stamp_ns - start_ns) / NANOSECONDS)


def clean(samples: ImuSamples) -> CleanTrack:
    """Drop readings that are not finite and stamps that do not advance; flag saturation."""
    readings = np.hstack([samples.angular_rate, samples.specific_force])
    finite = np.asarray(np.isfinite(readings).all(axis=1))
    kept = samples.select(finite)
    latest = np.maximum.accumulate(kept.stamp_ns) if len(kept) else kept.stamp_ns
    advancing = np.ones(len(kept), bool)
    advancing[1:] = kept.stamp_ns[1:] > latest[:-1]
    kept = kept.select(advancing)
    saturated = at_limit(kept.angular_rate) | at_limit(kept.specific_force)
    spoilt = np.asarray(binary_dilation(saturated, iterations=SPOILT))
    steps = np.diff(kept.stamp_ns)
    period = np.median(steps) if len(steps) else 0
    holes = steps[steps > GAP_PERIODS * period]
    return CleanTrack(
        kept,
        ~spoilt,
        int((~finite).sum()),
        int((~advancing).sum()),
        int(saturated.sum()),
        len(holes),
        float(np.sum(holes - period)) / NANOSECONDS if len(holes) else 0.0,
    )


def at_limit(vectors: Vectors) -> Flags:
    """Flag the samples (N,) of which an axis sits at an extreme that readings pile up at.

    Noise thins out towards its extremes, unless the steps of the sensor are so coarse that most
    readings are alike; the most usual reading is therefore none.
    """
    flags = np.zeros(len(vectors), bool)
    for axis in (*vectors.T, *-vectors.T):
        extreme = axis.max(initial=0.0)
        at = axis == extreme
        inside = axis[~at].max(initial=-np.inf)
        piled = extreme and at.sum() >= PILE and at.sum() > (axis == inside).sum()
        if piled and extreme != np.median(axis):
            flags |= at
    return flags
