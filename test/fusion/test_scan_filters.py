"""The filters that are called between the parts of a scan, in a stage of their own."""

import numpy as np
from numpy.testing import assert_allclose
import pytest

from multiimu_ros.fusion.array_fusion import ArrayFusion, ArrayFusionConfig
from multiimu_ros.fusion.rig_model import bare_model
from multiimu_ros.synchronization.arrivals import Arrivals
from multiimu_ros.synchronization.synchronizer import Scan

DENSITY = np.repeat([1.2e-4, 1.8e-3], 3)
SIGMA = DENSITY * np.sqrt(200.0)
STEP_NS = 5_000_000
REST = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81])
ALL = np.ones(3)


def stage(**settings):
    config = ArrayFusionConfig(angular_acceleration_sigma=50.0, jerk_sigma=500.0, **settings)
    model = bare_model(np.tile(DENSITY, (3, 1)), bias_variance=np.full((3, 6), 1e-4))
    return ArrayFusion(model, config)


def arrivals(n, values):
    """Return the readings of scan n as samples of its instant."""
    here = np.flatnonzero(~np.isnan(values[:, 0]))
    return Arrivals(np.full(len(here), n * STEP_NS), here, values[here])


def push(fusion, n, values, share=ALL):
    return fusion.push(Scan(n * STEP_NS, values, share, np.ones(3)), arrivals(n, values))


def test_shares_that_wait_for_a_fusion_leave_no_noise_in_the_common_offset(rng):
    # Seen before the cure: the first IMU alone in the first scan, whose noise of the nine scans
    # to the next fusion stayed in all later values.
    fused = []
    for every in (1, 10):
        fusion = stage(fuse_every=every)
        readings = REST + SIGMA * np.random.default_rng(5).standard_normal((60, 3, 6))
        readings[0, 1:] = np.nan
        fused.append([push(fusion, n, z).values for n, z in enumerate(readings)])
    # After the second fusion both are the same mean, but for the offsets of two scans' noise.
    assert_allclose(fused[0][15:], fused[1][15:], atol=0.02 * SIGMA[3])


def test_scaat_needs_its_samples():
    with pytest.raises(ValueError, match=r'`arrivals` must hold the samples .*, got None'):
        stage(master='scaat').push(Scan(0, np.zeros((3, 6)), ALL, ALL))


@pytest.mark.parametrize('settings', [{}, {'local': 'ukf'}, {'master': 'scaat'}])
def test_what_was_never_measured_is_not_said(settings, rng):
    fusion = stage(**settings)
    assert push(fusion, 0, np.full((3, 6), np.nan)) is None
    assert push(fusion, 1, REST + SIGMA * rng.standard_normal((3, 6)), 0.0 * ALL) is None
    for n in range(2, 40):
        frame = push(fusion, n, REST + SIGMA * rng.standard_normal((3, 6)))
        assert np.isfinite(frame.table).all()
    assert (np.abs(frame.values - REST) < 5 * np.sqrt(frame.variance)).all()


@pytest.mark.parametrize('settings', [{}, {'local': 'ukf'}, {'master': 'scaat'}])
def test_a_restart_forgets_the_motion(settings):
    fusion = stage(**settings)
    for n in range(30):
        push(fusion, n, np.tile(REST + 1.0, (3, 1)))
    fusion.restart()
    frame = push(fusion, -1000, np.tile(REST, (3, 1)))
    # A scaat state starts with full scale for a sigma: what it knew before is gone, 1e-6 of it.
    assert_allclose(frame.values, REST, atol=1e-3)


def test_the_force_of_scaat_counts_the_turn_once(rng):
    arms = np.tile([0.2, 0.0, 0.0], (3, 1))
    config = ArrayFusionConfig(
        angular_acceleration_sigma=50.0, jerk_sigma=500.0, master='scaat', guard=False
    )
    fusion = ArrayFusion(bare_model(np.tile(DENSITY, (3, 1)), lever_arms_b=arms), config)
    frame = None
    for n in range(100):
        frame = push(fusion, n, REST + SIGMA * rng.standard_normal((3, 6)))
    # Its own covariance has what the turn does at 20 cm; that of the slope is not added to it.
    own = np.diag(fusion._fuse._filter._state.P)[6:9]
    assert_allclose(frame.variance[3:], own, rtol=0.01)
