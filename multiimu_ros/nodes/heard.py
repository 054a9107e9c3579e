"""What was heard of a running graph: the words between listening (`nodes/`) and judging (`cli/`).

Nothing here needs ROS, so that a judgement can be tested without it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from multiimu_ros.bags import ImuTrack


@dataclass(frozen=True, kw_only=True)
class ImuTopic:
    """One topic of type sensor_msgs/Imu, N of whose messages were read.

    Parameters
    ----------
    track : ImuTrack
        Stamps, readings, and when each came on the clock of this machine [ns].
    orientation : (N, 4) array
        Quaternions x, y, z, w.
    covariances : (N, 3, 3, 3) array
        Of orientation [rad^2], angular rate [rad^2/s^2] and specific force [m^2/s^4].
    frames : frozenset of str
        Every frame name that occurred.
    publishers, subscribers : tuple of str
        Full names of the nodes at either end, this program's own left out.
    malformed : int
        Messages that were no Imu.
    silence : str
        Why nothing came, and what to do; empty where something came.
    """

    track: ImuTrack
    orientation: NDArray[np.float64]
    covariances: NDArray[np.float64]
    frames: frozenset[str] = frozenset()
    publishers: tuple[str, ...] = ()
    subscribers: tuple[str, ...] = ()
    malformed: int = 0
    silence: str = ''

    @property
    def stage(self) -> str:
        """Say how far the topic is down the chain, going by its name."""
        last = self.track.topic.rpartition('/')[2]
        if last in ('data_raw', 'data_calibrated', 'data_registered'):
            return last.removeprefix('data_')
        return 'fused' if self.track.topic.endswith('/imu/data') else 'other'

    @property
    def imu(self) -> str:
        """Name of the IMU: the last part of the topic's namespace."""
        return self.track.topic.split('/')[-2]


class Complaint(NamedTuple):
    """One thing that the graph, or a node in it, says is wrong: about what, how bad, and what."""

    subject: str
    level: str  # 'error' or 'warning'
    text: str


@dataclass(frozen=True, kw_only=True)
class Graph:
    """All that was heard.

    Parameters
    ----------
    domain_id : int
        The domain that was listened to.
    nodes : tuple of str
        Full names, this program's own left out.
    imus : tuple of ImuTopic
        By topic.
    odometries : mapping of str to int
        Published topics of type nav_msgs/Odometry, and how many messages came on each.
    complaints : tuple of Complaint
        About connections, and the diagnostics of the nodes.
    simulated_time : bool
        Somebody publishes /clock: stamps have nothing to do with the clock of this machine.
    """

    domain_id: int
    nodes: tuple[str, ...] = ()
    imus: tuple[ImuTopic, ...] = ()
    odometries: Mapping[str, int] = field(default_factory=dict)
    complaints: tuple[Complaint, ...] = ()
    simulated_time: bool = False
