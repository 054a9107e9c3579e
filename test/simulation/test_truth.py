"""The truth file gives back what was put in."""

import numpy as np
import pytest

from multiimu_ros.errors import ConfigError
from multiimu_ros.simulation.trajectories import make_motion
from multiimu_ros.simulation.truth import load_truth, save_truth


def test_truth_survives_the_file(tmp_path):
    motion, stamps = make_motion('hand', 6.0, 50.0), np.arange(300)
    save_truth(tmp_path / 'truth.npz', motion, stamps)
    again, stamps_again = load_truth(tmp_path / 'truth.npz')
    assert np.array_equal(stamps_again, stamps)
    for name, value in vars(motion).items():
        assert np.array_equal(getattr(again, name), value)
    assert [path.name for path in tmp_path.iterdir()] == ['truth.npz']


def test_files_that_cannot_be_are_named(tmp_path):
    motion = make_motion('static', 0.1, 50.0)
    with pytest.raises(ConfigError, match='Cannot write the truth file'):
        save_truth(tmp_path / 'nowhere' / 'truth.npz', motion, np.arange(5))
    with pytest.raises(ConfigError, match='Cannot read the truth file'):
        load_truth(tmp_path / 'none.npz')
    (tmp_path / 'other.npz').write_bytes(b'text')
    with pytest.raises(ConfigError, match='pass a file of the emulator'):
        load_truth(tmp_path / 'other.npz')
