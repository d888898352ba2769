r"""Shear: a cell reads a share of the horizontal forces on it.

A bar is stiff across its axis, but gauges that sit off its middle, and a load that does not hang on its axis,
let horizontal forces into the bridge,

.. math:: y = F_z + k_x F_x + k_y F_y,

with shares :math:`k` that are constant from power-up, each cell its own. No map of counts can undo it: under
a walking robot it looks like a change of the offset that comes with every step.
"""

from surefoot.arrays import Floats
from surefoot.sensors.configuration import check_not_negative
from surefoot.sensors.corruption import Corruption, Rng
from surefoot.sensors.randomness import normal

AXES = 3  # forces on a cell along the sole's z, x and y, in this order


def shear(std: float) -> Corruption[Floats]:
    """Read cells that feel three forces, shape (..., 3 K): all vertical ones first, then along x, then y.

    The state are the shares k of x and y, shape (2, K), newtons reported per newton, with a standard
    deviation.

    >>> import numpy as np
    >>> cell, rng = shear(0.0), np.random.default_rng(0)
    >>> cell.apply(np.array([5.0, 6.0, 1.0, 1.0, 2.0, 2.0]), cell.init((2,), rng), rng, 0.0125)[0]
    array([5., 6.])
    """
    check_not_negative(std=std)

    def init(shape: tuple[int, ...], rng: Rng) -> Floats:
        share: Floats = std * normal(rng, (AXES - 1, *shape))
        return share

    def apply(reading: Floats, state: Floats, rng: Rng, dt: float) -> tuple[Floats, Floats]:
        return mix(reading, state), state

    return Corruption(init, apply)


def mix(load: Floats, share: Floats) -> Floats:
    """Return the forces, shape (..., K), that cells of the shares k, (2, K), take for vertical ones."""
    K = share.shape[-1]
    found: Floats = load[..., :K] + share[0] * load[..., K : 2 * K] + share[1] * load[..., 2 * K :]
    return found
