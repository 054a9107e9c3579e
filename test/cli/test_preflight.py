"""Each verdict changes where it says it does, and what it asks for would mend it."""

import copy

import numpy as np
import pytest

from multiimu_ros.calibration.coverage import CANDIDATES, missing_poses, pose_sigmas
from multiimu_ros.calibration.pose_tracker import PoseTracker
from multiimu_ros.cli import preflight as pf

GOOD = {
    'rest': {'first_s': 30.0, 'longest_s': 4000.0, 'total_s': 4100.0, 'count': 20},
    'poses': {'distinct': 18, 'up': CANDIDATES.tolist(), 'missing': [], 'amplification': 1.0},
    'turns': {'turned_deg': [900.0, 800.0, 700.0], 'least_deg': 300.0, 'lacking': []},
    'waving': {
        'time_s': 60.0,
        'spun': 100.0,
        'weakest': 'x',
        'lever_arm_sigma': 3e-5,
        'time_offset_sigma': 2e-6,
    },
}


def judged(companions=1, clipped=0.0, **changes):
    """Return the verdicts by task; `rest__total_s=3` changes one figure."""
    figures = copy.deepcopy(GOOD)
    for path, value in changes.items():
        block, _, key = path.partition('__')
        figures[block][key] = value
    return {verdict.task: verdict for verdict in pf.judge(figures, companions, clipped)}


def test_a_good_recording_suffices_for_everything():
    assert {verdict.answer for verdict in judged().values()} == {'yes'}
    assert not any(verdict.instead for verdict in judged().values())


def test_one_imu_alone_is_not_asked_for_what_takes_two():
    assert list(judged(companions=0)) == ['noise density', 'Allan', 'accelerometer', 'gyroscope']


@pytest.mark.parametrize(
    ('task', 'changes', 'answer', 'remedy'),
    [
        ('noise density', {'rest__total_s': 9.0}, 'poor', 'lie still for 10 s in all'),
        ('noise density', {'rest__total_s': 1.0}, 'no', 'lie still for 10 s in all'),
        ('Allan', {'rest__longest_s': 700.0}, 'poor', 'an hour of rest'),
        ('Allan', {'rest__longest_s': 500.0}, 'no', 'an hour of rest'),
        ('gyroscope', {'rest__longest_s': 4.0}, 'poor', 'lie still for 5 s in one piece'),
        (
            'gyroscope',
            {'turns__least_deg': 40.0, 'turns__lacking': ['y']},
            'poor',
            '90 deg about y',
        ),
        ('gyroscope', {'turns__least_deg': 20.0, 'turns__lacking': ['y']}, 'no', '90 deg about y'),
        ('gyroscope', {'poses__amplification': np.inf}, 'poor', ''),
        ('registration', {'poses__distinct': 3, 'waving__spun': 0.0}, 'poor', '5 poses or more'),
        ('registration', {'poses__distinct': 1, 'waving__spun': 0.0}, 'no', '5 poses or more'),
        ('registration', {'poses__distinct': 1, 'waving__spun': 50.0}, 'yes', ''),
        ('lever arms', {'waving__lever_arm_sigma': 2e-4}, 'poor', '60 s more, about y and z'),
        ('lever arms', {'waving__lever_arm_sigma': 2e-3}, 'no', '60 s more, about y and z'),
        ('lever arms', {'waving__time_s': 10.0}, 'poor', '5 s more, about y and z'),
        ('lever arms', {'waving__lever_arm_sigma': np.inf}, 'no', '30 s more, about y and z'),
        (
            'lever arms',
            {'waving__lever_arm_sigma': np.inf, 'waving__time_s': 0.0},
            'no',
            '30 s more, about all axes',
        ),
        ('time offsets', {'waving__time_offset_sigma': 1e-4}, 'poor', 'briskly'),
        ('time offsets', {'waving__time_offset_sigma': np.inf}, 'no', 'briskly'),
    ],
)
def test_what_lacks_is_graded_and_mended(task, changes, answer, remedy):
    verdict = judged(**changes)[task]
    assert verdict.answer == answer
    assert remedy in ' '.join(verdict.instead)
    assert bool(verdict.instead) == bool(remedy)


def test_a_lever_arm_along_no_single_axis_asks_for_all_axes():
    verdict = judged(waving__lever_arm_sigma=1.2e-4, waving__weakest='x+z')['lever arms']
    # Noise falls as the root of time: 60 s * (1.2^2 - 1) = 26 s.
    assert verdict.instead == ('wave it about for 26 s more, about all axes',)


def test_clipping_weakens_what_needs_the_motion_and_nothing_else():
    clipped = judged(clipped=0.2)
    weak = [task for task, verdict in clipped.items() if verdict.answer == 'poor']
    assert weak == ['lever arms', 'time offsets']
    assert '20 % of its readings' in clipped['lever arms'].why
    assert {verdict.answer for verdict in judged(clipped=0.01).values()} == {'yes'}


@pytest.mark.parametrize('count', [0, 1, 6, 9])
def test_the_poses_that_are_asked_for_suffice(count):
    up = CANDIDATES[:count]
    verdict = judged(
        poses__up=up.tolist(),
        poses__distinct=count,
        poses__missing=list(missing_poses(up)),
        poses__amplification=float(pose_sigmas(up, 1.0, 1.0).max()),
    )['accelerometer']
    assert verdict.answer == 'no'  # below 9 poses, or rank 6 of 9
    asked = [text.split('(')[1].rstrip(')') for text in verdict.instead]
    up = np.vstack([up, [pf.SIDES[name] for name in asked]])
    assert len(up) >= 12
    assert pose_sigmas(up, 1.0, 1.0).max() <= 2.5


@pytest.mark.parametrize(
    ('name', 'words'),
    [
        ('+x up', 'lay it on its -x side (+x up)'),
        ('-z up', 'lay it on its +z side (-z up)'),
        ('+x-y up', 'prop it on the edge of its -x and +y sides (+x-y up)'),
    ],
)
def test_poses_are_said_by_what_lies_below(name, words):
    assert pf.pose_in_words(name) == words


def test_a_board_is_as_good_as_its_worst_imu_which_is_named():
    good, bad = pf.judge(GOOD, 1), list(judged(rest__total_s=1.0).values())
    judged_board = {v.task: v for v in pf.judge_board({'/a': good, '/b': bad})}
    assert judged_board['noise density'].answer == 'no'
    assert judged_board['noise density'].why.startswith('/b: ')
    assert not judged_board['Allan'].why.startswith('/')
    assert pf.judge_board({}) == []


def test_nothing_recorded_suffices_for_nothing():
    figures = pf.examine_motion(PoseTracker().view())
    assert {verdict.answer for verdict in pf.judge(figures, 1)} == {'no'}
    assert len(figures['poses']['missing']) == 18
