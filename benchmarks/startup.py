"""Seconds until a verb has said `--help`, and until a node is up."""

from pathlib import Path
from statistics import median
import subprocess
import sys
import time

COMMANDS = {
    'multiimu --help': ['-m', 'multiimu_ros.cli', '--help'],
    'multiimu fuse --help': ['-m', 'multiimu_ros.cli', 'fuse', '--help'],
    'multiimu demo --help': ['-m', 'multiimu_ros.cli', 'demo', '--help'],
    'import rclpy': ['-c', 'import rclpy'],
    'import multiimu_ros.pipeline': ['-c', 'import multiimu_ros.pipeline'],
    'import multiimu_ros.nodes.fusion': ['-c', 'import multiimu_ros.nodes.fusion'],
    'first fused frame (cached kernels)': [str(Path(__file__).with_name('first_frame.py'))],
}
REPEATS = 3


def rows() -> list[dict[str, object]]:
    return [{'what': what, 'seconds': seconds(arguments)} for what, arguments in COMMANDS.items()]


def seconds(arguments: list[str]) -> float:
    times = []
    for _ in range(REPEATS):
        begin = time.perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, stdout=subprocess.DEVNULL)
        times.append(time.perf_counter() - begin)
    return median(times)
