"""Compiled kernels of the federated odometry; `federated_odometry.py` tells the idea.

Local filter i is the 15-state filter of `error_dynamics` with a row of every array; its mean and
covariance are those of the base, and its own lever arm comes in where the readings are integrated.
Equations and their numbers are those of docs/derivations/federated_odometry.md.
"""

import numpy as np

from multiimu_ros.arrays import Matrix, Vector, Vectors
from multiimu_ros.compiled import compiled
from multiimu_ros.odometry import error_fields as fields
from multiimu_ros.odometry.attitude_steps import LINEAR, OUTAGE
from multiimu_ros.odometry.error_dynamics import predict, remember
from multiimu_ros.odometry.error_updates import begin_rest, update
from multiimu_ros.odometry.strapdown import cross
from multiimu_ros.rotations import exp_so3, log_so3, product, renormalise

# Columns of `track`: what an IMU is; its share by its noise alone; its share among the members;
# time since it was last heard and since it began to agree, and for how long it has to agree [s].
STATUS, NOMINAL, SHARE, WAITED, AGREED, PROBATION = range(6)
TRACK = 6
OUT, PROBE, MEMBER = 0.0, 1.0, 2.0
PROBATION_S = 2.0  # [s] more than a stride; twice as long after each contradiction
GATE = 33.0  # chi-squared of three axes, exceeded by noise once in 3 million
# What the lever arms (1 mm) and the instants (0.1 ms) of two IMUs leave between them: [m], [m/s],
# [rad], at 10 rad/s and 50 m/s^2.
FLOOR = np.array([1e-3, 1e-2, 1e-3])


@compiled
def _to_arm(x: Vector, R: Matrix, rate: Vector, arm: Vector, sign: float) -> None:
    """Move position and velocity of x (15,) from the base to the lever arm, or back at -1."""
    x[0:3] += sign * (R @ arm)
    x[3:6] += sign * (R @ cross(rate - x[9:12], arm))


@compiled
def step_local(
    x: Vector,
    R: Matrix,
    P: Matrix,
    memory: Vector,
    settings: Vector,
    arm: Vector,
    dt: float,
    rate: Vector,
    force: Vector,
    rate_density: Vector,
    force_density: Vector,
    still: bool,
    resting: bool,
) -> None:
    """Take one reading at lever arm `arm` (3,) into one local filter."""
    turns = not resting and dt <= OUTAGE
    begin_rest(x, R, P, memory, settings, dt, resting)
    if turns:
        _to_arm(x, R, memory[fields.RATE : fields.FORCE], arm, 1.0)
    predict(x, R, P, memory, settings, dt, rate, force, rate_density, force_density, resting)
    if turns:
        _to_arm(x, R, rate, arm, -1.0)
    update(x, R, P, memory, settings, dt, rate, force, rate_density, force_density, still, resting)
    remember(memory, dt, rate, force, still, resting)


@compiled
def _difference(x: Vector, R: Matrix, x_f: Vector, R_f: Matrix) -> Vector:
    """Return how far (9,) a local is from the master: position, velocity, attitude."""
    d = np.empty(9)
    d[:6] = x[:6] - x_f[:6]
    d[6:] = log_so3(product(R_f.T, R))
    return d


@compiled
def _shift(x_f: Vector, R_f: Matrix, d: Vector) -> None:
    x_f[:6] += d[:6]
    R_f[:] = renormalise(product(R_f, exp_so3(d[6:])))


@compiled
def share_out(track: Vectors, P: Matrix, settings: Vectors, walks: Vectors) -> None:
    """Share out among the members: what is an IMU's own counts by its share (4), (5).

    `settings` (K, SETTINGS) are those of the filters, `walks` (K, 6) of the IMUs' own biases.
    """
    for i in range(len(track)):
        before, share = track[i, SHARE], own_share(track, i)
        settings[i, fields.WALKS : fields.ROLLING_ARM] = np.sqrt(share) * walks[i]
        track[i, SHARE] = share if track[i, STATUS] == MEMBER else 0.0
        if 0.0 < before < track[i, SHARE]:
            P[i] *= share / before


@compiled
def own_share(track: Vectors, i: int) -> float:
    """Return the share of IMU i among the members, as one of them (2)."""
    total = track[i, NOMINAL]
    for k in range(len(track)):
        if k != i and track[k, STATUS] == MEMBER:
            total += track[k, NOMINAL]
    return float(track[i, NOMINAL] / total)


@compiled
def fuse(
    x: Vectors, R: Matrix, P: Matrix, track: Vectors, offsets: Vectors,
    x_f: Vector, R_f: Matrix, P_f: Matrix,
) -> None:  # fmt: skip
    """Move the master by what the members heard in this scan say, offsets apart (6), (7)."""
    moved, heard = np.zeros(9), 0.0
    for i in range(len(x)):
        if track[i, STATUS] == MEMBER and track[i, WAITED] == 0.0:
            d = _difference(x[i], R[i], x_f, R_f)
            moved += track[i, SHARE] * (d - offsets[i])
            heard += track[i, SHARE]
    if heard > 0.0:
        _shift(x_f, R_f, moved / heard)
    P_f[:] = 0.0
    x_f[9:] = 0.0
    for i in range(len(x)):
        if track[i, STATUS] != MEMBER:
            continue
        share = track[i, SHARE]
        x_f[9:] += share * x[i, 9:]
        for row in range(15):
            for column in range(15):
                P_f[row, column] += share * P[i, row, column]
        if track[i, WAITED] == 0.0:
            offsets[i] = _difference(x[i], R[i], x_f, R_f)


@compiled
def recentre(track: Vectors, offsets: Vectors, x_f: Vector, R_f: Matrix) -> None:
    """Put the master where its members are, after one has left or come."""
    mean = np.zeros(9)
    for i in range(len(track)):
        mean += track[i, SHARE] * offsets[i]
    _shift(x_f, R_f, mean)
    for i in range(len(track)):
        offsets[i] -= mean


@compiled
def contradiction(P: Matrix, P_f: Matrix, share: float, offset: Vector) -> float:
    """Return the largest chi-squared of three axes of an offset (9,), by (8)."""
    worst = 0.0
    for block in range(3):
        score = 0.0
        for axis in range(3 * block, 3 * block + 3):
            variance = (1.0 / share - 2.0) * P[axis, axis] + P_f[axis, axis]
            score += offset[axis] ** 2 / (variance + FLOOR[block] ** 2)
        worst = max(worst, score)
    return worst


@compiled
def seed(
    x: Vector, R: Matrix, P: Matrix, x_f: Vector, R_f: Matrix, P_f: Matrix,
    bias: Vector, bias_P: Matrix,
) -> None:  # fmt: skip
    """Start a local filter from the master; its biases (6,) have the covariance `bias_P`."""
    x[:9] = x_f[:9]
    x[9:] = bias
    R[:] = R_f
    P[:] = 0.0
    P[:9, :9] = P_f[:9, :9]
    P[9:, 9:] = bias_P


@compiled
def exclude(
    P: Matrix, track: Vectors, offsets: Vectors, P_f: Matrix, members: int, heard: int
) -> bool:
    """Put out whoever has gone silent, and at most one whom the others contradict."""
    changed, worst, whose = False, GATE, -1
    for i in range(len(track)):
        if track[i, STATUS] != MEMBER:
            continue
        if track[i, WAITED] > OUTAGE and heard > 0:
            track[i, STATUS], track[i, AGREED] = OUT, 0.0
            members -= 1
            changed = True
        elif track[i, WAITED] == 0.0 and members > 2:
            score = contradiction(P[i], P_f, track[i, SHARE], offsets[i])
            if score > worst:
                worst, whose = score, i
    if whose >= 0 and members > 2:
        track[whose, STATUS], track[whose, AGREED] = OUT, 0.0
        track[whose, PROBATION] *= 2.0
        changed = True
    return changed


@compiled
def admit(
    x: Vectors, R: Matrix, P: Matrix, track: Vectors, offsets: Vectors,
    x_f: Vector, R_f: Matrix, P_f: Matrix, start: Vectors, start_P: Vectors,
    i: int, dt: float,
) -> bool:  # fmt: skip
    """Watch an IMU that is heard but no member; say whether it becomes one."""
    share = own_share(track, i)
    offsets[i] = 0.0
    if track[i, STATUS] == OUT:
        seed(x[i], R[i], P[i], x_f, R_f, P_f, start[i], share * np.diag(start_P[i]))
        track[i, STATUS], track[i, AGREED] = PROBE, 0.0
        return False
    d = _difference(x[i], R[i], x_f, R_f)
    if contradiction(P[i], P_f, share, d) > GATE:
        track[i, STATUS] = OUT
        return False
    track[i, AGREED] += dt
    if track[i, AGREED] < track[i, PROBATION]:
        return False
    seed(x[i], R[i], P[i], x_f, R_f, P_f, x[i, 9:].copy(), P[i, 9:, 9:].copy())
    track[i, STATUS] = MEMBER
    return True


@compiled
def take_over(track: Vectors, P_f: Matrix, settings: Vector) -> None:
    """Where no member is heard any more, go on with whoever is, and admit what that hides."""
    silent = 0.0
    for i in range(len(track)):
        if track[i, STATUS] == MEMBER:
            silent = track[i, WAITED] if silent == 0.0 else min(silent, track[i, WAITED])
            track[i, STATUS], track[i, AGREED] = OUT, 0.0
    for axis in range(3):
        P_f[axis, axis] += (0.5 * settings[fields.MOTION_FORCE] * silent * silent) ** 2
        P_f[3 + axis, 3 + axis] += (settings[fields.MOTION_FORCE] * silent) ** 2
        P_f[6 + axis, 6 + axis] += min(settings[fields.MOTION_RATE] * silent, LINEAR) ** 2


@compiled
def scan_step(
    x: Vectors, R: Matrix, P: Matrix, memory: Vectors, settings: Vectors, track: Vectors,
    offsets: Vectors, x_f: Vector, R_f: Matrix, P_f: Matrix, arms: Vectors, walks: Vectors,
    start: Vectors, start_P: Vectors,
    dt: float, values: Vectors, density: Vectors, still: bool, resting: bool,
) -> None:  # fmt: skip
    """Take one scan: `values` (K, 6) with NaN where an IMU is missing."""
    members, heard = 0, 0
    for i in range(len(x)):
        step = track[i, WAITED] + dt
        member = track[i, STATUS] == MEMBER
        members += 1 if member else 0
        if not np.isfinite(values[i].sum()):
            track[i, WAITED] = step
            if track[i, STATUS] == PROBE:
                track[i, STATUS] = OUT
            continue
        heard += 1 if member else 0
        track[i, WAITED] = 0.0
        rate, force = values[i, :3].copy(), values[i, 3:].copy()
        if track[i, STATUS] == OUT:
            remember(memory[i], dt, rate, force, still, resting)
        else:
            noise = np.sqrt(own_share(track, i)) * density[i]
            step_local(
                x[i], R[i], P[i], memory[i], settings[i], arms[i], step, rate, force,
                noise[:3].copy(), noise[3:].copy(), still, resting,
            )  # fmt: skip
    fuse(x, R, P, track, offsets, x_f, R_f, P_f)
    changed = exclude(P, track, offsets, P_f, members, heard)
    if heard == 0:
        changed = _replace(x, R, P, track, x_f, R_f, P_f, settings, start, start_P, offsets)
    else:
        for i in range(len(x)):
            if track[i, STATUS] != MEMBER and track[i, WAITED] == 0.0 and not changed:
                changed = admit(
                    x, R, P, track, offsets, x_f, R_f, P_f, start, start_P, i, dt
                )  # fmt: skip
    if changed:
        share_out(track, P, settings, walks)
        recentre(track, offsets, x_f, R_f)
        fuse(x, R, P, track, offsets, x_f, R_f, P_f)


@compiled
def _replace(
    x: Vectors, R: Matrix, P: Matrix, track: Vectors, x_f: Vector, R_f: Matrix, P_f: Matrix,
    settings: Vectors, start: Vectors, start_P: Vectors, offsets: Vectors,
) -> bool:  # fmt: skip
    """Let those that are heard take the place of members that are not; say whether they do."""
    total = 0.0
    for i in range(len(track)):
        if track[i, STATUS] == MEMBER and track[i, WAITED] <= OUTAGE:
            return False
        if track[i, WAITED] == 0.0:
            total += track[i, NOMINAL]
    if total == 0.0:
        return False
    take_over(track, P_f, settings[0])
    for i in range(len(track)):
        offsets[i] = 0.0
        if track[i, WAITED] == 0.0:
            share = track[i, NOMINAL] / total
            seed(x[i], R[i], P[i], x_f, R_f, P_f, start[i], share * np.diag(start_P[i]))
            track[i, STATUS], track[i, SHARE] = MEMBER, 0.0
    return True
