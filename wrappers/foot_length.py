"""How long a foot is, which calibrators are told where its channels have no places of their own."""

import numpy as np

from surefoot.calibration import FeetLayout
from surefoot.envs import RobotDrawing

USUAL_LENGTH = 0.2
"""Length in m of a foot that has none, such as a sphere: errors of moments are stated in its terms."""


def foot_length(layout: FeetLayout, drawing: RobotDrawing) -> dict[str, float]:
    """Make the option of a calibrator that tells the length of a foot in m.

    Returns:
        Nothing if all channels have places, which tell it.
    """
    if all(foot.position_cell_sole is not None for foot in layout.feet):
        return {}
    places = drawing.position_cell_sole
    return {"foot_length": USUAL_LENGTH if places is None else float(np.ptp(places[..., 0], axis=1).max())}
