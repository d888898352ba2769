"""Centres of pressure of every foot and of all together, from loads and moments.

As :func:`surefoot.calibration.cop.cop_of_moments`, without its checks, and in plain floats: a control loop
divides at every sample, and three divisions are several times faster so.
"""

import numpy as np

from surefoot.calibration.arrays import Array


def centres(wrench: Array, moments: Array, known: bool, threshold: float) -> tuple[Array, Array]:
    """Return centres of pressure in m, shape (F + 1, 2), and whether they exist (bool), shape (F + 1,).

    Those of the feet are in their sole frames, of wrenches in N and N m, shape (F, 6); the one of all
    together comes last, in the level frame if that is known, of (Fz, Fz px, Fz py) of each foot there, shape
    (F, 3). Without more load than the threshold in N they are NaN.
    """
    parts = [[fz, -ty, tx] for _, _, fz, tx, ty, _ in wrench.tolist()]
    parts.append(moments.sum(axis=0).tolist())
    loaded = [fz > threshold for fz, _, _ in parts]
    loaded[-1] = loaded[-1] and known
    cop = [
        (x / fz, y / fz) if there else (np.nan, np.nan)
        for there, (fz, x, y) in zip(loaded, parts, strict=True)
    ]
    # Adding zero makes -0.0, which a negation leaves, the 0.0 of a sum.
    return np.array(cop) + 0.0, np.array(loaded)
