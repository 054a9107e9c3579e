"""The filters that are not compiled with the rest, called between the parts of `fuse_scan`."""

from collections.abc import Callable

import numpy as np

from multiimu_ros.arrays import Scalars, Vector, Vectors
from multiimu_ros.fusion import fuse_scan as kernels
from multiimu_ros.fusion.bridging import bridge_gap
from multiimu_ros.fusion.federated import information_shares
from multiimu_ros.fusion.filter_bank import FilterBank
from multiimu_ros.fusion.fusion_state import FusionState, INTERVAL
from multiimu_ros.fusion.level import level
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.scaat import ScaatFilter
from multiimu_ros.synchronization.arrivals import Arrivals
from multiimu_ros.synchronization.synchronizer import Scan

RATE, FORCE = slice(0, 3), slice(3, 6)


class BankScans:
    """A local filter per IMU and a master, as `FilterBank` has them.

    Parameters
    ----------
    model, state, settings : RigModel, FusionState, (SETTINGS,) array
        Those of the stage.
    make_bank : callable
        Returns a fresh `FilterBank` of three axes.
    """

    def __init__(
        self,
        model: RigModel,
        state: FusionState,
        settings: Vector,
        make_bank: Callable[[], FilterBank],
    ) -> None:
        self._model, self._state, self._settings = model, state, settings
        self._banks = {RATE.start: make_bank(), FORCE.start: make_bank()}

    def restart(self) -> None:
        """Forget the motion."""
        for bank in self._banks.values():
            bank.restart()

    def push(self, scan: Scan, arrivals: Arrivals | None) -> tuple[Vectors, Scalars]:
        """Fuse one scan, as `fuse_scan` does; `arrivals` are in it already."""
        del arrivals
        tools = self._model, self._state, self._settings
        z, R, at_limit = kernels.open_scan(
            *tools, scan.stamp_ns, scan.values, scan.share, scan.noise_gain
        )
        b = np.zeros_like(R)
        self._fuse(RATE, z, R, b)
        bridge_gap(*tools, z, R, at_limit, b)
        level(*tools, scan.stamp_ns, z, R)
        self._fuse(FORCE, z, R, b)
        return kernels.close_scan(*tools, z, R, b, at_limit, scan.share, scan.noise_gain)

    def _fuse(self, triad: slice, z: Vectors, R: Vectors, b: Vectors) -> None:
        state = self._state
        Q = (self._settings[triad] * state.clock[INTERVAL]) ** 2
        x, P, shares = self._banks[triad.start].step(z[:, triad], R[:, triad], Q)
        if (np.isfinite(R[:, triad]) & (shares == 0.0)).any():
            # Carlson's shares wait for the next fusion; alignment takes a newcomer at once, or the
            # noise of those who were there would stay in the common offset.
            shares = information_shares(R[:, triad])
        b[:, triad] = shares
        kernels.note_fused(state, triad.start, x, P)


class ScaatScans:
    """One sample at a time, at its own instant; the scans only say when, and align the IMUs."""

    def __init__(self, model: RigModel, state: FusionState, settings: Vector) -> None:
        self._model, self._state, self._settings = model, state, settings
        self._filter = ScaatFilter(
            state.density, model.lever_arms_b, float(settings[0]), float(settings[3])
        )

    def restart(self) -> None:
        """Forget the motion."""
        self._filter.restart()

    def push(self, scan: Scan, arrivals: Arrivals | None) -> tuple[Vectors, Scalars]:
        """Take the samples up to the instant of a scan."""
        if arrivals is None:
            msg = '`arrivals` must hold the samples since the previous scan, got None.'
            raise ValueError(msg)
        tools = self._model, self._state, self._settings
        z, R, at_limit = kernels.open_scan(
            *tools, scan.stamp_ns, scan.values, scan.share, scan.noise_gain
        )
        b = information_shares(R)
        believed = np.isfinite(R).reshape(-1, 2, 3).all(axis=2)
        trusted = np.where(believed, scan.share[:, None], 0.0)
        x, P = self._filter.advance(arrivals, self._state.offsets, trusted, scan.stamp_ns)
        variance = np.diag(P)[[0, 1, 2, 6, 7, 8]]
        kernels.note_fused(self._state, 0, x[:3], variance[:3])
        level(*tools, scan.stamp_ns, z, R)
        self._state.spread[:] = 0.0  # P has what the angular acceleration adds
        kernels.note_fused(self._state, 3, x[3:], variance[3:])
        b[:, FORCE] = information_shares(R[:, FORCE])
        return kernels.close_scan(*tools, z, R, b, at_limit, scan.share, np.ones_like(scan.share))
