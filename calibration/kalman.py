r"""One step of a Kalman filter with rows that may be wrong and unknowns that are only considered.

With the prior x, S and rows y = H x + e, e of variances R,

    K = S H' (H S H' + R)^-1,    x <- x + K (y - H x),    S <- (1 - K H) S (1 - K H)' + K R K'.

The second form is Joseph's: it holds for any gain K, also for one with rows set to zero for unknowns that are
considered and not estimated (Schmidt, 1966), and stays positive in float32, which the C library may use. A
row whose innovation exceeds ``gate`` standard deviations has its variance raised until it does not: it pulls
no harder than one at the gate, and less the further it is out.
"""

from typing import NamedTuple

import numpy as np

from surefoot.calibration.arrays import Array


class KalmanStep(NamedTuple):
    """The result of one step; N unknowns.

    Attributes:
        mean: x, shape (N,).
        covariance: S, shape (N, N).
        nis: Normalised innovation squared, e' (H S H' + R)^-1 e with the variances as they were used.
        rows: How many rows held anything.
    """

    mean: Array
    covariance: Array
    nis: float
    rows: float


def kalman_step(
    mean: Array, covariance: Array, H: Array, y: Array, variance: Array, learnt: Array, gate: float
) -> KalmanStep:
    """Take in m rows at once.

    Args:
        mean: x, shape (N,).
        covariance: S, shape (N, N).
        H: Rows, shape (m, N); a row of zeros with y = 0 holds nothing.
        y: Right-hand sides, shape (m,).
        variance: R, positive, shape (m,).
        learnt: 1 for unknowns to estimate and 0 for those to consider, shape (N,).
        gate: Standard deviations of an innovation beyond which a row is thought to be wrong.
    """
    e = y - H @ mean
    HS = H @ covariance
    V = HS @ H.T
    predicted = np.diagonal(V)
    R = np.maximum(variance, e * e / gate**2 - predicted)
    V = V + np.diag(R)
    solved = np.linalg.solve(V, np.column_stack([HS, e]))
    K = learnt[:, None] * solved[:, :-1].T
    keep = np.eye(len(mean), dtype=mean.dtype) - K @ H
    joseph = keep @ covariance @ keep.T + (K * R) @ K.T
    return KalmanStep(
        mean=mean + K @ e,
        covariance=0.5 * (joseph + joseph.T),
        nis=float(e @ solved[:, -1]),
        rows=float((predicted > 0.0).sum()),
    )
