"""Centres of pressure of every foot and of all together, from loads and moments.

As :func:`surefoot.calibration.cop.cop_of_moments`, without its checks, and for all feet in one go: a control
loop divides at every sample.
"""

import numpy as np

from surefoot.calibration.arrays import Array

_LEVER_MAP = np.zeros((6, 3))
_LEVER_MAP[[2, 4, 3], [0, 1, 2]] = 1.0, -1.0, 1.0
"""Takes a wrench to (f_z, -t_y, t_x)."""


def centres(wrench: Array, moments: Array, known: Array, threshold: float) -> tuple[Array, Array]:
    """Return centres of pressure: moments divided by loads.

    Args:
        wrench: Wrenches at and in the sole frames in N and N m, shape (..., F, 6).
        moments: (Fz, Fz px, Fz py) of each foot in the level frame in N and N m, shape (..., F, 3).
        known: Whether the level frame is known (bool), shape (...).
        threshold: Load in N at or below which there is no centre.

    Returns:
        Centres in m, shape (..., F + 1, 2): those of the feet in their sole frames, and the one of all
        together in the level frame last; and whether they exist (bool), shape (..., F + 1). Elsewhere they
        are NaN.
    """
    if moments.ndim == 2:
        return _of_one_robot(wrench, moments, bool(known), threshold)
    # One division for the centres of all soles and of all together, as (Fz, n_x, n_y).
    parts = np.concatenate([wrench @ _LEVER_MAP, sum_feet(moments)[..., None, :]], axis=-2)
    fz = parts[..., :1]
    loaded = fz > threshold
    loaded = np.concatenate([loaded[..., :-1, :], loaded[..., -1:, :] & known[..., None, None]], axis=-2)
    return np.where(loaded, parts[..., 1:] / np.where(loaded, fz, 1.0), np.nan), loaded[..., 0]


def _of_one_robot(wrench: Array, moments: Array, known: bool, threshold: float) -> tuple[Array, Array]:
    """Do the same in plain floats, which for three divisions is several times faster."""
    parts = [[fz, -ty, tx] for _, _, fz, tx, ty, _ in wrench.tolist()]
    parts.append(sum_feet(moments).tolist())
    loaded = [fz > threshold for fz, _, _ in parts]
    loaded[-1] = loaded[-1] and known
    cop = [
        (x / fz, y / fz) if there else (np.nan, np.nan)
        for there, (fz, x, y) in zip(loaded, parts, strict=True)
    ]
    # Adding zero makes -0.0, which a negation leaves, the 0.0 of a sum.
    return np.array(cop) + 0.0, np.array(loaded)


def sum_feet(values: Array) -> Array:
    """Sum over the feet's axis, the last but one: cheaper than ``sum`` for one or two."""
    return values[..., 0, :] if values.shape[-2] == 1 else values[..., 0, :] + values[..., 1, :]
