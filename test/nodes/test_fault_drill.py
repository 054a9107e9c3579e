"""Faults, live: the fused output goes on, the faulty IMU is named, and nothing jumps."""

import sys

from fault_drill import board_drill, not_a_number_drill, table
import pytest
from ros_helpers import ros_peer

pytestmark = [pytest.mark.ros, pytest.mark.slow]

# The patience of 50 ms is a matter of stamps, and tested there.  When messages arrive is the
# machine's affair too: they must go on within the second that diagnostics have to name a fault.
GOES_ON_MS = 1000.0
BACK_S = 1.0 + 0.5  # the port is tried every 0.5 s; probation and full share take as long


def judge(outcomes):
    """Check what every fault has to keep to; the table is shown where it does not."""
    shown = table(outcomes)
    sys.stdout.write(shown)
    for each in outcomes:
        # By how much messages came later than they were made: the machine did something else.
        late_s = 1e-3 * max(0.0, each.pause_ms - each.missing_ms)
        assert each.named_s < 1.0 + late_s, shown
        assert each.over_s < BACK_S + late_s, shown
        assert each.step_sigmas < 5.0, shown
        assert each.position_mm < 10.0, shown
        assert each.turn_deg < 0.2, shown


def test_a_board_survives_its_faults(tmp_path):
    with ros_peer() as peer:
        outcomes, _ = board_drill(peer, tmp_path)
    judge(outcomes)
    for each in outcomes[:-1]:
        assert each.pause_ms < GOES_ON_MS, table(outcomes)
        assert each.missing_ms < 10.0, table(outcomes)  # two periods: no scan is lost
    assert outcomes[-1].pause_ms < 1e3 * (2.0 + BACK_S), table(outcomes)


def test_not_a_number_is_named_and_never_fused(tmp_path):
    with ros_peer() as peer:
        outcome = not_a_number_drill(peer, tmp_path)
    judge([outcome])
    assert outcome.pause_ms < GOES_ON_MS, table([outcome])
