"""What really happened to N robots, for those who score calibrators."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.envs import RobotDrawing
from surefoot.envs.instrumentation.truth import CONTACT_FORCE, cop_in_sole

Floats = NDArray[np.float64]


def batch_truth(truth: Any, drawing: RobotDrawing) -> dict[str, NDArray[Any]]:
    """Return what really happened to N robots, for ``info``, as arrays of their own.

    Args:
        truth: What was read.
        drawing: The robot.

    Returns:
        ``force_cell`` (N, 4 F) N where all feet have an area, ``vgrf`` (N, F) N, ``cop_world`` (N, 2) m,
        ``cop_foot`` (N, F, 2) m, ``cop_valid`` (N, 1 + F), which of these there are (the others are 0),
        ``com`` (N, 3) m and ``wrench_sole`` (N, F, 6) N and N m.
    """
    wrench, R = truth.wrench_sole, truth.R_world_sole
    cells = {} if drawing.position_cell_sole is None else {"force_cell": truth.force_cell.copy()}
    vertical: Floats = np.einsum("nfi,nfi->nf", R[..., 2, :], wrench[..., :3])
    torque = np.einsum("nfij,nfj->nfi", R, wrench[..., 3:])
    place = truth.position_sole[..., :2] * vertical[..., None]
    moment = (place + np.stack([-torque[..., 1], torque[..., 0]], axis=-1)).sum(axis=1)
    load = vertical.sum(axis=1)
    loaded, pressed = load > CONTACT_FORCE, (wrench[..., 2] > CONTACT_FORCE) & _has_area(truth, drawing)
    return cells | {
        "vgrf": vertical,
        "cop_world": np.where(loaded[:, None], moment / np.where(loaded, load, 1.0)[:, None], 0.0),
        "cop_foot": np.where(pressed[..., None], cop_in_sole(wrench), 0.0),
        "cop_valid": np.column_stack([loaded, pressed]),
        "com": truth.com.copy(),
        "wrench_sole": wrench.copy(),
    }


def _has_area(truth: Any, drawing: RobotDrawing) -> NDArray[np.bool_]:
    """Return which feet have an area to press on, shape (F,)."""
    layout = getattr(truth, "layout", None)
    if layout is None:
        return np.ones(len(drawing.feet), dtype=bool)
    return np.array([not foot.flaw for foot in layout.feet])
