"""The controller that does nothing."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.controllers.stabiliser import ACTION_SIZE

__all__ = ["zero_action"]


def zero_action(observation: Mapping[str, Any]) -> NDArray[np.float32]:
    """Leave the pattern alone, whatever is observed: the open-loop walker.

    Args:
        observation: Not looked at.

    Returns:
        Zeros, shape (11,).
    """
    return np.zeros(ACTION_SIZE, dtype=np.float32)
