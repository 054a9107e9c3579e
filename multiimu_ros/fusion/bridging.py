"""Across the gap that saturated gyroscopes leave; `saturation` has the mathematics."""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.fusion.fusion_state import (
    BEFORE,
    BRIDGED,
    FORCES,
    FusionState,
    INTERVAL,
    PERIOD,
    SLOPE,
    VALUE,
    VARIANCE,
    WALK,
)
from multiimu_ros.fusion.rig_model import RigModel
from multiimu_ros.fusion.saturation import bridge_rate, learn_walk, start_bridge
from multiimu_ros.fusion.scan_noise import slow_variance

LASTING = 0.5  # [s] errors of scale and bias last while a hand turns


@compiled
def bridge_gap(
    model: RigModel,
    state: FusionState,
    settings: Vector,
    z: Vectors,
    R: Vectors,
    at_limit: Vectors,
    b: Vectors,
) -> None:
    """Where no gyroscope measures an axis, for all are at their limit, ask the accelerometers."""
    unseen = b[:, 0].sum() * b[:, 1].sum() * b[:, 2].sum() == 0.0
    if not (unseen and at_limit[:, :3].any() and state.clock[PERIOD] > 0.0):
        state.clock[BRIDGED] = 0.0
        return
    dt, bridge, walk = state.clock[INTERVAL], state.bridge, state.clock[WALK:]
    if state.clock[BRIDGED] == 0.0:
        last, acceleration = state.rates[-1], state.fused[SLOPE, :3]
        bridge[0], bridge[1:] = start_bridge(
            last, state.fused[BEFORE, :3], acceleration, state.spread
        )
    white = state.density[:, :3] ** 2 / state.clock[PERIOD]
    lasting = slow_variance(model, state, FORCES, z, np.zeros((3, 3))) * (LASTING / dt)
    bridge[0], bridge[1:] = bridge_rate(
        bridge[0], bridge[1:], dt, settings[:3], walk, z[:, :3], white, at_limit,
        model.to_sensor, z[:, 3:], R[:, 3:] + lasting, model.lever_arms_b,
    )  # fmt: skip
    state.clock[BRIDGED] = 1.0
    for axis in range(3):
        state.fused[VALUE, axis] = bridge[0, axis]
        state.fused[VARIANCE, axis] = bridge[1 + axis, axis]


@compiled
def note_walk(state: FusionState, P: Vector, acceleration: Vector, P_a: Matrix) -> None:
    """Note how well the angular acceleration predicts the rate, for the next gap."""
    before, now, noise = np.empty(6), np.empty(6), np.empty(3)
    dt = state.clock[INTERVAL]
    before[:3], now[:3] = state.rates[-2], state.rates[-1]
    before[3:], now[3:] = state.fused[SLOPE, :3], acceleration
    for axis in range(3):
        noise[axis] = 2.0 * P[axis] + 0.5 * dt * dt * P_a[axis, axis]
    if np.isfinite(noise.sum()):
        learn_walk(state.clock[WALK:], before, now, noise, dt)
