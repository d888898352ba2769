"""A plan of which postures and masses to calibrate with."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["ExcitationPlan", "PlannedPose"]

Matrix = NDArray[np.float64]


class PlannedPose(NamedTuple):
    """One reading to take.

    Attributes:
        orientation: Index of the orientation.
        mass: Index of the mass.
        gain: What it adds to what those before it tell of the goal, in nats.
    """

    orientation: int
    mass: int
    gain: float


@dataclass(frozen=True, eq=False)
class ExcitationPlan:
    """What to read, and what that will tell.

    Attributes:
        poses: In the order of choice, a block with one mass after the other.
        mass_gain: What the best block with each mass would tell of the goal to begin with, in nats, (M,).
        pose_gain: What each single reading would tell then, in nats, shape (N, M).
        before: Covariance of (D, m, m c) before, shape (40, 40).
        after: And after all poses.
        total: What all poses tell of the goal together, in nats.
    """

    poses: tuple[PlannedPose, ...]
    mass_gain: NDArray[np.float64]
    pose_gain: Matrix
    before: Matrix
    after: Matrix
    total: float

    @property
    def ranked_masses(self) -> NDArray[np.intp]:
        """Indices of the masses, the most telling block first, shape (M,)."""
        return np.argsort(-self.mass_gain, kind="stable")

    @property
    def ranked_poses(self) -> NDArray[np.intp]:
        """Pairs (orientation, mass), the most telling single reading first, shape (N M, 2)."""
        order = np.argsort(-self.pose_gain, axis=None, kind="stable")
        return np.stack(np.unravel_index(order, self.pose_gain.shape), axis=1)
