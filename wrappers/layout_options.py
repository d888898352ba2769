"""What calibrators are told of a kind of foot, unless a user says otherwise."""

import numpy as np

from surefoot.calibration import FeetLayout
from surefoot.envs import RobotDrawing

USUAL_LENGTH = 0.2
"""Length in m of a foot that has none, such as a sphere: errors of moments are stated in its terms."""


NO_LEAP = 1e3
"""Change of a reading in body weights that no sample reaches."""


def layout_options(layout: FeetLayout, drawing: RobotDrawing, method: str) -> dict[str, float]:
    """Make the options of a calibrator that follow from what is under the feet.

    A foot whose channels have no places of their own gets a length. A six-axis sensor's words come together:
    one axis that leaps away alone is no broken word but a landing, and is not held.

    Args:
        layout: The feet and their channels.
        drawing: The robot.
        method: The calibrator.
    """
    options: dict[str, float] = {}
    if method == "moment" and all(sensor.six_axis for foot in layout.feet for sensor in foot.sensors):
        options["leap"] = NO_LEAP
    if all(foot.position_cell_sole is not None for foot in layout.feet):
        return options
    places = drawing.position_cell_sole
    length = USUAL_LENGTH if places is None else float(np.ptp(places[..., 0], axis=1).max())
    return options | {"foot_length": length}
