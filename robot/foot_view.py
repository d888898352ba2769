"""The observation of calibrated feet: its parts, their bounds, and when old values are held."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, FeetLayout
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.online import METHODS, method_entry
from surefoot.envs.observation import COP_BOUND, FORCE_BOUND

DEFAULT: Final = ("foot_force", "cop_foot", "cop", "cop_valid")
"""What is shown unless something else is asked for, of feet that have centres of pressure of their own."""

CERTAINTY: Final = ("foot_force_std", "cop_std")  # parts that only a method with a covariance has

DETERMINED: Final = ("contact_probability", "undetermined")
"""Parts of methods that estimate the probability of contact and the undetermined share of scales."""

RAW: Final = "foot_raw"
"""Counts of :class:`~surefoot.wrappers.FootSensors`. They are in the millions, and hidden by default."""

ALIGNED: Final = ("foot_force_aligned", "cop_foot_aligned", "cop_aligned")
"""Values of all channels at one common moment, ``FootCalibrator.aligned_lag`` samples ago."""

ALL, STD, ALL_ALIGNED, EACH = slice(0, 2), slice(2, 4), slice(4, 6), slice(6, None)
"""Slices of the parts of :attr:`FootView.held`. In ``EACH``, aligned values follow the others."""

PARTS: Final = (*DEFAULT, "foot_load", RAW, "wrench", "vgrf", *CERTAINTY, *DETERMINED, *ALIGNED, "foot_flags")
"""All parts that can be shown."""


def check_parts(parts: Sequence[str]) -> None:
    """Raise ValueError if a part does not exist, a name is repeated, or all parts are raw counts."""
    named = isinstance(parts, Iterable) and not isinstance(parts, str)
    if not named or not set(parts) <= set(PARTS) or len(set(parts)) != len(parts) or not set(parts) - {RAW}:
        raise ValueError(
            f"'show' must name parts of {PARTS}, each once, got {parts!r}; leave the wrapper out to show "
            "nothing calibrated."
        )


def flaw_of(layout: FeetLayout, flaw: str) -> str:
    """Return why the centres of pressure of single feet are undefined, by default ``flaw``."""
    blind = [foot.name for foot in layout.feet if np.linalg.matrix_rank(foot.wrench_map[2:5]) < 3]
    if blind and not flaw:
        return f"The channels of {blind} do not measure where on the foot forces act."
    return flaw


def default_parts(flaw: str) -> tuple[str, ...]:
    """Return the default parts, without ``"cop_foot"`` if there is a flaw."""
    return tuple(part for part in DEFAULT if not (flaw and part == "cop_foot"))


def drop_counts(observed: Mapping[str, Any], parts: Sequence[str]) -> dict[str, Any]:
    """Remove counts from the sensors' observation, or from its space, unless they are among the parts."""
    return {key: part for key, part in observed.items() if key != RAW or RAW in parts}


def check_certainty(parts: Sequence[str], method: str) -> None:
    """Raise ValueError if parts need a covariance, or a chance of contact, that a method does not report."""
    for needing, what, field in (
        (CERTAINTY, "covariance", "certain"),
        (DETERMINED, "chance of contact", "contact"),
    ):
        unknown = [part for part in parts if part in needing and not getattr(method_entry(method), field)]
        if unknown:
            do = tuple(name for name, entry in METHODS.items() if getattr(entry, field))
            raise ValueError(
                f"Method {method!r} reports no {what}, so that {unknown} cannot be shown; {do} do."
            )


class FootView:
    """Makes the feet's part of an observation from estimates, and holds the last valid centres of pressure.

    Parts are among :data:`PARTS`. The believed mass in kg sets the bounds. ``flaw`` is the reason why the
    centres of pressure of single feet are undefined, or "". On round feet, which roll, forces act at the
    lowest points.

    Attributes:
        spaces: The space of each part that is calibrated.
        every: The space of each part.
        flawed: Whether the centres of pressure of single feet are undefined.
        held: The last defined centres of pressure in m, shape (6 + 4 F,): that of all feet, its standard
            deviation, its aligned value, those of each foot, and their aligned values.
        rolls: Whether feet are round.
        force_bound: Largest force that is shown in N.
        weight: The robot's believed weight in N: the unit of ``"foot_load"``.

    Raises:
        ValueError: If a part does not exist, a name is repeated, or such feet do not have the part.
    """

    def __init__(
        self,
        parts: Sequence[str],
        layout: FeetLayout,
        mass: float,
        flaw: str = "",
        gravity: float = GRAVITY,
        rolls: bool = False,
    ) -> None:
        check_parts(parts)
        flaw = flaw_of(layout, flaw)
        if flaw and (lacking := sorted({"cop_foot", "cop_foot_aligned"} & set(parts))):
            raise ValueError(
                f"'{lacking[0]}' cannot be shown. {flaw} Show 'cop', that of all feet together, and 'vgrf' "
                "instead."
            )
        self.parts = tuple(part for part in parts if part != RAW)
        self.flawed, self.rolls = bool(flaw), rolls
        channels, feet = layout.channels, len(layout.feet)
        force = max(FORCE_BOUND, 5.0 * mass * gravity)
        self.force_bound, self.weight = force, mass * gravity
        box = spaces.Box
        self.every: dict[str, spaces.Space[Any]] = {
            "foot_force": box(-force, force, (channels,), np.float32),
            "foot_load": box(-force / self.weight, force / self.weight, (channels,), np.float32),
            "cop_foot": box(-COP_BOUND, COP_BOUND, (feet, 2), np.float32),
            "cop": box(-COP_BOUND, COP_BOUND, (2,), np.float32),
            "cop_valid": box(0.0, 1.0, (1 + feet,), np.float32),
            "wrench": box(-force, force, (feet, 6), np.float32),
            "vgrf": box(-force, force, (feet,), np.float32),
            "foot_force_std": box(0.0, force, (channels,), np.float32),
            "cop_std": box(0.0, COP_BOUND, (2,), np.float32),
            "foot_flags": box(0, np.iinfo(np.int32).max, (channels,), np.int32),
            "contact_probability": box(0.0, 1.0, (feet,), np.float32),
            "undetermined": box(0.0, 1.0, (channels,), np.float32),
            "foot_force_aligned": box(-force, force, (channels,), np.float32),
            "cop_foot_aligned": box(-COP_BOUND, COP_BOUND, (feet, 2), np.float32),
            "cop_aligned": box(-COP_BOUND, COP_BOUND, (2,), np.float32),
        }
        self.spaces = {part: self.every[part] for part in self.parts}
        # In one array, for the library: `sf_held`.
        self.held: Floats = np.zeros(6 + 4 * feet)
        self.begin_episode()

    def begin_episode(self) -> None:
        """Start with centres of pressure at the origin."""
        self.held[:] = 0.0
        self.held[STD] = COP_BOUND

    def show(self, estimate: Estimate, soles: Floats) -> dict[str, NDArray[Any]]:
        """Show one sample in fresh arrays by part, with the soles where they are now, shape (F, 4).

        Where a centre of pressure is not defined, the last one that was is held.
        """
        total, feet = np.asarray(estimate.cop_valid)[..., None], np.asarray(estimate.cop_foot_valid)
        valid = np.concatenate([total, feet & (not self.flawed)], axis=-1)
        self._hold(estimate, soles, valid)
        return {part: self._part(part, estimate, valid) for part in self.parts}

    def _hold(self, estimate: Estimate, soles: Floats, valid: NDArray[np.bool_]) -> None:
        """Take in the centres of pressure that are valid."""
        held, (fz, tx, ty) = self.held, np.moveaxis(estimate.wrench[..., 2:5], -1, 0)
        if self.rolls:
            fz, tx, ty = estimate.vgrf, np.zeros_like(tx), np.zeros_like(ty)
        x, y, u, v = np.moveaxis(soles, -1, 0)
        load = np.where(valid[..., 0], fz.sum(axis=-1), 1.0)
        moments = (x * fz - u * ty - v * tx).sum(axis=-1), (y * fz - v * ty + u * tx).sum(axis=-1)
        measured = np.stack(moments, axis=-1) / load[..., None]
        # The estimate has the same differences, in level axes that head nearly the same way. A method of the
        # user's may have neither.
        read = estimate.cop if estimate.cop_measured is None else estimate.cop_measured
        now = estimate.cop - read
        aligned = np.zeros(2) if estimate.cop_aligned is None else estimate.cop_aligned - read
        feet_aligned = estimate.cop_foot if estimate.cop_foot_aligned is None else estimate.cop_foot_aligned
        feet_aligned = np.ravel(feet_aligned)
        each = np.concatenate([np.ravel(estimate.cop_foot), feet_aligned])
        defined = np.concatenate([np.repeat(valid[1:], 2), np.isfinite(feet_aligned) & (not self.flawed)])
        for part, found, there in (
            (ALL, measured + now, valid[:1]),
            (ALL_ALIGNED, measured + aligned, valid[:1] & np.isfinite(aligned)),
            (EACH, each, defined),
        ):
            held[part] = np.where(there, np.clip(found, -COP_BOUND, COP_BOUND), held[part])
        if "cop_std" in self.parts and estimate.cop_covariance is not None:
            variance = np.diagonal(estimate.cop_covariance, axis1=-2, axis2=-1)
            std = np.minimum(np.sqrt(np.maximum(variance, 0.0)), COP_BOUND)
            held[STD] = np.where(valid[:1], std, held[STD])

    def _part(self, part: str, estimate: Estimate, valid: NDArray[np.bool_]) -> NDArray[Any]:
        held = self.held
        match part:
            case "cop_foot" | "cop_foot_aligned":
                own, aligned = np.split(held[EACH].astype(np.float32).reshape(-1, 2), 2)
                return own if part == "cop_foot" else aligned
            case "cop":
                return held[ALL].astype(np.float32)
            case "cop_aligned":
                return held[ALL_ALIGNED].astype(np.float32)
            case "cop_valid":
                return valid.astype(np.float32)
            case "cop_std":
                return held[STD].astype(np.float32)
            case "foot_flags":
                return np.array(estimate.flags, dtype=np.int32)
            case "contact_probability" | "undetermined":
                return np.array(getattr(estimate, part), dtype=np.float32)
            case "foot_load":
                return self._clip(estimate.force, self.weight)
            case "foot_force_aligned" if estimate.force_aligned is None:
                return self._clip(estimate.force, 1.0)
        return self._clip(getattr(estimate, part.removeprefix("foot_")), 1.0)

    def _clip(self, force: Any, unit: float) -> NDArray[np.float32]:
        bound = self.force_bound
        limited: NDArray[np.float32] = (np.minimum(np.maximum(force, -bound), bound) / unit).astype(
            np.float32
        )
        return limited
