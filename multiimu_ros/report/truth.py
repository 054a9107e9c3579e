"""The truth of a simulated motion at any stamp, and the constant by which stamps are late.

The driver maps the device's clock to the host's by the earliest arrivals, so its stamps are late
by what the quickest bytes took on their way: a constant that no one-way link can tell from the
offset of the clocks [1]_.  At 20 rad/s^2 a millisecond is worth 0.02 rad/s, far more than the
noise to be scored, so the constant tau is fitted, by least squares on the angular rate,

    w(t) = w_true(t - tau),

once, on the plain mean of the readings, and the same tau is then taken for every estimate.  What
else is wrong with the stamps (jitter, skew, a clock that is still settling) stays in the scores.

.. [1] D. L. Mills, "Internet time synchronization", IEEE Trans. Communications 39(10), 1991.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation, RotationSpline

from multiimu_ros.arrays import Flags, Matrix, NANOSECONDS, Scalars, Stamps, Vectors
from multiimu_ros.simulation.motion import Motion

MAX_SCATTER = 1e-3  # [s] a fitted lateness less certain than that is worse than none


@dataclass(frozen=True)
class Truth:
    """Pose, rate and force of the base frame at N instants.

    Parameters
    ----------
    stamp_ns : (N,) int array
        Instants on an exact host clock [ns].
    position_n : (N, 3) array
        [m].
    R_nb : (N, 3, 3) array
        Attitude.
    angular_rate, specific_force : (N, 3) arrays
        At the base origin [rad/s], [m/s^2].
    still : (N,) bool array
        Whether nothing moves.
    """

    stamp_ns: Stamps
    position_n: Vectors
    R_nb: Matrix
    angular_rate: Vectors
    specific_force: Vectors
    still: Flags

    def at(self, stamp_ns: Stamps, lateness: float = 0.0) -> 'Truth':
        """Return the truth at stamps that are late by `lateness` [s], by splines.

        Stamps outside the truth get its ends.
        """
        own = _seconds(self.stamp_ns, self.stamp_ns[0])
        when = np.clip(_seconds(stamp_ns, self.stamp_ns[0]) - lateness, own[0], own[-1])
        columns = np.hstack([self.position_n, self.angular_rate, self.specific_force])
        smooth = CubicSpline(own, columns)(when)
        attitude = RotationSpline(own, Rotation.from_matrix(self.R_nb))(when)
        nearest = np.searchsorted(own, when).clip(0, len(own) - 1)
        return Truth(
            stamp_ns,
            smooth[:, :3],
            attitude.as_matrix(),
            smooth[:, 3:6],
            smooth[:, 6:],
            self.still[nearest],
        )


def as_truth(motion: Motion, stamp_ns: Stamps) -> Truth:
    """Return a simulated motion, whose instants have these stamps (N,), as truth."""
    return Truth(
        stamp_ns,
        motion.position_n,
        motion.R_nb,
        motion.angular_rate_b,
        motion.specific_force_b,
        motion.still,
    )


def _seconds(stamp_ns: Stamps, start_ns: int) -> Scalars:
    return np.asarray((stamp_ns - start_ns) / NANOSECONDS)


@dataclass(frozen=True)
class Lateness:
    """Constant by which the stamps are late, and its standard deviation [s]."""

    seconds: float
    sigma: float


def fit_lateness(truth: Truth, stamp_ns: Stamps, angular_rate: Vectors) -> Lateness:
    """Fit how late the stamps of a measured rate are; 0 where the motion cannot tell.

    Parameters
    ----------
    truth : Truth
        Its rate is taken to be smooth.
    stamp_ns : (N,) int array
        Instants as stamped [ns].
    angular_rate : (N, 3) array
        What was measured then, constant bias and all [rad/s].
    """
    own = _seconds(truth.stamp_ns, truth.stamp_ns[0])
    when = _seconds(stamp_ns, truth.stamp_ns[0])
    inside = (when > own[0] + 0.1) & (when < own[-1] - 0.1)
    spline = CubicSpline(own, truth.angular_rate)
    slope = spline.derivative()
    when, measured = when[inside], angular_rate[inside]
    late, sigma = 0.0, np.inf
    for _ in range(8):  # Gauss-Newton; a waved board needs three steps
        model, a = spline(when - late), slope(when - late)
        a = a - a.mean(axis=0)
        misfit = measured - model
        misfit = misfit - misfit.mean(axis=0)  # the bias
        information = float(np.sum(a**2))
        if information == 0.0:
            break
        late -= float(np.sum(a * misfit)) / information
        sigma = float(np.sqrt(np.sum(misfit**2) / misfit.size / information))
    return Lateness(late, sigma) if sigma < MAX_SCATTER else Lateness(0.0, sigma)
