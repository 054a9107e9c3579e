"""What the chain is told, and what it tells of its IMUs."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from math import isfinite
from typing import get_args, Literal

from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion.array_fusion import ArrayFusionConfig, Master, Noise
from multiimu_ros.fusion.drift import Disagreement
from multiimu_ros.fusion.faults import FaultState
from multiimu_ros.fusion.local_filters import Local
from multiimu_ros.fusion.masters import Master as BankMaster, Reset
from multiimu_ros.fusion.prefilters import Prefilter
from multiimu_ros.odometry.detectors import Detector
from multiimu_ros.rig import ZERO
from multiimu_ros.synchronization.synchronizer import SyncConfig

Input = Literal['raw', 'calibrated', 'registered']
ProfileName = Literal['hand', 'foot', 'vehicle']
Attitude = Literal['error_state', 'rk4', 'madgwick']
Odometry = Literal['error_state', 'seeds', 'federated']

# How fast rate and force may change between two scans: generous, so that the fused IMU has no
# lag; smoothing is left to the filters downstream, which know the motion.
MOTION = {
    'hand': ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0),
    'foot': ArrayFusionConfig(angular_acceleration_sigma=300.0, jerk_sigma=5000.0),
    'vehicle': ArrayFusionConfig(angular_acceleration_sigma=10.0, jerk_sigma=100.0),
}


@dataclass(frozen=True, kw_only=True)
class PipelineConfig:
    """Settings of the chain.

    Parameters
    ----------
    input : {'raw', 'calibrated', 'registered'}
        What is pushed in: which stages are still to do.
    profile : {'hand', 'foot', 'vehicle'}
        What the rig is mounted on.
    local : str
        Local filter of each IMU: kf, ukf, adaptive, afukf or particle.
    master : str
        What fuses the local filters: carlson, centralised, inverse_variance, inverse_sigma,
        average or mfkf_printed; scaat takes sample by sample instead.
    reset : {'fusion', 'none', 'zero'}
        What the master carlson gives back to the local filters.
    fuse_every : int
        Scans from one fusion of the master carlson to the next.
    noise : {'rig', 'learnt'}
        Whether weights come from the rig file or from what the IMUs differ by.
    guard : bool
        Whether IMUs that the others contradict are left out.
    prefilter : {'none', 'low_pass', 'high_pass', 'complementary', 'wavelet'}
        Filter of each IMU before fusion; all of them lag but complementary.
    cutoff_hz : float
        Cutoff of the prefilter [Hz].
    virtual_imu : 3 floats
        Where the fused IMU sits, in the base frame [m].
    zero_velocity : str
        What tells that the rig stands still: glrt, gyro, moving_variance, ared; or none.
    attitude : {'error_state', 'rk4', 'madgwick'}
        Filter of the orientation; the others are the schemes of the sources.
    odometry : {'error_state', 'seeds', 'federated'}
        Filter of the position: of the fused IMU, the scheme of the sources, or one for each IMU.
    sync : SyncConfig
        Patience and probation of the synchroniser.

    Raises
    ------
    ConfigError
        If a choice is unknown; names those that exist.
    """

    input: Input = 'raw'
    profile: ProfileName = 'hand'
    local: Local = 'kf'
    master: Master = 'carlson'
    reset: Reset = 'fusion'
    fuse_every: int = 1
    noise: Noise = 'rig'
    guard: bool = True
    prefilter: Prefilter = 'none'
    cutoff_hz: float = 40.0
    virtual_imu: tuple[float, ...] = ZERO
    zero_velocity: Detector = 'glrt'
    attitude: Attitude = 'error_state'
    odometry: Odometry = 'error_state'
    sync: SyncConfig = field(default_factory=SyncConfig)

    def __post_init__(self) -> None:
        for name, choices in CHOICES.items():
            value = getattr(self, name)
            if value not in choices:
                known = ', '.join(f"'{choice}'" for choice in choices)
                msg = f'`{name}` must be one of {known}, got {value!r}.'
                raise ConfigError(msg)
        for name in ('fuse_every', 'cutoff_hz'):
            if not getattr(self, name) > 0:
                msg = f'`{name}` must be positive, got {getattr(self, name)}.'
                raise ConfigError(msg)
        if len(self.virtual_imu) != 3 or not all(map(isfinite, self.virtual_imu)):
            msg = f'`virtual_imu` must be three finite numbers [m], got {self.virtual_imu}.'
            raise ConfigError(msg)
        self._check_combinations()

    def _check_combinations(self) -> None:
        only = {'reset': 'carlson', 'fuse_every': 'carlson'}
        for name, master in only.items():
            if getattr(self, name) != getattr(PipelineConfig, name) and self.master != master:
                msg = f'`{name}` is a setting of the master {master}, got {self.master!r}.'
                raise ConfigError(msg)
        if self.master == 'scaat' and (self.local != 'kf' or self.prefilter != 'none'):
            msg = (
                "The master 'scaat' is one filter for all samples: it takes neither `local` "
                f'nor `prefilter`, got {self.local!r} and {self.prefilter!r}.'
            )
            raise ConfigError(msg)

    @property
    def fusion(self) -> ArrayFusionConfig:
        """Settings of the fusion stage."""
        shared = {each.name for each in fields(ArrayFusionConfig)} & set(vars(self))
        return replace(MOTION[self.profile], **{name: getattr(self, name) for name in shared})


CHOICES: dict[str, tuple[str, ...]] = {
    'input': get_args(Input),
    'profile': get_args(ProfileName),
    'local': get_args(Local),
    'master': (*get_args(BankMaster), 'scaat'),
    'reset': get_args(Reset),
    'noise': get_args(Noise),
    'prefilter': get_args(Prefilter),
    'zero_velocity': get_args(Detector),
    'attitude': get_args(Attitude),
    'odometry': get_args(Odometry),
}


@dataclass(frozen=True)
class ImuHealth:
    """State and counters of one IMU, for people to read."""

    name: str
    state: str
    rate_hz: float
    weight: float
    received: int
    rejected: int
    gaps: int
    disagreement: Disagreement
    fault: FaultState


@dataclass(frozen=True)
class Rest:
    """What the gyro bias was learnt from.

    Parameters
    ----------
    seconds : float
        Of rest, all together [s].
    last_ns : int
        Stamp of the last of it [ns]; 0 where there was none.
    """

    seconds: float
    last_ns: int


def fused_frame_id(base_frame: str, virtual_imu: Sequence[float], virtual_imu_frame: str) -> str:
    """Return the frame of `imu/data`, whose specific force is that of one point of the rig.

    Parameters
    ----------
    base_frame : str
        Frame of the rig.
    virtual_imu : 3 floats
        Where the fused IMU sits, in the base frame [m].
    virtual_imu_frame : str
        Frame with the axes of the base frame and its origin there; '' where that is the base.

    Raises
    ------
    ConfigError
        If the fused IMU sits elsewhere than the origin of the only frame that is known.
    """
    if not virtual_imu_frame and any(virtual_imu):
        msg = (
            f'`virtual_imu_frame` must name the frame of the point {tuple(virtual_imu)} that '
            f"`virtual_imu` asks for, got ''; `{base_frame}` has its origin elsewhere."
        )
        raise ConfigError(msg)
    return virtual_imu_frame or base_frame
