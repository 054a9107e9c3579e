"""One local filter and one master of the sources, chosen by name; batch and stream."""

from typing import get_args

import numpy as np

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion.adaptive_filter import AdaptiveLocal
from multiimu_ros.fusion.local_filters import (
    FadingLocal,
    KalmanLocal,
    Local,
    LocalFilter,
    UnscentedLocal,
)
from multiimu_ros.fusion.masters import (
    CarlsonMaster,
    CentralisedMaster,
    Fused,
    Master,
    MasterFilter,
    MeanMaster,
    Reset,
)
from multiimu_ros.fusion.particle_filter import ParticleLocal
from multiimu_ros.fusion.printed_master import PrintedMaster


class FilterBank:
    """K x A local filters under one master, on a live stream of scans.

    Parameters
    ----------
    local, master : str
        Which filters.  The centralised master has no local filters; of `adaptive` it takes the
        noises, and the rest do not differ under it.
    count, axes : int
        IMUs K and axes A.
    reset : str
        What the carlson master does to the local filters at a fusion.
    every : int
        Scans from one fusion of the carlson master to the next.
    seed : int
        Of the particle filter.
    """

    def __init__(
        self,
        local: Local,
        master: Master,
        count: int,
        axes: int = 3,
        *,
        reset: Reset = 'fusion',
        every: int = 1,
        seed: int = 0,
    ) -> None:
        _choice('local', local, get_args(Local))
        _choice('master', master, get_args(Master))
        _choice('reset', reset, get_args(Reset))
        for name, value in (('count', count), ('axes', axes), ('every', every)):
            if value < 1:
                msg = f'`{name}` must be at least 1, got {value}.'
                raise ConfigError(msg)
        self._local, self._master = local, master
        self._shape, self._reset, self._every, self._seed = (count, axes), reset, every, seed
        self.restart()

    def restart(self) -> None:
        """Forget the state, and draw the particles from the seed again."""
        count, axes = self._shape
        local = _local_filter(self._local, self._seed)
        self._filter: MasterFilter
        if self._master == 'carlson':
            self._filter = CarlsonMaster(local, count, axes, self._reset, self._every)
        elif self._master == 'mfkf_printed':
            self._filter = PrintedMaster(local, count, axes)
        elif self._master == 'centralised':
            self._filter = CentralisedMaster(local, axes)
        else:
            self._filter = MeanMaster(self._master, local, count, axes)

    def step(self, z: Vectors, R: Vectors, Q: Scalars) -> Fused:
        """Fuse one scan.

        Parameters
        ----------
        z, R : (K, A) arrays
            Measurements and their variances; R infinite where there is none (z may be NaN there).
        Q : (A,) array
            Variance that the common state gains between scans.

        Returns
        -------
        x_f, P_f : (A,) arrays
            The fused state and its variance; 0 and infinite where nothing has been seen yet.
        shares : (K, A) array
            Weight of each IMU in this scan; a column that nobody sees is 0.
        """
        if z.shape != self._shape or R.shape != self._shape or Q.shape != self._shape[1:]:
            came = f'{z.shape}, {R.shape}, {Q.shape}'
            msg = f'`z`, `R`, `Q` must be {self._shape} twice and {self._shape[1:]}, got {came}.'
            raise ValueError(msg)
        if not ((R > 0.0).all() and (Q >= 0.0).all()):  # also catches NaN
            msg = f'`R` must be positive and `Q` not negative, got {R.min()} and {Q.min()}.'
            raise ValueError(msg)
        return self._filter.step(z, R, Q)


def filter_series(bank: FilterBank, z: Vectors, R: Vectors, Q: Scalars) -> tuple[Vectors, Vectors]:
    """Fuse N scans, from a state that is forgotten first: the numbers of the stream.

    Parameters
    ----------
    bank : FilterBank
        Which filters.
    z : (N, K, A) array
        Measurements.
    R : (K, A) or (N, K, A) array
        Their variances.
    Q : (A,) array
        Variance that the common state gains between scans.

    Returns
    -------
    x_f, P_f : (N, A) arrays
        The fused state and its variance.
    """
    bank.restart()
    out = np.empty((2, len(z), z.shape[2]))
    for n, (scan, noise) in enumerate(zip(z, np.broadcast_to(R, z.shape), strict=True)):
        out[0, n], out[1, n], _ = bank.step(scan, noise, Q)
    return out[0], out[1]


def _local_filter(kind: Local, seed: int) -> LocalFilter:
    if kind == 'particle':
        return ParticleLocal(seed)
    return {
        'kf': KalmanLocal,
        'ukf': UnscentedLocal,
        'afukf': FadingLocal,
        'adaptive': AdaptiveLocal,
    }[kind]()


def _choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        msg = f'`{name}` must be one of {", ".join(choices)}, got {value!r}.'
        raise ConfigError(msg)
