"""How far gravity turned in the readings of an IMU."""

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.results import CalibrationRefused

MINIMUM_SPREAD = 0.01
"""Standard deviation of gravity along its least seen direction over gravity's size, dimensionless.

About half a degree. What an accelerometer's noise and a wobbling joint add to a plane motion lies below it: a
fit that took them for gravity turning would divide by them.
"""

_SEEN = (
    "Gravity was seen in one direction only",
    "Gravity was seen turning to and fro between two directions only",
    "Gravity was seen turning in a plane only",
)


def gravity_spread(centred: Floats, size: float) -> Floats:
    """Return by how much of its size gravity spreads along its principal axes, the widest first, shape (3,).

    Of gravity less its mean, (n, 3), in any unit, or the triangular factor of these; ``size`` is the root
    mean square of gravity's length times the root of the number of samples.
    """
    singular = np.linalg.svd(centred, compute_uv=False)
    spread = np.zeros(3)
    spread[: len(singular)] = singular / size if size > 0.0 else 0.0
    return spread


def check_gravity_spread(centred: Floats, size: float, minimum: float, sought: str, cure: str) -> None:
    """Raise CalibrationRefused if vectors of gravity do not spread in three dimensions.

    Vectors and size are those of :func:`gravity_spread`. They must spread by a minimum, as a share of
    gravity's size, along their least seen direction; the message names the unknown that is sought and the
    cure.
    """
    spread = gravity_spread(centred, size)
    rank = int(np.sum(spread >= minimum))
    if rank < 3:
        raise CalibrationRefused(
            f"{_SEEN[rank]} (beside that it spread by {100.0 * spread[rank]:.2g} % of its size, and "
            f"{100.0 * minimum:g} % are needed), so {sought} is not determined.",
            cure,
        )
