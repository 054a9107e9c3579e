"""Scans of K registered IMUs to one angular rate and one specific force, with honest variances.

Per scan: a filter fuses the rates; their slope and the forces give the angular acceleration; the
lever arms are taken out of the forces; a filter fuses those; readings that the others contradict
are left out on the way.  The default filter, Carlson's federated one, is compiled with the rest;
the others of the sources are called between its parts.

Alignment keeps the fused values where they are when an IMU leaves or returns; see `alignment`.
"""

from dataclasses import dataclass, replace
from functools import partial
from math import isfinite
from typing import Literal

import numpy as np

from multiimu_ros.arrays import NANOSECONDS, Scalars, Vector, Vectors
from multiimu_ros.fusion import fuse_scan as kernels
from multiimu_ros.fusion.faults import fault_states, FaultState
from multiimu_ros.fusion.filter_bank import FilterBank
from multiimu_ros.fusion.fusion_state import (
    fresh_state,
    GUARD,
    LEARN,
    PERIOD,
    SETTINGS,
    SUMS,
    VARIANCE,
)
from multiimu_ros.fusion.local_filters import Local
from multiimu_ros.fusion.masters import Master as BankMaster, Reset
from multiimu_ros.fusion.prefilters import Prefilter, ScanPrefilter
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.saturation import saturated
from multiimu_ros.fusion.scan_filters import BankScans, ScaatScans
from multiimu_ros.fusion.three_cornered_hat import learnt_variance
from multiimu_ros.synchronization.arrivals import Arrivals
from multiimu_ros.synchronization.synchronizer import Scan

Master = Literal[BankMaster, 'scaat']
Noise = Literal['rig', 'learnt']
RELEARN_NS = NANOSECONDS  # between two looks at what the noise was learnt to be
TWELVE = np.ones(12)
PREFILTER_FROM = 64  # scans, until the rate is known


@dataclass(frozen=True, kw_only=True)
class ArrayFusionConfig:
    """How the rig may move between two scans, and how its IMUs become one.

    Parameters
    ----------
    angular_acceleration_sigma : float
        Typical angular acceleration [rad/s^2].
    jerk_sigma : float
        Typical change of specific force [m/s^3].
    local, master : str
        Filter of each IMU, and what fuses them; see docs/derivations/filters.md.
    reset : {'fusion', 'none', 'zero'}
        What the master `carlson` gives back to the local filters.
    fuse_every : int
        Scans from one fusion of the master `carlson` to the next.
    noise : {'rig', 'learnt'}
        Whether the noise is that of the rig file, or learnt from what the IMUs differ by.
    guard : bool
        Whether readings that the other IMUs contradict are left out.
    prefilter : str
        What each IMU passes before fusion; see docs/derivations/filters.md for the lag.
    cutoff_hz : float
        Of the prefilter [Hz].
    """

    angular_acceleration_sigma: float
    jerk_sigma: float
    local: Local = 'kf'
    master: Master = 'carlson'
    reset: Reset = 'fusion'
    fuse_every: int = 1
    noise: Noise = 'rig'
    guard: bool = True
    prefilter: Prefilter = 'none'
    cutoff_hz: float = 40.0

    def __post_init__(self) -> None:
        for name in ('angular_acceleration_sigma', 'jerk_sigma', 'fuse_every', 'cutoff_hz'):
            value = getattr(self, name)
            if not value > 0:  # also catches NaN
                msg = f'`{name}` must be positive, got {value}.'
                raise ValueError(msg)

    @property
    def is_compiled(self) -> bool:
        """Whether the filter is the one that is compiled with the rest."""
        return (self.local, self.master, self.reset, self.fuse_every) == (
            'kf',
            'carlson',
            'fusion',
            1,
        )


@dataclass(frozen=True)
class FusedImu:
    """One reading of the virtual IMU at the base origin.

    Parameters
    ----------
    stamp_ns : int
        Instant of the measurement [ns].
    table : (4, 6) array
        Columns are angular rate, then specific force; the rows are the properties below.
    weights : (K,) array
        Mean share of each IMU in the fused rate, 0 for those left out [-].
    """

    stamp_ns: int
    table: Vectors
    weights: Scalars

    @property
    def values(self) -> Vector:
        """Angular rate [rad/s] and specific force [m/s^2], (6,)."""
        row: Vector = self.table[0]
        return row

    @property
    def variance(self) -> Vector:
        """Variance (6,) of the values, without that of the common bias."""
        row: Vector = self.table[1]
        return row

    @property
    def bias_variance(self) -> Vector:
        """Prior variance (6,) of the common bias."""
        row: Vector = self.table[2]
        return row

    @property
    def density(self) -> Vector:
        """White noise density (6,) [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)]."""
        row: Vector = self.table[3]
        return row


class ArrayFusion:
    """The fusion stage on a live stream of scans.

    Parameters
    ----------
    model : RigModel
        Noise, uncertainty and lever arm of every IMU, in the base frame.
    config : ArrayFusionConfig
        Process noise and filters.

    Attributes
    ----------
    arrays : tuple of arrays
        The first parameters of `fuse_scan`, changed in place.
    is_compiled : bool
        Whether `fuse_scan` is all that `push` does with a scan, but for `relearn`.
    due_ns : int
        Stamp from which on `relearn` is due [ns].
    """

    def __init__(self, model: RigModel, config: ArrayFusionConfig) -> None:
        self._model, self._config, self._state = model, config, fresh_state(model)
        self._settings = np.zeros(SETTINGS)
        self._settings[:3] = config.angular_acceleration_sigma
        self._settings[3:6] = config.jerk_sigma
        self._settings[GUARD], self._settings[LEARN] = config.guard, config.noise == 'learnt'
        self.arrays = (*model, *self._state, self._settings)
        self._fuse: BankScans | ScaatScans | None = None
        tools = (model, self._state, self._settings)
        if config.master == 'scaat':
            self._fuse = ScaatScans(*tools)
        elif not config.is_compiled:
            bank = partial(
                FilterBank, config.local, config.master, len(model.density),
                reset=config.reset, every=config.fuse_every,
            )  # fmt: skip
            self._fuse = BankScans(*tools, bank)
        self.is_compiled = self._fuse is None and config.prefilter == 'none'
        self._prefilter: ScanPrefilter | None = None
        self.restart()

    def restart(self) -> None:
        """Forget the motion (time jumped); keep the alignment of the IMUs."""
        state = self._state
        state.fused[:] = 0.0
        state.fused[VARIANCE] = np.inf
        state.scans[0] = 0
        state.clock[:] = state.spread[:] = 0.0
        self.block[:] = 0.0
        self._prefilter, self.due_ns = None, -(2**63)
        self._early: list[Vectors] = []  # scans before the prefilter
        if self._fuse is not None:
            self._fuse.restart()

    @property
    def offsets(self) -> Vectors:
        """Bias of each IMU (K, 6) relative to the fused one [rad/s], [m/s^2]."""
        return self._state.offsets.copy()

    @property
    def density(self) -> Vectors:
        """White noise (K, 6) that the weights are made of [rad/s/sqrt(Hz)], [m/s^2/sqrt(Hz)]."""
        return self._state.density.copy()

    @property
    def block(self) -> Vectors:
        """Sums (K + 1, 7) over the scans since somebody emptied it, for `DriftMonitor`.

        Row i: the readings of IMU i without their lever arm, and the scans in which it was fully
        trusted; last row: the fused values, and all scans.
        """
        return self._state.tally[:, SUMS:]

    def faults(self) -> tuple[FaultState, ...]:
        """Return what the guard thinks of each IMU."""
        return fault_states(self._state.guard)

    def push(self, scan: Scan, arrivals: Arrivals | None = None) -> FusedImu | None:
        """Fuse one scan; None if no IMU can be trusted in it.

        Parameters
        ----------
        arrivals : Arrivals, optional
            The samples since the previous scan, which the master `scaat` takes one by one.
        """
        if self._config.prefilter != 'none':
            scan = self._filtered(scan)
        if self._fuse is None:
            out, weights = kernels.fuse_scan(
                *self.arrays, scan.stamp_ns, scan.values, scan.share, scan.noise_gain
            )
        else:
            out, weights = self._fuse.push(scan, arrivals)
        if scan.stamp_ns >= self.due_ns:
            self.relearn(scan.stamp_ns)
        # A triad that nobody has measured yet is unknown; the sum is the quickest way to ask.
        if not isfinite(out.ravel()[:12] @ TWELVE):
            return None
        return FusedImu(scan.stamp_ns, out, weights)

    def _filtered(self, scan: Scan) -> Scan:
        """Filter the readings; what is at its limit passes as it is, so as to be known for it."""
        if self._prefilter is None:
            self._early.append(scan.values)
            if len(self._early) < PREFILTER_FROM:
                return scan
            config, rate_hz = self._config, 1.0 / self._state.clock[PERIOD]
            self._prefilter = ScanPrefilter(
                config.prefilter, len(scan.values), cutoff_hz=config.cutoff_hz, rate_hz=rate_hz
            )
            for values in self._early[:-1]:  # or a filter that lags would have nothing to say yet
                self._prefilter.push(values)
            self._early.clear()
        values, at_limit = self._prefilter.push(scan.values), np.zeros_like(scan.values)
        if saturated(scan.values, self._model.to_sensor, self._model.limits, at_limit):
            values = np.where(at_limit.any(axis=1, keepdims=True), scan.values, values)
        return replace(scan, values=values)

    def relearn(self, stamp_ns: int) -> None:
        """Look at what the noise was learnt to be, if it is; due from `due_ns` on."""
        self.due_ns = stamp_ns + RELEARN_NS
        if self._config.noise == 'rig':
            return
        R, known = learnt_variance(self._state.hat)
        density = np.sqrt(R * self._state.clock[PERIOD])
        self._state.density[known] = density[known]
