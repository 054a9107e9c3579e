"""Clocks of a board: on that of the first IMU, or refused by name."""

import numpy as np
import pytest
from rig_runs import bare_rig, calibrated, LATE, recorded
from scipy.stats import chi2

from multiimu_ros.arrays import NANOSECONDS
from multiimu_ros.errors import CalibrationError
from multiimu_ros.rig_calibration.board import take_board
from multiimu_ros.rig_calibration.time_stage import align_coarsely, apply_offsets
from multiimu_ros.samples import ImuSamples

SEEDS = (0, 1)


def test_offsets_are_within_their_sigma_and_five_microseconds():
    errors, z = [], []
    for seed in SEEDS:
        for k, imu in enumerate(calibrated(seed).after.imus[1:], start=1):
            errors.append(imu.time_offset - LATE * k)
            z.append(errors[-1] / imu.time_offset_sigma)
    assert np.abs(errors).max() < 5e-6
    assert np.sum(np.square(z)) < chi2(len(z)).ppf(1 - 1e-3)


def test_stamps_of_the_board_are_on_the_first_clock():
    run, found = recorded(0), calibrated(0)
    for k, track in enumerate(found.board.tracks):
        moved = track.samples.stamp_ns - run.raw[k].stamp_ns
        assert np.abs(moved - LATE * k * NANOSECONDS).max() < 5000  # [ns]
    assert found.after.imus[0].time_offset == 0.0
    assert found.alignments[0] is None


def test_an_imu_on_another_body_is_refused_by_name():
    raw, other = recorded(0).raw, recorded(1).raw
    with pytest.raises(CalibrationError, match='`imu2` does not fit `imu0`: the rates of turn'):
        align_coarsely(take_board(bare_rig(), [raw[0], raw[1], other[2]]))


def test_offsets_of_the_rig_file_are_applied_relative_to_the_first():
    samples = recorded(0).raw[0]
    rig = bare_rig(2)
    known = [
        imu.model_copy(update={'time_offset': offset})
        for imu, offset in zip(rig.imus, (0.5, 0.503), strict=True)
    ]
    board = take_board(rig.model_copy(update={'imus': tuple(known)}), [samples, samples])
    tracks = apply_offsets(board).tracks
    assert (tracks[0].samples.stamp_ns == samples.stamp_ns).all()
    assert (tracks[1].samples.stamp_ns == samples.stamp_ns + 3_000_000).all()


def test_a_clock_that_began_elsewhere_is_brought_along():
    raw = recorded(0).raw
    late = ImuSamples(
        raw[1].stamp_ns - 1_000_000 * NANOSECONDS, raw[1].angular_rate, raw[1].specific_force
    )
    _, found = align_coarsely(take_board(bare_rig(2), [raw[0], late]))
    assert abs(found[1].coarse - 1_000_000 - LATE) < 0.005  # a sample
