"""The page of a calibration: everything is on it, and it stands when parts are missing."""

import base64
from dataclasses import replace
from html import escape
import io
import re

from calibrated_board import calibrated, rested
import numpy as np
from PIL import Image
import pytest

from multiimu_ros.calibration.static_intervals import StaticIntervals
from multiimu_ros.report import calibration_table
from multiimu_ros.report.calibration_page import lead, write_calibration_page
from multiimu_ros.rig_calibration.board import Board
from multiimu_ros.rig_calibration.verdicts import judge, Verdict

GOOD = Verdict('imu0', 'accelerometer bias', '1 2 3', '0.1 0.1 0.1', 'mm/s^2', 'good', '', 0.1)
USABLE = Verdict('imu1', 'lever arm', '4 5 6', '2 2 2', 'mm', 'usable', 'wave longer', 2.0)
REDO = Verdict('imu0', 'gyroscope scale', '7 8 9', '9 9 9', 'ppm', 'redo', 'turn slowly', 9.0)


@pytest.fixture
def written(tmp_path):
    """Return a function that writes the page of a calibration and reads it."""

    def write(calibration, verdicts=(), title='A board'):
        write_calibration_page(tmp_path / 'page.html', calibration, verdicts, title)
        return (tmp_path / 'page.html').read_text(encoding='utf-8')

    return write


def headings(page):
    return re.findall(r'<h2>(.*?)</h2>', page)


def with_readings(calibration, imu, **readings):
    """Return a calibration in which one IMU read something else."""
    tracks = list(calibration.board.tracks)
    tracks[imu] = replace(tracks[imu], samples=replace(tracks[imu].samples, **readings))
    return replace(calibration, board=Board(calibration.board.rig, tuple(tracks)))


def pictures(page):
    data = re.findall(r'src="data:image/png;base64,([^"]*)"', page)
    return [Image.open(io.BytesIO(base64.b64decode(one))) for one in data]


def test_page_holds_every_imu_every_verdict_and_seven_pictures(written):
    verdicts = judge(calibrated())
    page = written(calibrated(), verdicts)
    table = page[page.index('Parameters') :]
    for verdict in verdicts:
        numbers = calibration_table.in_triples(verdict.value)
        assert f'<td>{escape(verdict.quantity)}</td><td>{numbers}</td>' in table
    for name in calibrated().after.names:
        assert f'<summary>{name}:' in table
    assert table.count('class="grade') == len(verdicts)
    found = pictures(page)
    assert len(found) == 7
    assert all(image.format == 'PNG' for image in found)
    assert page.count('<summary>') == table.count('<details open>') == 3


def test_lead_says_what_was_found():
    given = replace(calibrated(), spread_before=0.0612, spread_after=0.00123)
    text = lead(given, [GOOD, USABLE, REDO])
    assert text.startswith(f'3 IMUs, {len(given.intervals)} rests: |f| − g at rest went from ')
    assert 'the spread between IMUs went from 61.2 to <b>1.23 mm/s²</b>' in text
    assert text.endswith('the worst verdict is <b>redo</b> (1 redo, 1 usable, 1 good).')


def test_lead_counts_long_rests_more():
    given = rested(30.0)
    stamps = given.board.tracks[0].samples.stamp_ns
    intervals = StaticIntervals(stamps[[0, 2000]], stamps[[1899, 2999]])
    force = given.board.tracks[0].samples.specific_force.copy()
    force[2000:, 2] += 0.1
    changed = with_readings(given, 0, specific_force=force)
    text = lead(replace(changed, intervals=intervals), ())
    # 93 mm/s^2 for 19 s and 193 for 10 s.
    expected = np.sqrt((18.99 * 93.35**2 + 9.99 * 193.35**2) / 28.98)
    said = float(re.findall(r'<b>([\d.]+) mm/s²', text)[0])
    assert said == pytest.approx(expected, abs=3.0)  # drift of the force


def test_what_to_do_again_comes_first_and_the_worst_of_it_on_top(written):
    like = replace(USABLE, imu='imu2', why='wave much longer', size=3.0)
    page = written(rested(30.0), [GOOD, USABLE, like, REDO])
    section = calibration_table.again([GOOD, USABLE, like, REDO])
    assert section in page
    assert page.index(section) < page.index('The recording')
    assert section.index('turn slowly') < section.index('wave much longer')
    assert 'imu1, imu2' in section  # in one row, with the reason of the worst
    assert 'wave longer' not in section
    assert GOOD.quantity not in section
    assert section.count('<tr><td>') == 2


def test_nothing_is_to_be_done_again_where_all_is_good():
    assert 'every figure is good' in calibration_table.again([GOOD])
    assert 'nothing is judged' in calibration_table.again([])


def test_parameters_of_many_imus_are_folded():
    verdicts = [replace(GOOD, imu=f'imu{k}') for k in range(4)]
    assert calibration_table.parameters(verdicts).count('<details><summary>') == 4
    assert calibration_table.parameters(verdicts[:3]).count('<details open>') == 3


def test_grades_are_words():
    for grade in ('good', 'usable', 'redo'):
        assert f' {grade}</span>' in calibration_table.grade_mark(grade)


def test_matrices_are_written_in_rows_of_three():
    assert calibration_table.in_triples('1 2 3 4 5 6') == '1 2 3<br>4 5 6'
    assert calibration_table.in_triples('0 0 0 1') == '0 0 0 1'  # a quaternion
    assert calibration_table.in_triples('1 2 3') == '1 2 3'


def test_markup_in_names_and_reasons_is_shown_and_not_obeyed(written):
    nasty = Verdict('<i>a', '<i>b', '<i>c', '<i>d', '<i>e', 'redo', '<i>f & g', 1.0)
    page = written(replace(rested(30.0), notes=('<i>h',)), [nasty], '<i>title')
    assert '<i>' not in page
    for text in ('<i>a', '<i>b', '<i>c', '<i>d', '<i>e', '<i>f & g', '<i>h', '<i>title'):
        assert escape(text) in page


def test_page_of_one_imu_speaks_of_no_others(written):
    page = written(rested(30.0))
    assert headings(page) == [
        'What to do again',
        'Noticed',
        'The recording',
        'Poses',
        'Length of gravity in the rests',
        'Noise',
    ]
    assert 'Not fitted: intrinsics;' in page
    assert 'spread' not in page
    assert '1 IMU, 1 rest:' in page


def test_stages_that_were_left_out_are_named(written):
    bare = replace(
        calibrated(), alignments=(), intrinsics=(), mountings=(), lever_arms=None,
        spread_before=np.nan, spread_after=np.nan,
    )  # fmt: skip
    page = written(bare)
    assert 'Not fitted: clocks, intrinsics, rotations, lever arms;' in page
    assert 'The positions are those that went in.' in page
    assert not {'Clocks', 'Gravity after a turn'} & set(headings(page))
    assert 'nan' not in lead(bare, ())


def test_nothing_is_compared_with_a_drawing_that_was_not_there(written):
    assert 'Found and drawn' in headings(written(calibrated()))
    found = headings(written(calibrated(drawn=False)))
    assert 'The board as found' in found
    assert 'Found and drawn' not in found


def test_rests_that_an_imu_missed_are_left_out(written):
    fits = list(calibrated().intrinsics)
    after = fits[1].residual_after.copy()
    after[[0, 3]] = np.nan
    silent = np.full_like(fits[1].turn_residual, np.nan)
    fits[1] = replace(fits[1], residual_after=after, turn_residual=silent)
    given = replace(calibrated(), intrinsics=tuple(fits))
    assert 'nan' not in lead(given, ())
    assert 'imu1 nan' in written(given)  # not known, and not 0


def test_page_stands_without_any_rest(written):
    none = StaticIntervals(np.zeros(0, np.int64), np.zeros(0, np.int64))
    page = written(replace(rested(30.0), intervals=none))
    assert '1 IMU, 0 rests: |f| − g at rest is not known rms.' in page
    assert len(pictures(page)) == 1


def test_allan_plots_need_a_minute_of_rest(written):
    short = written(rested(30.0))
    assert 'rest for at least 60 s at a stretch, better for hours; its longest rest' in short
    assert 'Allan deviation' not in short
    long = written(rested(70.0, 2))
    assert long.count('<h2>gyroscope: Allan deviation</h2>') == 2
    assert 'noise density [µg/√Hz]' in long
    assert '<summary>imu1</summary>' in long


def test_a_stuck_sensor_is_named_in_place_of_its_plots(written):
    given = rested(70.0, 2)
    rate = given.board.tracks[1].samples.angular_rate.copy()
    rate[:, 0] = 0.0
    page = written(with_readings(given, 1, angular_rate=rate))
    assert '`imu1` must vary, but x is constant' in page
    assert page.count('<h2>gyroscope: Allan deviation</h2>') == 1
