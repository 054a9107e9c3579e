"""ROS 2 node: calibrated readings into the rig's frame and time.

All 37 numbers of a message go through one matrix: v_b = R v_s, and vec(C_b) = (R x R) vec(C_s)
for the rows of a covariance (x is the Kronecker product).
"""

import numpy as np
from scipy.linalg import block_diag

from multiimu_ros.arrays import Matrix, Vector
from multiimu_ros.nodes.convert import decode_imu_numbers, NO_ORIENTATION
from multiimu_ros.nodes.run import run
from multiimu_ros.nodes.stage import Message, StageNode
from multiimu_ros.registration.transform import mounting
from multiimu_ros.rig import Rig


def message_map(R_bs: Matrix) -> Matrix:
    """Return the (37, 37) matrix that rotates an Imu's numbers, orientation left out."""
    square = np.kron(R_bs, R_bs)
    return np.asarray(block_diag(np.zeros((13, 13)), R_bs, square, R_bs, square))


class Registrar:
    """The stage: the stamp moves by the time offset, the frame becomes the base frame."""

    def __init__(self, rig: Rig) -> None:
        mountings = [mounting(imu) for imu in rig.imus]
        self._maps = [message_map(A[:3, :3]) for A, _ in mountings]
        self._offsets_ns = [offset_ns for _, offset_ns in mountings]
        self._base_frame = rig.rig.base_frame

    def convert(
        self, k: int, stamp_ns: int, _frame_id: str, reading: Vector, _rate_hz: float
    ) -> Message:
        """Register one reading."""
        numbers = self._maps[k] @ reading
        numbers[:13] = NO_ORIENTATION
        return stamp_ns + self._offsets_ns[k], self._base_frame, numbers


class RegistrationNode(StageNode):
    """Hear `imu<k>/data_calibrated`; say `imu<k>/data_registered` in the base frame."""

    def __init__(self) -> None:
        super().__init__(
            'registration', 'data_calibrated', 'data_registered', decode_imu_numbers, Registrar
        )


def main() -> int:
    """Run until shutdown."""
    return run(RegistrationNode)
