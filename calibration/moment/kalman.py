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
    """What came of one step; any leading batch dimensions ``...``; N unknowns.

    Attributes:
        mean: x, shape (..., N).
        covariance: S, shape (..., N, N).
        nis: Normalised innovation squared, e' (H S H' + R)^-1 e with the variances as they were used, shape
            (...).
        rows: How many rows held anything, shape (...).
    """

    mean: Array
    covariance: Array
    nis: Array
    rows: Array


def kalman_step(
    mean: Array,
    covariance: Array,
    H: Array,
    y: Array,
    variance: Array,
    learnt: Array,
    identity: Array,
    gate: float,
) -> KalmanStep:
    """Take in m rows at once.

    Args:
        mean: x, shape (..., N).
        covariance: S, shape (..., N, N).
        H: Rows, shape (..., m, N); a row of zeros with y = 0 holds nothing.
        y: Right-hand sides, shape (..., m).
        variance: R, positive, shape (..., m).
        learnt: 1 for unknowns to estimate and 0 for those to consider, shape (..., N).
        identity: Identity matrix, shape (N, N).
        gate: Standard deviations of an innovation beyond which a row is thought to be wrong.
    """
    e = y - (H @ mean[..., None])[..., 0]
    HS = H @ covariance
    V = HS @ H.mT
    predicted = np.linalg.diagonal(V)
    needed = e * e / gate**2 - predicted
    variance = np.where(needed > variance, needed, variance)
    V = V + variance[..., None] * _identity(identity, V)
    solved = np.linalg.solve(V, np.concatenate([HS, e[..., None]], axis=-1))
    nis = (e * solved[..., -1]).sum(axis=-1)
    gain = solved[..., :-1].mT * learnt[..., :, None]
    mean = mean + (gain @ e[..., None])[..., 0]
    keep = identity - gain @ H
    kept = keep @ covariance @ keep.mT
    covariance = kept + (gain * variance[..., None, :]) @ gain.mT
    covariance = 0.5 * (covariance + covariance.mT)
    rows = (predicted > 0.0).sum(axis=-1, dtype=np.float64)
    return KalmanStep(mean, covariance, nis, rows)


def _identity(identity: Array, like: Array) -> Array:
    rows = like.shape[-1]
    if rows <= identity.shape[0]:
        return identity[:rows, :rows]
    return np.eye(rows)
