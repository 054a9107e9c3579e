"""The example of a foot walks: without a recording, and with a real one."""

from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import re
import sys

import numpy as np
from numpy.testing import assert_allclose
import pytest
from realdata import data_set

from multiimu_ros.bags import list_topics, read_imus
from multiimu_ros.rig import load_rig

EXAMPLE = Path(__file__).parents[1] / 'examples' / 'foot_walk.py'


@pytest.fixture
def example():
    spec = spec_from_file_location('foot_walk', EXAMPLE)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def said(example, tmp_path, monkeypatch, capsys):
    """Return a function that runs the example and returns the numbers that it prints."""

    def run(*arguments):
        monkeypatch.setattr(sys, 'argv', ['foot_walk.py', *arguments, '-o', str(tmp_path)])
        example.main()
        lines = capsys.readouterr().out.splitlines()
        assert [line.split()[0] for line in lines] == ['walked', 'end', 'pictures']
        assert Path(lines[2].split()[-1]).stat().st_size > 100_000
        distance, stances = re.search(r'([\d.]+) m in (\d+) stances', lines[0]).groups()
        error, sigma = re.search(r'error ([\d.]+) m.*sigma ([\d.]+) m', lines[1]).groups()
        return float(distance), int(stances), float(error), float(sigma)

    return run


def test_a_simulated_walk_closes_within_what_the_filter_expects(said, tmp_path):
    distance, stances, error, sigma = said()
    # 26 strides of 1.2 m, each between two of 27 stances.
    assert_allclose(distance, 31.2, rtol=0.01)
    assert stances == 27
    # The filter expects a foot that rolls and strikes, which errs by about 1 % of the way.
    assert error < 3.0 * sigma < 0.03 * distance
    assert list_topics(tmp_path / 'bag')[0].name == '/imu0/data_raw'
    assert load_rig(tmp_path / 'rig.yaml').imus[0].model == 'BMI160'


def test_rows_that_repeat_a_stamp_are_dropped_and_units_are_si(example, tmp_path):
    path = tmp_path / 'log.csv'
    path.write_text('t,a,b,c,d,e,f\n0.0,180,0,0,0,0,1\n0.0,180,0,0,0,0,1\n0.0025,0,0,90,0,-1,0\n')
    samples = example.read_walk(path)
    assert np.diff(samples.stamp_ns).tolist() == [2_500_000]
    assert_allclose(samples.angular_rate, [[np.pi, 0, 0], [0, 0, np.pi / 2]])
    assert_allclose(samples.specific_force, [[0, 0, 9.80665], [0, -9.80665, 0]])


@pytest.mark.realdata
def test_a_real_walk_ends_near_its_start(said, tmp_path):
    distance, stances, error, _ = said(str(data_set('xio_gait') / 'short_walk.csv'))
    assert 20.0 < distance < 26.0  # a loop of about 25 m, cut short from stance to stance
    assert stances == 17
    assert error < 0.57  # the worse end of what a plain causal filter of this kind reaches
    (track,) = read_imus(tmp_path / 'bag', ['/imu0/data_raw']).tracks
    assert len(track.samples) == 16539 - 205  # rows of the file without its duplicates
