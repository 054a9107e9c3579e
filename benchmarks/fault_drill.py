"""Faults of one IMU and of the whole board, live; what the fused output makes of them.

Run: python benchmarks/fault_drill.py

Prints one line per fault: when /diagnostics named it and took it back, the longest pause between
two fused messages and between two stamps, and the step of output and pose from before to after.
"""

import os
from pathlib import Path
import sys
import tempfile

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
os.environ.setdefault('ROS_DOMAIN_ID', '74')

from fault_drill import board_drill, not_a_number_drill, table
from ros_helpers import ros_peer


def main() -> None:
    """Drill all faults."""
    with tempfile.TemporaryDirectory() as folder, ros_peer() as peer:
        outcomes, _ = board_drill(peer, Path(folder))
    with tempfile.TemporaryDirectory() as folder, ros_peer() as peer:
        outcomes.append(not_a_number_drill(peer, Path(folder)))
    print(table(outcomes))


if __name__ == '__main__':
    main()
