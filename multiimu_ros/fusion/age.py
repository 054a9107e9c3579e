"""How old the biases of a rig file are: the provenance says when they were right.

Ages are differences of stamps; no clock is read.  A stamp before the date, as of a recording that
is older than the calibration or of a board that counts from zero, makes no bias younger: age 0.
"""

from datetime import date, datetime, UTC

import numpy as np

from multiimu_ros.arrays import NANOSECONDS, Vector
from multiimu_ros.rig import Imu, Rig

# Keys of the provenance, the first that is there counts.  A bias is as old as the last rest that
# taught it; that rest says nothing of the accelerometer, whose bias is as old as its calibration.
LAST_REST, SAVED, CALIBRATED = 'biases_last_rest', 'biases_saved', 'date'
RATE_DATES = (LAST_REST, SAVED, CALIBRATED)
FORCE_DATES = (CALIBRATED,)


def utc_text(stamp_ns: int) -> str:
    """Return an instant as the provenance writes it: ISO 8601, whole seconds."""
    return datetime.fromtimestamp(stamp_ns // NANOSECONDS, UTC).isoformat(timespec='seconds')


def bias_ages(imu: Imu, now_ns: int | None) -> Vector:
    """Return how old the biases of gyroscope and accelerometer are, (2,) [s].

    0 where the provenance has no date, or `now_ns` is None.
    """
    if now_ns is None:
        return np.zeros(2)
    ages = []
    for keys in (RATE_DATES, FORCE_DATES):
        dates = [_seconds(imu.provenance[key]) for key in keys if key in imu.provenance]
        known = [seconds for seconds in dates if seconds is not None]
        ages.append(max(0.0, now_ns / NANOSECONDS - known[0]) if known else 0.0)
    return np.array(ages)


def is_dated(rig: Rig) -> bool:
    """Say whether the biases of some IMU have a date."""
    keys = (*RATE_DATES, *FORCE_DATES)
    return any(_seconds(imu.provenance.get(key)) is not None for imu in rig.imus for key in keys)


def _seconds(value: object) -> float | None:
    """Return a date of the provenance [s since 1970]; None if it is none.  Bare ones are UTC."""
    if isinstance(value, str):
        try:
            value = datetime.fromisoformat(value)
        except ValueError:
            return None
    if isinstance(value, date) and not isinstance(value, datetime):  # YAML reads bare dates so
        value = datetime(value.year, value.month, value.day)
    if not isinstance(value, datetime):
        return None
    return (value if value.tzinfo else value.replace(tzinfo=UTC)).timestamp()
