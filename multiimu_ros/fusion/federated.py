"""The federated Kalman filter of Carlson, one local filter per IMU and axis.

The common state is one number per axis (a rate or a specific force) that walks at random between
scans; IMU i sees it with noise R_i.  The information of the common prior and of the process noise
is shared out, so that nothing is counted twice:

    sum b_i = 1,   b_i = R_i^-1 / sum_j R_j^-1
    share    x_i = x_f,            P_i = P_f / b_i
    predict                        P_i = P_i + Q / b_i
    update   K = P_i / (P_i + R_i),  x_i += K (z_i - x_i),  P_i = (1 - K)^2 P_i + K^2 R_i
    master   P_f^-1 = sum P_i^-1,  x_f = P_f sum P_i^-1 x_i

This is [1]_ with fusion reset and no master of its own (b_m = 0).  The sources (thesis 8.26, TUM
2.3.3) print it without the factor P_f, count the prior (2 - b_m) times, do not share Q, and take
b_i from the reset P_i, a recursion that diverges within 50 steps when sensors differ; here b_i
comes from R_i alone.  With a fusion every scan the result is the centralised filter's for any
shares.  R is (noise density)^2 x rate and Q comes from the motion; print has them swapped.

.. [1] N. A. Carlson, "Federated square root filter for decentralized parallel processes", IEEE
   Trans. Aerosp. Electron. Syst. 26(3), 1990.
"""

import numpy as np

from multiimu_ros.arrays import Scalars, Vectors
from multiimu_ros.compiled import compiled


@compiled
def information_shares(R: Vectors) -> Vectors:
    """Return b (K, A), the share of each sensor in every axis; 0 where R (K, A) is infinite.

    An axis that no sensor sees has no shares: its column is 0.
    """
    b = 1.0 / R
    for axis in range(R.shape[1]):
        total = b[:, axis].sum()
        if total > 0.0:
            b[:, axis] /= total
    return b


@compiled
def federated_step(
    x: Scalars, P: Scalars, z: Vectors, R: Vectors, Q: Scalars, b: Vectors
) -> tuple[Scalars, Scalars]:
    """Share, predict, update every local filter, and fuse them: one scan.

    Parameters
    ----------
    x, P : (A,) arrays
        Fused state and variance per axis; P infinite where nothing is known yet.
    z, R, b : (K, A) arrays
        Measurements, their variances (infinite: none), and information shares that sum to 1.
    Q : (A,) array
        Variance that the common state gains between scans.

    Returns
    -------
    x_f, P_f : (A,) arrays
        The fused state and its variance; an axis that no sensor saw is only predicted.
    """
    x_f, P_f = np.empty_like(x), np.empty_like(P)
    for axis in range(len(x)):
        information, weighted = 0.0, 0.0
        for i in range(len(z)):
            if b[i, axis] == 0.0:
                continue
            P_i = (P[axis] + Q[axis]) / b[i, axis]
            if np.isinf(P_i):  # no prior: the first measurement is the estimate
                x_i, P_i = z[i, axis], R[i, axis]
            else:
                K = P_i / (P_i + R[i, axis])
                x_i = x[axis] + K * (z[i, axis] - x[axis])
                P_i = (1.0 - K) ** 2 * P_i + K**2 * R[i, axis]
            information += 1.0 / P_i
            weighted += x_i / P_i
        if information > 0.0:
            P_f[axis], x_f[axis] = 1.0 / information, weighted / information
        else:
            P_f[axis], x_f[axis] = P[axis] + Q[axis], x[axis]
    return x_f, P_f
