"""What a robot takes with it from episode to episode."""

from typing import Any, NamedTuple

import numpy as np

from surefoot.calibration import FootCalibrator, Parameters
from surefoot.wrappers.nominal import Masses, NominalModel


class Learnt(NamedTuple):
    """What a robot takes with it from episode to episode.

    Attributes:
        state: State of the calibrator.
        initial: The map that it began from.
        masses: What the robot believes of its bodies.
    """

    state: Any
    initial: Parameters
    masses: Masses

    @classmethod
    def of(cls, calibrator: FootCalibrator, model: NominalModel) -> "Learnt":
        """Gather it."""
        initial = Parameters(*(np.asarray(part, dtype=np.float64) for part in calibrator.setup.initial))
        return cls(calibrator.state, initial, model.masses)
