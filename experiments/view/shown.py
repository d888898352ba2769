"""One sample to draw: the feet, read in several ways."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration import METHODS
from surefoot.calibration.estimate import Estimate
from surefoot.calibration.setup import method_name

WAYS = ("true", "raw", "calibrated")
"""Ways to read the feet, drawn side by side. Each can be the feed of a controller."""


@dataclass(frozen=True, eq=False)
class Reading:
    """The feet at one sample, read in one way."""

    force: Floats  # channels in N, shape (K,)
    vgrf: Floats  # vertical force on each foot in N, shape (F,)
    cop_world: Floats  # in the world in m, below the true soles, shape (2,); NaN if undefined
    cop_covariance: Floats | None = None  # in the world's axes in m^2, shape (2, 2)


@dataclass(frozen=True, eq=False)
class Shown:
    """One sample to draw."""

    time: float  # since the start of the episode in s
    position_sole: Floats  # origins of the soles in the world in m, shape (F, 3)
    R_world_sole: Floats  # orientations of the soles, shape (F, 3, 3)
    readings: Mapping[str, Reading]  # by :data:`WAYS`; the truth may be missing
    flags: Any  # :class:`~surefoot.calibration.estimate.Flag` bits of each channel, shape (K,)

    @property
    def heading(self) -> Floats:
        """Mean forward direction of the soles on the ground, a unit vector of shape (2,)."""
        forward = self.R_world_sole[:, :2, 0].sum(axis=0)
        return np.asarray(forward / np.linalg.norm(forward))

    def cop_error(self, way: str) -> float:
        """Distance from the true centre of pressure in m, NaN if one of the two is undefined."""
        if "true" not in self.readings:
            return float("nan")
        return float(np.linalg.norm(self.readings[way].cop_world - self.readings["true"].cop_world))


def show_feet(
    time: float,
    position_sole: Floats,
    R_world_sole: Floats,
    raw: Estimate,
    calibrated: Estimate,
    true: Reading | None,
) -> Shown:
    """Combine two estimates, and the truth if it is known, for soles as in :class:`Shown`."""
    readings = {} if true is None else {"true": true}
    now = Shown(time, position_sole, R_world_sole, readings, np.array(calibrated.flags))
    readings |= {"raw": _place(now, raw), "calibrated": _place(now, calibrated)}
    return now


def _place(now: Shown, estimate: Estimate) -> Reading:
    """Place the centre of pressure of an estimate, in its level frame, below the true soles."""
    x, y = now.heading
    R_world_level = np.array([[x, -y], [y, x]])
    cop = now.position_sole[:, :2].mean(axis=0) + R_world_level @ np.asarray(estimate.cop, dtype=np.float64)
    covariance = estimate.cop_covariance
    return Reading(
        np.array(estimate.force, dtype=np.float64),
        np.array(estimate.vgrf, dtype=np.float64),
        cop if estimate.cop_valid else np.full(2, np.nan),
        None if covariance is None else R_world_level @ np.asarray(covariance) @ R_world_level.T,
    )


def check_method(name: Any) -> str:
    """Return the present name of a calibration method.

    Raises ValueError for an unknown name. Names come from a browser, so they must not import modules.
    """
    method = method_name(str(name))
    if method not in METHODS:
        raise ValueError(f"Method '{method}' does not exist. Available: {', '.join(map(repr, METHODS))}.")
    return method
