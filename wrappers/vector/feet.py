"""What is observed of the calibrated feet of N robots."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration import FeetLayout
from surefoot.calibration.cop import FORCE_THRESHOLD
from surefoot.calibration.estimate import Estimate
from surefoot.envs.observation import COP_BOUND
from surefoot.wrappers.foot_view import DEFAULT, MANY, FootView, check_parts, seen_below

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


class BatchFeet:
    """Makes the feet's part of observations, as :class:`~surefoot.wrappers.foot_view.FootView` for one robot.

    Args:
        count: Number of robots N.
        layout: The two feet and their channels.
        mass: Mass that a robot believes it has in kg, for the bounds and the unit of loads.
        flaw: Why the feet have no centres of pressure, or empty.
        show: Names among :data:`~surefoot.wrappers.foot_view.MANY`.

    Raises:
        ValueError: If a part does not exist, or is named twice.

    Attributes:
        show: As given.
        spaces: The space of each part for one robot.
        shown: What is observed now, each with the robots in front; arrays that later steps do not change.
        stepped: The same at the end of the last step, before the next episodes started.
    """

    def __init__(
        self, count: int, layout: FeetLayout, mass: float, flaw: str, show: Sequence[str] = DEFAULT
    ) -> None:
        check_parts(show, MANY)
        self.show = tuple(show)
        view = FootView(show, layout, mass, flaw)
        self.spaces: dict[str, spaces.Space[Any]] = view.spaces
        self._weight, self._bound = view.weight, view.force_bound
        self._flawed = bool(flaw)
        self._wrench_map = layout.wrench_map.reshape(-1, layout.channels).T
        self._cop: Floats = np.zeros((count, 2))
        self._cop_foot: Floats = np.zeros((count, 2, 2))
        self.shown: dict[str, NDArray[Any]] = {
            name: np.zeros((count, *(space.shape or ())), dtype=space.dtype)
            for name, space in self.spaces.items()
        }
        self.stepped = self.shown

    def begin_episode(self, mask: Mask) -> None:
        """Start some robots with centres of pressure at the origin, shape (N,)."""
        self._cop[mask] = 0.0
        self._cop_foot[mask] = 0.0

    def take(self, estimate: Estimate, place: Floats, heading: Floats) -> None:
        """Show one sample of all robots.

        Args:
            estimate: The calibrator's.
            place: Where the soles are in the level frames in m, shape (N, 2, 2).
            heading: Their headings, unit vectors, shape (N, 2, 2).
        """
        valid = np.concatenate([estimate.cop_valid[:, None], estimate.cop_foot_valid], axis=1)
        self._hold(valid, estimate.wrench, estimate.cop_foot, place, heading)
        self.shown = self.stepped = self._parts(estimate.force, valid)

    def apply(self, mask: Mask, force: Floats, place: Floats, heading: Floats) -> None:
        """Show the first readings of some robots.

        Args:
            mask: These robots, shape (N,).
            force: Calibrated channels of all robots in N, shape (N, K).
            place: As of :meth:`take`.
            heading: As of :meth:`take`.
        """
        wrench = (force @ self._wrench_map).reshape(len(force), 2, 6)
        fz = wrench[..., 2]
        down = fz > FORCE_THRESHOLD
        safe = np.where(down, fz, 1.0)[..., None]
        cop_foot = np.stack([-wrench[..., 4], wrench[..., 3]], axis=-1) / safe
        valid = np.concatenate([fz.sum(axis=1, keepdims=True) > FORCE_THRESHOLD, down], axis=1)
        self._hold(valid & mask[:, None], wrench, cop_foot, place, heading)
        first = self._parts(force, valid)
        self.shown = {
            name: np.where(mask.reshape(-1, *[1] * (part.ndim - 1)), part, self.shown[name])
            for name, part in first.items()
        }

    def last_of(self, robot: int) -> dict[str, NDArray[Any]]:
        """Return what one robot observed at the end of the last step, as arrays of its own."""
        return {name: part[robot].copy() for name, part in self.stepped.items()}

    def _hold(self, valid: Mask, wrench: Floats, cop_foot: Floats, place: Floats, heading: Floats) -> None:
        """Take in the centres of pressure that are valid, and hold the others."""
        if self._flawed:
            return
        self._cop_foot = np.where(valid[:, 1:, None], _bounded(cop_foot), self._cop_foot)
        fz, tx, ty = wrench[..., 2], wrench[..., 3], wrench[..., 4]
        u, v = heading[..., 0], heading[..., 1]
        x = place[..., 0] * fz - u * ty - v * tx
        y = place[..., 1] * fz - v * ty + u * tx
        defined = valid[:, :1]
        load = np.where(defined[:, 0], fz[:, 0] + fz[:, 1], 1.0)
        cop = np.stack([(x[:, 0] + x[:, 1]) / load, (y[:, 0] + y[:, 1]) / load], axis=1)
        self._cop = np.where(defined, _bounded(cop), self._cop)

    def _parts(self, force: Floats, valid: Mask) -> dict[str, NDArray[Any]]:
        limited = np.minimum(np.maximum(force, -self._bound), self._bound)
        every = {
            "foot_force": limited,
            "foot_load": limited / self._weight,
            "cop_foot": self._cop_foot,
            "cop": self._cop,
            "cop_valid": valid & False if self._flawed else valid,
        }
        return {part: every[part].astype(space.dtype) for part, space in self.spaces.items()}

    def around(self, observed: Mapping[str, Any], parts: Mapping[str, Any]) -> dict[str, Any]:
        """Put parts beside what the sensors show."""
        return {**seen_below(observed, self.show), **parts}


def _bounded(place: Floats) -> Floats:
    return np.minimum(np.maximum(place, -COP_BOUND), COP_BOUND)
