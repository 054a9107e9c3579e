"""The attitude scheme of the sources on a live stream: `attitude_rk4`, sample by sample.

Nothing ever corrects it; it is here to be compared with.
"""

from multiimu_ros.arrays import Vector
from multiimu_ros.odometry.attitude_baseline import BaselineAttitude
from multiimu_ros.odometry.strapdown import rk4_step


class Rk4Attitude(BaselineAttitude):
    """`attitude_rk4` on a live stream; its covariance is that of a gyroscope left alone."""

    def _move(self, rate: Vector, force: Vector, dt: float) -> None:  # noqa: ARG002
        self._R[:] = rk4_step(self._R, rate, dt)
