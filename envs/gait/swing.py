"""The way of a foot through the air.

Both the way along the ground and the lift are polynomials of the phase of the swing, with zero velocity and
acceleration at either end, so that a foot leaves and lands without a jolt.
"""

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["lift", "minimum_jerk"]


def minimum_jerk(phase: ArrayLike) -> NDArray[np.float64]:
    """Go from 0 to 1 with zero velocity and acceleration at both ends.

    The quintic of Flash and Hogan (1985). Phases outside [0, 1] are held at the ends.

    >>> minimum_jerk([0.0, 0.5, 1.0])
    array([0. , 0.5, 1. ])
    """
    s = np.clip(np.asarray(phase, dtype=np.float64), 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s * s)


def lift(phase: ArrayLike, height: float) -> NDArray[np.float64]:
    """Rise from the ground to ``height`` m at half the swing and come down again, never below the ground.

    Zero velocity and acceleration at both ends: ``64 s³ (1 - s)³`` of the height.

    Args:
        phase: Phase of the swing, any shape; held at the ends outside [0, 1].
        height: Height at the middle of the swing in m.

    Raises:
        ValueError: If the height is negative or not finite.

    >>> lift([0.0, 0.5, 1.0], 0.015)
    array([0.   , 0.015, 0.   ])
    """
    if not (math.isfinite(height) and height >= 0):
        raise ValueError(f"'height' of the lift must not be negative, got {height} m.")
    s = np.clip(np.asarray(phase, dtype=np.float64), 0.0, 1.0)
    return height * 64.0 * (s * (1.0 - s)) ** 3
