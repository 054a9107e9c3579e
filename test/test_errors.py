"""One base class, so that the rim catches what is meant for the user and nothing else."""

import pytest

from multiimu_ros import errors


@pytest.mark.parametrize(
    'name', ['ConfigError', 'TransportError', 'CalibrationError', 'SyncError']
)
def test_every_error_for_the_user_shares_one_base(name):
    assert issubclass(getattr(errors, name), errors.MultiImuError)


def test_a_broken_contract_is_not_an_error_for_the_user():
    assert not issubclass(ValueError, errors.MultiImuError)
    assert not issubclass(errors.MultiImuError, ValueError)
