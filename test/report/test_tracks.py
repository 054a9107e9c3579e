"""Tracks of the array, of one IMU and of the plain mean."""

import numpy as np
from numpy.testing import assert_allclose
import pytest
from report_runs import comparison, IMUS, recording

from multiimu_ros.report import tracks
from multiimu_ros.samples import ImuSamples
from multiimu_ros.simulation.placements import ring


def samples(stamps, value):
    return ImuSamples(np.array(stamps), *np.full((2, len(stamps), 3), value))


def test_plain_mean_averages_the_readings_of_one_scan():
    rig = ring(2)
    raw = [samples([1000, 6000, 11000], 1.0), samples([1400, 11400], 3.0)]
    mean = tracks.plain_mean(rig, raw, tolerance_ns=5000)
    # The second scan lacks an IMU; the stamp is the mean one.
    assert mean.stamp_ns.tolist() == [1200, 11200]
    assert_allclose(mean.angular_rate, 2.0)
    assert_allclose(mean.specific_force, 2.0)


def test_the_rig_of_the_mean_has_root_k_less_noise_and_sits_at_the_origin():
    _, rig, _ = recording()
    (mean,) = tracks.mean_rig(rig).imus
    first = rig.imus[0]
    for of_mean, of_one in (
        (mean.noise.noise_density.gyroscope, first.noise.noise_density.gyroscope),
        (mean.intrinsics.gyroscope.bias_sigma, first.intrinsics.gyroscope.bias_sigma),
        (mean.extrinsics.rotation_sigma, first.extrinsics.rotation_sigma),
    ):
        assert_allclose(of_mean, np.array(of_one) / np.sqrt(IMUS))
    assert mean.extrinsics.lever_arm == (0.0, 0.0, 0.0)


def test_one_imu_alone_keeps_its_own_calibration():
    _, rig, _ = recording()
    assert tracks.alone(rig, 2).imus == (rig.imus[2],)


def test_readings_come_in_the_order_of_their_stamps():
    order = tracks.in_order([samples([3, 5], 0.0), samples([1, 4], 1.0)])
    imus, stamps, _ = order
    assert list(zip(imus, stamps, strict=True)) == [(1, 1), (0, 3), (1, 4), (0, 5)]


def test_a_track_is_cut_to_a_span():
    track = comparison().tracks['array']
    begin, end = track.stamp_ns[10], track.stamp_ns[20]
    assert len(track.between(begin, end)) == 11


def test_no_frames_are_refused():
    with pytest.raises(ValueError, match='at least one fused frame'):
        tracks.as_track([])
