"""What an agent is shown of calibrated feet: which parts, in which bounds, and what is held when."""

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY, FeetLayout
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.online import METHODS, method_entry
from surefoot.envs.observation import COP_BOUND, FORCE_BOUND
from surefoot.wrappers.beliefs import SolePose

DEFAULT: Final = ("foot_force", "cop_foot", "cop", "cop_valid")
"""What is shown unless something else is asked for."""

CERTAINTY: Final = ("foot_force_std", "cop_std")
"""Parts that only a method with a covariance has."""

RAW: Final = "foot_raw"
"""Counts, which :class:`~surefoot.wrappers.FootSensors` shows: millions, hidden unless they are asked for."""

MANY: Final = (*DEFAULT, "foot_load", RAW)
"""All that can be shown of many robots at once."""

PARTS: Final = (*MANY, "wrench", "vgrf", *CERTAINTY, "foot_flags")
"""All that can be shown."""


def check_parts(parts: Sequence[str], known: Sequence[str] = PARTS) -> None:
    """Raise ValueError if a part does not exist, is named twice, or there is none of calibrated feet."""
    unknown = [part for part in parts if part not in known]
    if isinstance(parts, str) or unknown or len(set(parts)) != len(parts) or not set(parts) - {RAW}:
        raise ValueError(
            f"'show' must name parts of {known}, each once, got {parts!r}; leave the wrapper out to show "
            "nothing calibrated."
        )


def seen_below(observed: Mapping[str, Any], parts: Sequence[str]) -> dict[str, Any]:
    """Return what stays of the sensors' observation, or of its space: without counts nobody asks for."""
    return {key: part for key, part in observed.items() if key != RAW or RAW in parts}


def check_certainty(parts: Sequence[str], method: str) -> None:
    """Raise ValueError if parts need a covariance that a method does not report."""
    unknown = [part for part in parts if part in CERTAINTY and not method_entry(method).certain]
    if unknown:
        do = tuple(name for name, entry in METHODS.items() if entry.certain)
        raise ValueError(
            f"Method {method!r} reports no covariance, so that {unknown} cannot be shown; {do} do."
        )


class FootView:
    """Makes the feet's part of an observation of estimates, and holds the last valid centres of pressure.

    Args:
        parts: Names among :data:`PARTS`.
        layout: The feet and their channels.
        mass: Mass that the robot believes it has in kg, for the bounds.
        flaw: Why the feet have no centres of pressure, or empty.

    Attributes:
        spaces: The space of each part that is calibrated.
        every: The space of each part that there could be.
        flawed: Whether the feet have no centres of pressure.
        held: The last ones that were defined, of each foot and of both, and its deviation in m, shape (8,).
        force_bound: Largest force that is shown in N.
        weight: What the robot believes to weigh in N: the unit of ``"foot_load"``.

    Raises:
        ValueError: If a part does not exist, or is named twice.
    """

    def __init__(self, parts: Sequence[str], layout: FeetLayout, mass: float, flaw: str = "") -> None:
        check_parts(parts)
        self.parts = tuple(part for part in parts if part != RAW)
        self.flawed = bool(flaw)
        channels, feet = layout.channels, len(layout.feet)
        force = max(FORCE_BOUND, 5.0 * mass * GRAVITY)
        self.force_bound, self.weight = force, mass * GRAVITY
        box = spaces.Box
        self.every: dict[str, spaces.Space[Any]] = {
            "foot_force": box(-force, force, (channels,), np.float32),
            "foot_load": box(-force / self.weight, force / self.weight, (channels,), np.float32),
            "cop_foot": box(-COP_BOUND, COP_BOUND, (feet, 2), np.float32),
            "cop": box(-COP_BOUND, COP_BOUND, (2,), np.float32),
            "cop_valid": spaces.MultiBinary(1 + feet),
            "wrench": box(-force, force, (feet, 6), np.float32),
            "vgrf": box(-force, force, (feet,), np.float32),
            "foot_force_std": box(0.0, force, (channels,), np.float32),
            "cop_std": box(0.0, COP_BOUND, (2,), np.float32),
            "foot_flags": box(0, np.iinfo(np.int32).max, (channels,), np.int32),
        }
        self.spaces = {part: self.every[part] for part in self.parts}
        # In one array, of which the others are parts, for the library.
        self.held = np.zeros(8)
        self.begin_episode()

    def __setstate__(self, kept: dict[str, Any]) -> None:
        # In a copy what were parts are arrays of their own.
        self.__dict__.update(kept)
        self._split()

    def _split(self) -> None:
        self._cop_foot, self._cop, self._cop_std = self.held[:4].reshape(2, 2), self.held[4:6], self.held[6:]

    def begin_episode(self) -> None:
        """Start with centres of pressure at the origin."""
        self.held[:6], self.held[6:] = 0.0, COP_BOUND
        self._split()

    def show(self, estimate: Estimate, soles: tuple[SolePose, SolePose]) -> dict[str, NDArray[Any]]:
        """Show one sample.

        Args:
            estimate: The calibrator's.
            soles: Where the soles are now in the level frame.

        Returns:
            Fresh arrays by part. Where a centre of pressure is not defined, the last one that was is held.
        """
        wrench, cop_foot = estimate.wrench.tolist(), estimate.cop_foot.tolist()
        valid = [bool(estimate.cop_valid), *estimate.cop_foot_valid.tolist()]
        if self.flawed:
            valid = [False] * len(valid)
        for foot in (0, 1):
            if valid[1 + foot]:
                self._cop_foot[foot] = [_bounded(part) for part in cop_foot[foot]]
        if valid[0]:
            load = x = y = 0.0
            for sole, (_, _, fz, tx, ty, _) in zip(soles, wrench, strict=True):
                u, v = sole.forward_x, sole.forward_y
                load += fz
                x += sole.x * fz - u * ty - v * tx
                y += sole.y * fz - v * ty + u * tx
            self._cop[:] = _bounded(x / load), _bounded(y / load)
            if "cop_std" in self.parts and estimate.cop_covariance is not None:
                variance = np.diagonal(estimate.cop_covariance).tolist()
                self._cop_std[:] = [min(sqrt(max(part, 0.0)), COP_BOUND) for part in variance]
        return {part: self._part(part, estimate, valid) for part in self.parts}

    def _part(self, part: str, estimate: Estimate, valid: list[bool]) -> NDArray[Any]:
        match part:
            case "cop_foot":
                return np.array(self._cop_foot, dtype=np.float32)
            case "cop":
                return np.array(self._cop, dtype=np.float32)
            case "cop_valid":
                return np.array(valid, dtype=np.int8)
            case "cop_std":
                return np.array(self._cop_std, dtype=np.float32)
            case "foot_flags":
                return np.array(estimate.flags, dtype=np.int32)
            case "foot_load":
                return self._limited(estimate.force, self.weight)
        return self._limited(getattr(estimate, part.removeprefix("foot_")), 1.0)

    def _limited(self, force: Any, unit: float) -> NDArray[np.float32]:
        bound = self.force_bound
        limited: NDArray[np.float32] = (np.minimum(np.maximum(force, -bound), bound) / unit).astype(
            np.float32
        )
        return limited


def _bounded(place: float) -> float:
    return min(max(place, -COP_BOUND), COP_BOUND)
