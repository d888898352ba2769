"""How far the direction of gravity varied in the readings of an IMU."""

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.results import CalibrationRefused

MINIMUM_SPREAD = 0.01
"""Standard deviation of gravity along its least excited direction, over the magnitude of gravity.

This is about half a degree. The noise of an accelerometer and a wobbling joint add less than this to a planar
motion. A fit that used them as excitation would divide by noise.
"""

_SEEN = (
    "Gravity was seen in one direction only",
    "Gravity was seen turning to and fro between two directions only",
    "Gravity was seen turning in a plane only",
)


def gravity_spread(centred: Floats, size: float) -> Floats:
    """Return the standard deviations of gravity along its principal axes over its magnitude, shape (3,).

    Args:
        centred: Gravity minus its mean, shape (n, 3), in any unit, or the triangular factor of it.
        size: Root mean square of the magnitude of gravity times the square root of the number of samples.
    """
    singular = np.linalg.svd(centred, compute_uv=False)
    spread = np.zeros(3)
    spread[: len(singular)] = singular / size if size > 0.0 else 0.0
    return spread


def check_gravity_spread(centred: Floats, size: float, minimum: float, sought: str, cure: str) -> None:
    """Raise CalibrationRefused unless gravity varied in three dimensions.

    The first two arguments are those of :func:`gravity_spread`. The spread along each direction must be at
    least ``minimum``. The message names the unknown that is ``sought`` and the cure.
    """
    spread = gravity_spread(centred, size)
    rank = int(np.sum(spread >= minimum))
    if rank < 3:
        raise CalibrationRefused(
            f"{_SEEN[rank]} (beside that it spread by {100.0 * spread[rank]:.2g} % of its size, and "
            f"{100.0 * minimum:g} % are needed), so {sought} is not determined.",
            cure,
        )
