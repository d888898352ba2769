"""What really happened to N robots, for those who score calibrators."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.envs import RobotDrawing
from surefoot.envs.instrumentation.truth import CONTACT_FORCE, QUANTITIES, cop_in_sole

Floats = NDArray[np.float64]


class BatchTruth(Mapping[str, Floats]):
    """What really happened to N robots, for ``info``; worked out when it is read, NaN where undefined.

    Holds ``force_cell`` (N, 4 F) N, ``vgrf`` (N, F) N, ``cop_world`` (N, 2) m, ``cop_foot`` (N, F, 2) m,
    ``com`` (N, 3) m and ``wrench_sole`` (N, F, 6) N and N m.

    Args:
        truth: What was read.
        drawing: The robot.
    """

    def __init__(self, truth: Any, drawing: RobotDrawing) -> None:
        self._truth, self._drawing = truth, drawing

    def __getitem__(self, name: str) -> Floats:
        truth = self._truth
        if name not in QUANTITIES:
            raise KeyError(name)
        if name == "force_cell":
            flawed = self._drawing.position_cell_sole is None
            feet = truth.wrench_sole.shape[:2]
            return np.full((feet[0], 4 * feet[1]), np.nan) if flawed else truth.force_cell.copy()
        if name in ("com", "wrench_sole"):
            own: Floats = getattr(truth, name).copy()
            return own
        wrench, R = truth.wrench_sole, truth.R_world_sole
        vertical: Floats = np.einsum("nfi,nfi->nf", R[..., 2, :], wrench[..., :3])
        if name == "vgrf":
            return vertical
        if name == "cop_foot":
            return np.where(self._has_area[:, None], cop_in_sole(wrench), np.nan)
        torque = np.einsum("nfij,nfj->nfi", R, wrench[..., 3:])
        place = truth.position_sole[..., :2] * vertical[..., None]
        moment = place + np.stack([-torque[..., 1], torque[..., 0]], axis=-1)
        load = vertical.sum(axis=1)
        cop: Floats = moment.sum(axis=1) / np.where(load > CONTACT_FORCE, load, np.nan)[:, None]
        return cop

    @property
    def _has_area(self) -> NDArray[np.bool_]:
        """Which feet have an area to press on, shape (F,)."""
        layout = getattr(self._truth, "layout", None)
        if layout is None:
            return np.ones(len(self._drawing.feet), dtype=bool)
        return np.array([not foot.flaw for foot in layout.feet])

    def __iter__(self) -> Iterator[str]:
        return iter(QUANTITIES)

    def __len__(self) -> int:
        return len(QUANTITIES)
