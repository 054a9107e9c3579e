"""What is wrong with a running graph as a whole: its domain, its IMUs beside each other."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
import re

import numpy as np

from multiimu_ros.arrays import Vector
from multiimu_ros.cli.symptoms import ERROR, examine, Figures, Finding, HINT, name_axis, WARNING
from multiimu_ros.nodes.heard import Graph, ImuTopic
from multiimu_ros.rig import Rig

PACE = 0.02  # of the rate: clocks of boards differ by 1e-4, data sheets allow a percent
ASTRAY = np.cos(np.deg2rad(10.0))  # ten times what biases and a mounting by hand explain
RANGES = ('SUBNET', 'LOCALHOST', 'OFF', 'SYSTEM_DEFAULT')
VARIABLES = (
    'ROS_DOMAIN_ID',
    'ROS_AUTOMATIC_DISCOVERY_RANGE',
    'ROS_STATIC_PEERS',
    'ROS_LOCALHOST_ONLY',
    'RMW_IMPLEMENTATION',
)
DEFAULTS = {'ROS_DOMAIN_ID': '0', 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET'}
FIRST_PORT, PORTS = 7400, 250  # of domain 0, and per domain (RTPS 2.5, 9.6.2.3)
LAST_DOMAIN = 101  # above, the ports are those that Linux gives to any program
LEVELS = (ERROR, WARNING, HINT)

Examined = Sequence[tuple[ImuTopic, Figures]]


def environment(variables: Mapping[str, str]) -> dict[str, str]:
    """Return what decides who hears whom: the variables that are set, and ROS's defaults."""
    found = {**DEFAULTS, **{name: variables.get(name, '') for name in VARIABLES}}
    return {name: found[name] or DEFAULTS.get(name, '') for name in VARIABLES}


def domains_in_use(udp_table: str) -> list[int]:
    """Return the ROS domains that programs of this machine listen to.

    Parameters
    ----------
    udp_table : str
        Content of /proc/net/udp; local address and port are in its second column, in hexadecimal.
    """
    ports = [
        int(port, 16) for port in re.findall(r'^\s*\d+: \w+:(\w{4}) ', udp_table, re.MULTILINE)
    ]
    domains = {(port - FIRST_PORT) // PORTS for port in ports if port >= FIRST_PORT}
    return sorted(domain for domain in domains if domain <= LAST_DOMAIN)


def judge(
    graph: Graph, rig: Rig | None, variables: Mapping[str, str], domains: Sequence[int]
) -> tuple[list[Figures], list[Finding]]:
    """Return the figures of each Imu topic, and all that is wrong, the worst first.

    Parameters
    ----------
    rig : Rig or None
        What the board should be like.
    variables : mapping
        As `environment` returns them.
    domains : sequence of int
        As `domains_in_use` returns them.
    """
    gravity = 9.80665 if rig is None else rig.rig.gravity_magnitude
    examination = partial(examine, gravity=gravity, simulated_time=graph.simulated_time)
    results = [examination(imu) for imu in graph.imus]
    examined = [(imu, figures) for imu, (figures, _) in zip(graph.imus, results, strict=True)]
    findings = [
        *_judge_environment(graph, variables, domains),
        *(Finding(level, subject, text) for subject, level, text in graph.complaints),
        *(finding for _, found in results for finding in found),
        *_judge_chain(graph),
        *_judge_paces(examined),
        *_judge_frames(graph.imus),
        *_judge_axes(examined, rig),
        *([] if rig is None else _judge_rig(graph.imus, rig)),
    ]
    return [figures for figures, _ in results], merge(findings)


def merge(findings: Sequence[Finding]) -> list[Finding]:
    """Say what is wrong with several subjects once, and the worst first."""
    subjects: dict[tuple[str, str], list[str]] = {}
    for level, subject, text in findings:
        listed = subjects.setdefault((level, text), [])
        if subject not in listed:
            listed.append(subject)
    merged = [
        Finding(level, ', '.join(listed), text) for (level, text), listed in subjects.items()
    ]
    return sorted(merged, key=lambda finding: LEVELS.index(finding.level))


def _judge_environment(
    graph: Graph, variables: Mapping[str, str], domains: Sequence[int]
) -> Iterator[Finding]:
    reach = variables['ROS_AUTOMATIC_DISCOVERY_RANGE']
    name = 'ROS_AUTOMATIC_DISCOVERY_RANGE'
    if reach == 'OFF':
        yield Finding(ERROR, name, 'it is OFF: nobody hears anybody; set LOCALHOST or SUBNET.')
    elif reach not in RANGES:
        yield Finding(ERROR, name, f'it must be one of {", ".join(RANGES)}, got {reach}.')
    if variables['ROS_LOCALHOST_ONLY']:
        text = f'it overrules {name} and is deprecated; unset it.'
        yield Finding(WARNING, 'ROS_LOCALHOST_ONLY', text)
    if not graph.nodes:
        others = ', '.join(str(d) for d in domains if d != graph.domain_id)
        elsewhere = f'; this machine also has nodes in {others}' if others else ''
        text = (
            f'no node is in it{elsewhere}. Set ROS_DOMAIN_ID and {name} here '
            'as where the driver runs.'
        )
        yield Finding(ERROR, f'domain {graph.domain_id}', text)


def _judge_chain(graph: Graph) -> Iterator[Finding]:
    stages = {imu.stage for imu in graph.imus if imu.publishers}
    if graph.nodes and not stages:
        yield Finding(ERROR, 'graph', 'nobody publishes a sensor_msgs/Imu; start the driver.')
    present = {'imu/data': 'fused' in stages, 'odom': bool(graph.odometries)}
    fusing = [name for name in graph.nodes if name.endswith(('/fusion', '/pipeline'))]
    text = 'nobody publishes it; start `fusion` or `pipeline`.'
    if fusing:
        text = f'{fusing[0]} does not publish it yet; let it compile its kernels, or see its log.'
    for name in [name for name, published in present.items() if stages and not published]:
        yield Finding(HINT, name, text)
    for topic, count in graph.odometries.items():
        if not count:
            yield Finding(ERROR, topic, 'it is published but silent; look at what feeds it.')


def _judge_paces(examined: Examined) -> Iterator[Finding]:
    """Compare the rates of the IMUs at each stage."""
    for stage in sorted({imu.stage for imu, _ in examined}):
        rates = {
            imu.track.topic: figures['rate_hz']
            for imu, figures in examined
            if imu.stage == stage and np.isfinite(figures['rate_hz'])
        }
        common = float(np.median(list(rates.values()))) if rates else 0.0
        for topic, rate in rates.items():
            if abs(rate - common) > PACE * common:
                text = (
                    f'it comes at {rate:.4g} Hz and the others at {common:.4g} Hz; '
                    'let all IMUs of a board be read at one rate.'
                )
                yield Finding(WARNING, topic, text)


def _judge_frames(imus: Sequence[ImuTopic]) -> Iterator[Finding]:
    """Raw readings are in frames of their own, registered ones in one frame."""
    owners: dict[str, str] = {}
    registered = sorted({imu.track.frame_id for imu in imus if imu.stage == 'registered'} - {''})
    if len(registered) > 1:
        text = f'they are in several frames ({", ".join(registered)}); use one rig file for all.'
        yield Finding(ERROR, 'data_registered', text)
    for imu in imus:
        if imu.stage == 'raw' and imu.track.frame_id:
            first = owners.setdefault(imu.track.frame_id, imu.track.topic)
            if first != imu.track.topic:
                text = (
                    f'its frame_id `{imu.track.frame_id}` is that of {first}; give each its own.'
                )
                yield Finding(WARNING, imu.track.topic, text)


def _judge_axes(examined: Examined, rig: Rig | None) -> Iterator[Finding]:
    """At rest z up reads +g; in the frame of the rig all IMUs agree on where that is."""
    turns = {} if rig is None else {i.name: i.extrinsics.R_bs for i in rig.imus if i.extrinsics}
    ups: dict[tuple[str, str], Vector] = {}
    for imu, figures in examined:
        if figures['up'] is None:
            continue
        up = np.array(figures['up'])
        common = imu.stage in ('registered', 'fused')
        if common or imu.imu in turns:
            ups[imu.track.topic, name_axis(up)] = up if common else turns[imu.imu] @ up
        elif name_axis(up) not in ('z up', 'tilted'):
            yield _unexplained(imu, name_axis(up))
    if not ups:
        return
    middle = np.median(list(ups.values()), axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    for (topic, axis), up in ups.items():
        if up @ middle < ASTRAY:
            angle = np.rad2deg(np.arccos(np.clip(up @ middle, -1.0, 1.0)))
            text = (
                f'{axis} at rest, which the rig file turns {angle:.0f} deg away from where the '
                'others see up; correct `extrinsics.rotation` of that IMU, or its axes.'
            )
            yield Finding(ERROR, topic, text)
        elif up[2] < -ASTRAY:
            text = (
                'z points down in the frame of the rig; z up must read +9.81 at rest: turn the '
                'rig over, or let the driver publish what the accelerometer feels.'
            )
            yield Finding(WARNING, topic, text)


def _unexplained(imu: ImuTopic, axis: str) -> Finding:
    letter, way = axis.split()
    sense = f'{letter} points {way} at rest'
    if axis == 'z down':
        text = (
            f'{sense}; z up must read +9.81: turn it over, say so in `extrinsics.rotation`, or '
            'let the driver publish what the accelerometer feels, not gravity.'
        )
        return Finding(WARNING, imu.imu, text)
    return Finding(HINT, imu.imu, f'{sense}; `extrinsics.rotation` in the rig file must say so.')


def _judge_rig(imus: Sequence[ImuTopic], rig: Rig) -> Iterator[Finding]:
    """Compare who speaks, and in which frames, with the rig file."""
    stages = ('raw', 'calibrated', 'registered')
    present = {imu.imu for imu in imus if imu.stage in stages and imu.publishers}
    frames = {imu.name: imu.frame_id for imu in rig.imus}
    for name in rig.names:
        if name not in present:
            text = 'nobody publishes its data; plug it in, or take it out of the rig file.'
            yield Finding(ERROR, name, text)
    for imu in imus:
        if imu.stage in stages and imu.imu not in frames:
            yield Finding(WARNING, imu.track.topic, 'the rig file does not know this IMU; add it.')
            continue
        wanted = frames.get(imu.imu) if imu.stage in ('raw', 'calibrated') else rig.rig.base_frame
        got = imu.track.frame_id
        if got and imu.stage != 'other' and got != wanted:
            text = f'its frame_id must be `{wanted}` by the rig file, got `{got}`; correct one.'
            yield Finding(WARNING, imu.track.topic, text)
