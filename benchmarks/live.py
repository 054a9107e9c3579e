"""Throughput, latency and CPU of the live chain, between a publisher and a receiver process.

Latency runs from the publication of the last sample of a scan to the receipt of its fused message
in another process; beside it, in the same run, one hop of plain rclpy (typed, single-threaded).
"""

import os
from pathlib import Path
import time
from typing import Any

import numpy as np

from multiimu_ros.cli.children import Children
from multiimu_ros.rig import save_rig
from multiimu_ros.simulation.calibrated import calibrated_rig
from multiimu_ros.simulation.placements import ring
from multiimu_ros.simulation.recording import simulate
from multiimu_ros.simulation.trajectories import trajectory

ARRANGEMENTS = {
    'pipeline': ('pipeline',),
    'graph': ('calibration', 'registration', 'fusion'),
}
TICKS = os.sysconf('SC_CLK_TCK')
LAST_MESSAGES = 1.0  # [s]
WARM_UP = 3.0  # [s], as in peer.py


def cpu_seconds(pid: int) -> float:
    """Return user and system time of a process [s]; fields 14 and 15 of proc(5)'s stat."""
    fields = Path(f'/proc/{pid}/stat').read_text(encoding='ascii').rpartition(')')[2].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def run(arrangement: str, rate: float, seconds: float, folder: Path) -> dict[str, Any]:
    """Run one arrangement at 8 x `rate` Hz for so many seconds; return a row of the table."""
    rig = folder / 'rig.yaml'
    save_rig(calibrated_rig(simulate(ring(8), trajectory('static', 1.0), 10.0).rig), rig)
    nodes = ARRANGEMENTS[arrangement]
    environment = {
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'ROS_DOMAIN_ID': os.environ.get('ROS_DOMAIN_ID', str(1 + os.getpid() % 100)),
        'PYTHONPATH': str(Path(__file__).parent.parent),
    }
    with Children(folder, environment) as children:
        for name in nodes:
            parameters = ['--ros-args', '-p', f'rig_file:={rig}']
            if arrangement == 'graph':  # two hops more that may lose something
                parameters += ['-p', 'reliable:=true']
            children.start(name, f'multiimu_ros.nodes.{name}', parameters)
        for role in ('receive', 'echo'):
            children.start(role, 'benchmarks.peer', [role, str(folder)])
        publisher = ['publish', str(folder), str(rate), str(seconds)]
        children.start('publish', 'benchmarks.peer', publisher)
        loads = _watch(children, nodes, seconds)
        time.sleep(LAST_MESSAGES)
        for role in ('receive', 'echo'):
            children.end(role)
    return _row(arrangement, rate, seconds, folder, loads)


def _watch(children: Children, nodes: tuple[str, ...], seconds: float) -> dict[str, float]:
    """Wait for the publisher; return the load of each node over its last seconds [%]."""
    seen: list[tuple[float, dict[str, float]]] = []
    while children.running('publish'):
        now = {name: cpu_seconds(children.pid(name)) for name in nodes}
        seen.append((time.monotonic(), now))
        time.sleep(0.2)
    end, last = seen[-1]
    start, first = next((t, used) for t, used in seen if t > end - seconds)
    return {name: 100 * (last[name] - first[name]) / (end - start) for name in nodes}


def _row(
    arrangement: str, rate: float, seconds: float, folder: Path, loads: dict[str, float]
) -> dict[str, Any]:
    with np.load(folder / 'sent.npz') as file:
        sent, late = file['sent'], float(file['late'])
    latency, lost = _latency(sent, np.load(folder / 'received.npy'))
    hop, _ = _latency(sent, np.load(folder / 'echo.npy'))
    p50, p99 = np.quantile(latency, [0.5, 0.99]) if len(latency) else (np.nan, np.nan)
    hop50, hop99 = np.quantile(hop, [0.5, 0.99])
    return {
        'arrangement': arrangement,
        'rate': f'8 x {rate:g}',
        'seconds': seconds,
        'scans': len(sent),
        'lost': lost,
        'p50_ms': float(p50),
        'p99_ms': float(p99),
        'hop_p50_ms': float(hop50),
        'hop_p99_ms': float(hop99),
        'cpu_percent': loads,
        'publisher_late_ms': 1e3 * late,
    }


def cells(row: dict[str, Any]) -> dict[str, str]:
    """Return a row for people: pairs are p50 / p99, `late` is the publisher's worst delay."""
    p50, p99, hop50, hop99 = (row[f'{key}_ms'] for key in ('p50', 'p99', 'hop_p50', 'hop_p99'))
    return {
        'arrangement': row['arrangement'],
        'Hz': row['rate'],
        'lost': f'{row["lost"]} of {row["scans"]}',
        'latency': f'{p50:.2f} / {p99:.2f}',
        'one hop': f'{hop50:.2f} / {hop99:.2f}',
        'ratio': f'{p50 / hop50:.1f} / {p99 / hop99:.1f}',
        'CPU': ' + '.join(f'{load:.0f}' for load in row['cpu_percent'].values()),
        'late': f'{row["publisher_late_ms"]:.0f}',
    }


def _latency(sent: np.ndarray, received: np.ndarray) -> tuple[np.ndarray, int]:
    """Return the milliseconds of each scan that arrived, and how many did not."""
    _, at_sent, at_received = np.intersect1d(sent[:, 0], received[:, 0], return_indices=True)
    delay = (received[at_received, 1] - sent[at_sent, 1]) * 1e-6
    return delay, len(sent) - len(delay)
