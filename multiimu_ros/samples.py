"""What one IMU says: stamps, angular rates and specific forces of equal length.

At rest with the z axis up, `specific_force` reads [0, 0, +9.81]: an accelerometer feels the
table push, not gravity pull.
"""

from dataclasses import dataclass

import numpy as np

from multiimu_ros.arrays import as_stamps, as_vectors, Flags, NANOSECONDS, Stamps, Vectors


@dataclass(frozen=True)
class ImuSamples:
    """A batch of N samples of one IMU.

    Parameters
    ----------
    stamp_ns : (N,) int array
        Instant of each measurement [ns].
    angular_rate : (N, 3) array
        Angular rate [rad/s].
    specific_force : (N, 3) array
        Acceleration minus gravity [m/s^2].

    Raises
    ------
    ValueError
        If a shape is wrong or the lengths differ.
    """

    stamp_ns: Stamps
    angular_rate: Vectors
    specific_force: Vectors

    def __post_init__(self) -> None:
        object.__setattr__(self, 'stamp_ns', as_stamps(self.stamp_ns, 'stamp_ns'))
        for name in ('angular_rate', 'specific_force'):
            vectors = as_vectors(getattr(self, name), name)
            if len(vectors) != len(self.stamp_ns):
                needed = f'{len(self.stamp_ns)} rows like `stamp_ns`'
                msg = f'`{name}` must have {needed}, got {len(vectors)}.'
                raise ValueError(msg)
            object.__setattr__(self, name, vectors)

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def select(self, index: 'Flags | slice') -> 'ImuSamples':
        """Return the samples under a mask or slice."""
        return ImuSamples(
            self.stamp_ns[index], self.angular_rate[index], self.specific_force[index]
        )

    @property
    def rate_hz(self) -> float:
        """Median sampling rate [Hz]; NaN for fewer than two samples."""
        if len(self) < 2:
            return float('nan')
        return float(NANOSECONDS / np.median(np.diff(self.stamp_ns)))
