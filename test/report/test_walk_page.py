"""The page of a walk: everything is on it, and it stands when parts are missing."""

from dataclasses import replace
import re
import time

from made_up_walks import made, RATE, stepping, waved
import numpy as np
import pytest

from multiimu_ros.errors import ConfigError
from multiimu_ros.fusion.drift import Disagreement, Gap
from multiimu_ros.fusion.faults import FaultState
from multiimu_ros.pipeline_config import ImuHealth
from multiimu_ros.report import walk_motion_figures, walk_path_figures
from multiimu_ros.report.walk_page import metres, WalkFacts, write_walk_page

FOOT = WalkFacts(recording='<walk>', rig='foot3', profile='foot')
HAND = WalkFacts(recording='waved', rig='ring3', profile='hand')


@pytest.fixture
def written(tmp_path, monkeypatch):
    """Return a function that writes the page of a walk, without drawing, and reads it."""
    for module in (walk_motion_figures, walk_path_figures):
        monkeypatch.setattr(module, 'draw', lambda _painter, _height: b'a picture')

    def write(walk, about=FOOT, smoothed=None):
        path = write_walk_page(tmp_path / 'new' / 'report', walk, about, smoothed)
        assert path == tmp_path / 'new' / 'report' / 'fuse.html'
        return path.read_text(encoding='utf-8')

    return write


def headings(page):
    return re.findall(r'<h2>(.*?)</h2>', page)


def cells(page):
    return dict(re.findall(r'<dt>(.*?)</dt><dd>(.*?)</dd>', page))


def test_the_page_of_a_foot_says_how_it_walked(written):
    page = written(stepping(strides=8, length=1.25))
    assert headings(page) == [
        'From above',
        'Height',
        'Speed',
        'Attitude',
        'Biases',
        'Strides',
        'A few strides close up',
    ]
    said = cells(page)
    assert said['way, stance to stance'] == '10.00 m'
    assert said['start to end, horizontal'] == '10.00 m'
    assert said['2σ of the end, horizontal'] == '0.80 m'
    assert said['stances'] == '9'
    assert said['stride length, median'] == '1.25 m'
    assert said['stride time, median'] == '1.20 s'
    assert '&lt;walk&gt;' in page  # names are told, not obeyed
    assert 'http' not in page


def test_the_page_of_a_hand_has_no_strides(written):
    page = written(waved(), HAND)
    assert headings(page)[-1] == 'Biases'
    assert not [name for name in cells(page) if 'str' in name and 'ide' in name]


def test_a_smoothed_walk_stands_beside_the_live_one(written):
    live = stepping()
    closed = replace(live, position_n=0.5 * live.position_n)
    page = written(live, smoothed=closed)
    assert '<td>start to end, horizontal</td><td>10.00 m</td><td>5.00 m</td>' in page
    assert 'Grey: as the filter knew it live' in page


def test_what_is_unknown_or_missing_is_told_and_not_drawn(written):
    walk = waved(rests=False)
    stamps = walk.stamp_ns.copy()
    stamps[500:] += 3 * 10**9
    position = walk.position_n.copy()
    position[10] = np.nan
    nothing = np.full_like(position, np.nan)
    page = written(replace(walk, stamp_ns=stamps, position_n=position, gyro_bias=nothing), HAND)
    assert headings(page) == ['Noticed', 'From above', 'Height', 'Speed', 'Attitude']
    for part in ('1 frames of 1000', '1 gaps without', '3.01 s', 'never found still'):
        assert part in page


def test_a_foot_that_does_not_walk_is_told(written):
    page = written(made(np.zeros((500, 3)), np.ones(500, bool)))
    assert 'Hardly any strides were found' in page
    assert 'not to be trusted' in page  # 0.8 m of uncertainty over no way at all


def test_the_state_of_every_imu_is_shown(written):
    quiet, loud = Gap(0.0, 1.0, False, ()), Gap(9.0, 1.0, True, ())
    imus = [
        ImuHealth('imu0', 'ok', 200.0, 0.5, 1000, 1, 2, Disagreement(quiet, loud, quiet),
                  FaultState('ok', '', np.nan, 5.0, 3)),
    ]  # fmt: skip
    page = written(stepping(), replace(FOOT, imus=imus, benefit='Twice as quiet.'))
    row = '<td>imu0</td><td>ok</td><td>200.0</td><td>50%</td><td>1000</td><td>1</td><td>2</td>'
    assert f'{row}<td>3 ×</td><td>force</td>' in page
    assert 'Twice as quiet.' in page


def test_the_gain_is_said_without_the_imus(written):
    assert '<li>Twice as quiet.</li>' in written(
        stepping(), replace(FOOT, benefit='Twice as quiet.')
    )


def test_an_hour_costs_seconds_and_a_megabyte(tmp_path):
    hour = stepping(strides=3000)
    assert len(hour) > 3600 * RATE
    begin = time.process_time()
    page = write_walk_page(tmp_path, hour, FOOT)
    # 3 to 6 s, mostly for the text and lines of seven figures; without thinning it is minutes.
    assert time.process_time() - begin < 30.0
    assert page.stat().st_size < 2_000_000


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / 'file').write_text('')
    with pytest.raises(ConfigError, match='Cannot make the folder'):
        write_walk_page(tmp_path / 'file' / 'report', stepping(), FOOT)


def test_lengths_are_in_the_unit_that_fits():
    said = [metres(x) for x in (0.00123, -0.05, 12.345, 1234.5, np.nan)]
    assert said == ['1.2 mm', '-0.05 m', '12.35 m', '1234 m', '–']
