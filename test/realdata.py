"""Where the real recordings lie; see the marker `realdata`."""

import os
from pathlib import Path

import pytest

BESIDE = Path(__file__).resolve().parents[2] / 'shared' / 'data'


def data_set(name):
    """Return the folder of one data set; without it, skip the test, or fail it in CI."""
    folder = Path(os.environ.get('MULTIIMU_DATA', BESIDE)) / name
    if folder.is_dir():
        return folder
    reason = f'needs the recordings `{name}`: set MULTIIMU_DATA, or put them at {BESIDE}'
    if os.environ.get('MULTIIMU_REQUIRE_DATA') == '1':
        pytest.fail(reason)
    pytest.skip(reason)
