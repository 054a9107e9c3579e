"""The graph as a whole: its domain, its chain, and its IMUs beside each other."""

import os
from pathlib import Path
import socket

from heard_imus import heard_imu, N, readings, UP
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multiimu_ros.cli.graph_symptoms import domains_in_use, environment, judge, merge
from multiimu_ros.cli.symptoms import Finding
from multiimu_ros.nodes.heard import Complaint, Graph
from multiimu_ros.rig import parse_rig

DOMAIN_5 = '  sl  local_address\n 204: 00000000:21FC 00000000:0000 07\n'  # port 8700


def said(*imus, rig=None, variables=None, domains=(), **fields):
    graph = Graph(**({'domain_id': 0, 'nodes': ('/driver',), 'imus': imus} | fields))
    _, findings = judge(graph, rig, environment(variables or {}), domains)
    return '\n'.join(f'{level}: {subject}: {text}' for level, subject, text in findings)


def imu(k, suffix='data_raw', force=UP[3:], **fields):
    values = readings(k) - UP
    values[:, 3:] += force
    fields = {'frame_id': f'imu{k}_link', 'values': values} | fields
    return heard_imu(f'/imu{k}/{suffix}', **fields)


def rig_of(*rotations):
    imus = [
        {'name': f'imu{k}', 'frame_id': f'imu{k}_link', 'extrinsics': {'rotation': rotation}}
        for k, rotation in enumerate(rotations)
    ]
    return parse_rig({'version': 1, 'rig': {'name': 'r'}, 'imus': imus}, 'test')


def test_the_defaults_of_ros_are_shown_where_nothing_is_set():
    shown = environment({'ROS_DOMAIN_ID': '', 'ROS_STATIC_PEERS': 'robot'})
    assert (shown['ROS_DOMAIN_ID'], shown['ROS_AUTOMATIC_DISCOVERY_RANGE']) == ('0', 'SUBNET')
    assert shown['ROS_STATIC_PEERS'] == 'robot'


def test_domains_in_use_follow_from_the_ports():
    assert domains_in_use(DOMAIN_5) == [5]
    assert domains_in_use(DOMAIN_5.replace('21FC', 'FFFF')) == []  # any program's
    assert domains_in_use(DOMAIN_5.replace('21FC', '0035')) == []  # DNS


@pytest.mark.skipif(not Path('/proc/net/udp').exists(), reason='Linux tells so')
def test_a_port_that_is_open_is_seen():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        port = 7400 + 250 * 99 + 200 + os.getpid() % 50  # as the 95th node of domain 99
        one.bind(('127.0.0.1', port))
        assert 99 in domains_in_use(Path('/proc/net/udp').read_text('ascii'))


def test_an_empty_domain_names_the_others_of_this_machine():
    text = said(nodes=(), domains=[0, 5])
    assert 'error: domain 0: no node is in it; this machine also has nodes in 5. Set ROS_' in text
    assert 'also' not in said(nodes=(), domains=[0])


@pytest.mark.parametrize(
    ('variables', 'complaint'),
    [
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'OFF'}, 'error: ROS_AUTOMATIC_DISCOVERY_RANGE: it is'),
        ({'ROS_AUTOMATIC_DISCOVERY_RANGE': 'local'}, 'SYSTEM_DEFAULT, got local'),
        ({'ROS_LOCALHOST_ONLY': '1'}, 'warning: ROS_LOCALHOST_ONLY: it overrules'),
    ],
)
def test_variables_that_keep_nodes_apart_are_named(variables, complaint):
    assert complaint in said(imu(0), variables=variables)


def test_a_graph_without_imus_and_one_without_fusion():
    assert said() == 'error: graph: nobody publishes a sensor_msgs/Imu; start the driver.'
    assert said(imu(0)).startswith('hint: imu/data, odom: nobody publishes it')
    text = said(imu(0), nodes=('/board/fusion',))
    assert text.startswith('hint: imu/data, odom: /board/fusion does not publish it yet')
    assert 'error: /odom: it is published but silent' in said(imu(0), odometries={'/odom': 0})
    covariances = np.tile(np.eye(3), (N, 3, 1, 1))
    fused = heard_imu('/imu/data', frame_id='base_link', covariances=covariances)
    assert said(fused, odometries={'/odom': 9}) == ''


def test_what_nodes_say_comes_with_their_name_the_worst_first():
    complaints = (Complaint('a: b', 'warning', 'tired'), Complaint('c: d', 'error', 'stuck'))
    text = said(imu(0), complaints=complaints)
    assert text.splitlines()[:2] == ['error: c: d: stuck', 'warning: a: b: tired']


def test_one_fault_of_several_topics_is_said_once():
    found = [Finding('hint', 'a', 'x'), Finding('error', 'b', 'y'), Finding('hint', 'c', 'x')]
    assert merge(found + found) == [Finding('error', 'b', 'y'), Finding('hint', 'a, c', 'x')]


def test_an_imu_that_keeps_another_pace_is_named():
    slow = 10**18 + 10_000_000 * np.arange(N)
    text = said(imu(0), imu(1), imu(2, stamp_ns=slow))
    assert '/imu2/data_raw: it comes at 100 Hz and the others at 200 Hz' in text
    assert text.count('comes at') == 1


def test_two_imus_in_one_frame_and_registered_ones_in_two_are_named():
    assert 'is that of /imu0/data_raw' in said(imu(0), imu(1, frame_id='imu0_link'))
    ends = [imu(k, 'data_registered', frame_id=frame) for k, frame in enumerate(['a', 'b'])]
    assert 'they are in several frames (a, b)' in said(*ends)


def test_without_a_rig_file_an_odd_axis_is_a_hint_and_z_down_a_warning():
    text = said(imu(0), imu(3, force=[-9.81, 0, 0]))
    assert 'hint: imu3: x points down at rest' in text
    assert 'warning: imu3: z points down at rest; z up must read +9.81' in said(
        imu(3, force=[0, 0, -9.81])
    )


def test_with_a_rig_file_the_mounting_explains_the_axes():
    turn = Rotation.from_euler('y', 90, degrees=True)  # x of the sensor points down
    rig = rig_of([0, 0, 0, 1], turn.as_quat().tolist(), [0, 0, 0, 1])
    down = [-9.81, 0, 0]
    assert 'rest' not in said(imu(0), imu(1, force=down), imu(2), rig=rig)
    text = said(imu(0), imu(1), imu(2), rig=rig)
    assert 'error: /imu1/data_raw: z up at rest, which the rig file turns 90 deg away' in text


def test_registered_imus_that_all_point_down_are_upside_down():
    ends = [imu(k, 'data_registered', force=[0, 0, -9.81], frame_id='base') for k in range(2)]
    assert 'z points down in the frame of the rig' in said(*ends)


def test_the_rig_file_says_who_is_missing_and_who_is_strange():
    rig = rig_of([0, 0, 0, 1], [0, 0, 0, 1])
    text = said(imu(0, frame_id='other'), imu(7), rig=rig)
    assert 'error: imu1: nobody publishes its data' in text
    assert 'warning: /imu7/data_raw: the rig file does not know this IMU' in text
    assert 'its frame_id must be `imu0_link` by the rig file, got `other`' in text
    ends = [imu(k, 'data_registered', frame_id='base_link') for k in range(2)]
    assert 'rig file' not in said(*ends, rig=rig)
