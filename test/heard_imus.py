"""What a listener hears of one IMU that rests, z up, and is well; tests then spoil it."""

import numpy as np

from multiimu_ros.bags import ImuTrack
from multiimu_ros.nodes.heard import ImuTopic
from multiimu_ros.samples import ImuSamples

N = 400
RATE_HZ = 200
UP = [0.0, 0.0, 0.0, 0.0, 0.0, 9.81]
NOISE = 0.01  # [rad/s], [m/s^2]: a cheap IMU at this rate


def readings(seed=1):
    """Return (N, 6) angular rates and specific forces at rest."""
    noise = NOISE * np.random.default_rng(seed).standard_normal((N, 6))
    return noise + np.array(UP)


def heard_imu(topic='/imu0/data_raw', values=None, stamp_ns=None, late_ns=2_000_000, **fields):
    """Return 2 s of a topic; `late_ns` is the age of its messages when they come [ns]."""
    values = readings() if values is None else values
    if stamp_ns is None:
        stamp_ns = 10**18 + 10**9 // RATE_HZ * np.arange(N)
    covariances = np.tile(NOISE**2 * np.eye(3), (len(values), 3, 1, 1))
    covariances[:, 0, 0, 0] = -1.0  # REP 145: no orientation
    frame_id = fields.pop('frame_id', 'imu0_link')
    samples = ImuSamples(stamp_ns, values[:, :3], values[:, 3:])
    healthy = {
        'track': ImuTrack(topic, frame_id, samples, stamp_ns + late_ns),
        'orientation': np.tile([0.0, 0.0, 0.0, 1.0], (len(values), 1)),
        'covariances': covariances,
        'frames': frozenset([frame_id]),
        'publishers': ('/driver',),
    }
    return ImuTopic(**(healthy | fields))
