"""Which IMU no longer agrees with the rest, beyond what the rig file allows.

The fusion stage adds up what each IMU reads; ten times a second the sums come here.  Their means
show how far rates and forces are apart, best at rest; in motion a regression on the fused rate
shows how far the gyroscopes' answers to a turn are.  Every few seconds each IMU is compared with
the mean of the others, in units of the sigma that the rig file, its age and the noise explain; the
worst is set aside while it is beyond, so that the healthy ones are compared among themselves.  Of
two IMUs nobody can say which is wrong: both are named.  Nothing here changes a fused value.

Equations: docs/derivations/fusion.md.
"""

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from multiimu_ros.arrays import Flags, NANOSECONDS, Vectors
from multiimu_ros.fusion import block_sums as sums
from multiimu_ros.fusion.rig_model import (
    bias_walks,
    lever_arm_variance,
    response_variance,
    RigModel,
)
from multiimu_ros.rig import Rig

BLOCK_S = 0.1  # [s] a hand turns hardly within it
BLOCK_NS = round(BLOCK_S * NANOSECONDS)
MEMORY_S = (10.0, 30.0)  # of rest and of motion: short against warming up, long against noise
EVERY_S = (2.0, 5.0)  # of rest and of motion, between two judgements
RAISE, CLEAR = 6.0, 4.0  # sigma; 6 where the sigmas of a real file are 20 % too small is still 5
PERSISTS, CALMS = 2, 5  # judgements in a row that raise and clear
ALIKE_S = 0.4  # [s] errors in motion, as of a stamp, last as long as a hand takes to turn
# Columns of all that is judged; rate and force in motion too: errors may be too large for a rest.
RATE, FORCE, TURN, MOVING_RATE, MOVING_FORCE = range(5)
REST, MOTION = 0, 1


class Gap(NamedTuple):
    """How far one IMU is from the others in one quantity, on the axis where that is worst.

    Parameters
    ----------
    value, sigma : float
        Distance, and the standard deviation that would be no surprise; NaN where nothing is known.
    raised : bool
        Whether it has been beyond for long.
    rivals : tuple of int
        Others that may be at fault as well: nobody can say which.
    """

    value: float
    sigma: float
    raised: bool
    rivals: tuple[int, ...]


@dataclass(frozen=True)
class Disagreement:
    """The gaps of one IMU.

    Parameters
    ----------
    rate : Gap
        Angular rate, whatever the motion [rad/s].
    force : Gap
        Specific force, whatever the motion [m/s^2].
    turn : Gap
        Reading per angular rate in motion: scale, misalignment, mounting [-].
    """

    rate: Gap
    force: Gap
    turn: Gap


class DriftMonitor:
    """Compares the IMUs of one rig.

    Parameters
    ----------
    rig : Rig
        The rig file.
    model : RigModel
        Its noise and biases, aged to the start.

    Attributes
    ----------
    due_ns : int
        Stamp from which on `take` wants the next block [ns].
    """

    def __init__(self, rig: Rig, model: RigModel) -> None:
        count = len(rig.imus)
        self._model, self._walks, self._response = model, bias_walks(rig), response_variance(rig)
        self._arms = lever_arm_variance(rig)
        self._rest = np.zeros((count, sums.SIZE))
        self._moments = np.zeros((count, sums.SIZE, sums.SIZE))
        self._elapsed_s = 0.0
        self._seconds = [0.0, 0.0]
        self._values = np.full((count, 5), np.nan)
        self._sigmas = np.full((count, 5), np.nan)
        self._beyond, self._calm = np.zeros((2, count, 5), np.int64)
        self._raised = np.zeros((count, 5), bool)
        self._pairs: list[tuple[int, ...]] = [()] * 5
        self.restart()

    def restart(self) -> None:
        """Forget the last stamp (time jumped), keep what is known of the IMUs."""
        self._last_ns: int | None = None
        self.due_ns = -(2**63)

    def take(self, block: Vectors, stamp_ns: int, resting: bool) -> None:
        """Take the sums of a block and empty them; judge if it is time.

        Parameters
        ----------
        block : (K + 1, 7) array
            `ArrayFusion.block`.
        stamp_ns : int
            Of its last scan [ns].
        resting : bool
            Whether the rig rests at its end.
        """
        self.due_ns = stamp_ns + BLOCK_NS
        if self._last_ns is None:
            block[:] = 0.0
        else:
            span_s = (stamp_ns - self._last_ns) / NANOSECONDS
            self._elapsed_s += span_s
            # A hole in the stream lasts longer than the scans of its block.
            self._add(block, min(span_s, 2.0 * BLOCK_S), REST if resting else MOTION)
        self._last_ns = stamp_ns

    def _add(self, block: Vectors, span_s: float, kind: int) -> None:
        keep = math.exp(-span_s / MEMORY_S[kind])
        if kind == REST:
            sums.add_rest(block, self._rest, keep, span_s)
        else:
            sums.add_motion(block, self._moments, keep, span_s)
        self._seconds[kind] += span_s
        if self._seconds[kind] >= EVERY_S[kind]:
            self._seconds[kind] = 0.0
            self._judge_rest() if kind == REST else self._judge_motion()

    def rest_offsets(self) -> tuple[Vectors, Vectors]:
        """Return each reading at rest beside the mean of all, and its variance as a bias.

        Returns
        -------
        (K, 6) array
            Base frame [rad/s], [m/s^2]; NaN where an IMU has not rested.
        (K, 6) array
            Of white noise, and of what gravity makes of scale and g-sensitivity.
        """
        seconds = np.where(self._rest[:, :1] > 0.0, self._rest[:, :1], np.nan)
        mean = self._rest[:, 1:] / seconds
        gravity = np.einsum('kij,kj->ki', self._response[:, :, 3:], mean[:, 9:] ** 2)
        return mean[:, :6], self._model.density**2 / seconds + gravity

    def disagreements(self) -> tuple[Disagreement, ...]:
        """Return what was found at the last judgement, one for each IMU."""
        return tuple(
            Disagreement(
                self._worse(k, RATE, MOVING_RATE),
                self._worse(k, FORCE, MOVING_FORCE),
                self._gap(k, TURN),
            )
            for k in range(len(self._rest))
        )

    def _worse(self, k: int, *columns: int) -> Gap:
        gaps = [self._gap(k, column) for column in columns]
        return max(
            gaps, key=lambda gap: (gap.raised, np.nan_to_num(gap.value / gap.sigma, nan=-1))
        )

    def _gap(self, k: int, column: int) -> Gap:
        rivals = self._pairs[column] if k in self._pairs[column] else ()
        return Gap(
            float(self._values[k, column]),
            float(self._sigmas[k, column]),
            bool(self._raised[k, column]),
            tuple(other for other in rivals if other != k),
        )

    def _judge_rest(self) -> None:
        values, variance = self.rest_offsets()
        variance = variance + self._model.bias_variance + self._walks * self._elapsed_s
        known = self._rest[:, 0] >= EVERY_S[REST] / 2.0
        self._judge(RATE, values[:, :3], variance[:, :3], known)
        self._judge(FORCE, values[:, 3:], variance[:, 3:], known)

    def _judge_motion(self) -> None:
        moments = self._moments
        seconds = moments[:, 0, sums.SECONDS]
        known = seconds >= EVERY_S[MOTION] / 2.0
        fit = sums.fit_motion(moments, self._model.density, ALIKE_S)
        count = len(moments)
        variance = fit.response_variance + self._response[:, :3, :3]
        self._judge(TURN, fit.response.reshape(count, 9), variance.reshape(count, 9), known)
        felt = np.diagonal(moments, axis1=1, axis2=2)[:, sums.FORCE]
        gravity = np.einsum('kij,kj->ki', self._response[:, :, 3:], felt)
        drift = self._model.bias_variance + self._walks * self._elapsed_s
        span = np.maximum(seconds, BLOCK_S)[:, None]
        gap_variance = fit.gap_variance + drift + gravity / span
        turned = np.diagonal(moments, axis1=1, axis2=2)[:, sums.RATE].sum(axis=1, keepdims=True)
        gap_variance[:, 3:] += self._arms * (turned / span) ** 2  # w x (w x r)
        self._judge(MOVING_RATE, fit.gap[:, :3], gap_variance[:, :3], known)
        self._judge(MOVING_FORCE, fit.gap[:, 3:], gap_variance[:, 3:], known)

    def _judge(self, column: int, values: Vectors, variance: Vectors, known: Flags) -> None:
        if known.sum() < 2:
            return
        gaps, sigmas, kept = compare(values, variance, known)
        rows = np.arange(len(values))
        worst = np.argmax(gaps / sigmas, axis=1)
        gap, sigma = gaps[rows, worst], sigmas[rows, worst]
        self._values[:, column] = np.where(known, gap, np.nan)
        self._sigmas[:, column] = np.where(known, sigma, np.nan)
        self._pairs[column] = tuple(map(int, np.flatnonzero(kept))) if kept.sum() == 2 else ()
        self._remember(column, gap > RAISE * sigma, gap < CLEAR * sigma, known)

    def _remember(self, column: int, beyond: Flags, calm: Flags, known: Flags) -> None:
        """Raise what stays beyond, clear what stays calm; who is not known stays as it is."""
        for streak, now in ((self._beyond[:, column], beyond), (self._calm[:, column], calm)):
            streak[known] = np.where(now[known], streak[known] + 1, 0)
        raised = self._raised[:, column]
        raised |= self._beyond[:, column] >= PERSISTS
        raised &= self._calm[:, column] < CALMS


def compare(values: Vectors, variance: Vectors, known: Flags) -> tuple[Vectors, Vectors, Flags]:
    """Compare each IMU with the weighted mean of the others that agree.

    Parameters
    ----------
    values, variance : (K, n) arrays
        What each says, and how far it may be from the truth.
    known : (K,) bool array
        Whose values count; two at least.

    Returns
    -------
    gaps, sigmas : (K, n) arrays
        Distance from the mean of the others that were kept, and its standard deviation.
    kept : (K,) bool array
        Who was not set aside; the last two never are, for each is as good as the other.
    """
    values = np.where(known[:, None], values, 0.0)
    variance = np.where(known[:, None], variance, 1.0)
    kept = known.copy()
    while True:
        information = np.where(kept[:, None], 1.0 / variance, 0.0)
        others = information.sum(axis=0) - information
        weighted = (information * values).sum(axis=0) - information * values
        gaps = np.abs(values - weighted / others)
        sigmas = np.sqrt(variance + 1.0 / others)
        scores = np.where(kept, (gaps / sigmas).max(axis=1), 0.0)
        worst = int(np.argmax(scores))
        if kept.sum() == 2 or scores[worst] <= RAISE:
            return gaps, sigmas, kept
        kept[worst] = False
