"""One sample to draw: the feet, read in several ways."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from surefoot.arrays import Floats
from surefoot.calibration.estimate import Estimate

WAYS = ("true", "raw", "calibrated")
"""Ways in which the feet are read, side by side; each can be a controller's feed."""


@dataclass(frozen=True, eq=False)
class Reading:
    """One way to read the feet at one sample."""

    force: Floats  # channels in N, shape (K,)
    vgrf: Floats  # vertical force on each foot in N, shape (2,)
    cop_world: Floats  # in the world in m, placed under the true soles, shape (2,); NaN where there is none
    cop_covariance: Floats | None = None  # in the world's axes in m^2, shape (2, 2)


@dataclass(frozen=True, eq=False)
class Shown:
    """One sample to draw."""

    time: float  # since the episode start in s
    position_sole: Floats  # origins of the soles in the world in m, shape (2, 3)
    R_world_sole: Floats  # their axes, shape (2, 3, 3)
    readings: Mapping[str, Reading]  # by :data:`WAYS`; the truth may be missing
    flags: Any  # :class:`~surefoot.calibration.estimate.Flag` bits of each channel, shape (K,)

    @property
    def heading(self) -> Floats:
        """Mean forward direction of the soles on the ground, a unit vector, shape (2,)."""
        ahead = self.R_world_sole[:, :2, 0].sum(axis=0)
        return np.asarray(ahead / np.linalg.norm(ahead))

    def cop_error(self, way: str) -> float:
        """Distance between a centre of pressure and the true one in m; NaN where there is none."""
        if "true" not in self.readings:
            return float("nan")
        apart = self.readings[way].cop_world - self.readings["true"].cop_world
        return float(np.linalg.norm(apart))


NEED_NO_ROBOT = ("none", "tare")  # methods for feet alone
APART = 0.2  # m between the soles of feet alone, whose places are not known


def place_apart(feet: int) -> Floats:
    """Return places of soles in m side by side, shape (F, 3), for feet whose places are not known."""
    places = np.zeros((feet, 3))
    places[:, 1] = APART * (0.5 * (feet - 1) - np.arange(feet))
    return places


def show_feet(
    time: float,
    position_sole: Floats,
    R_world_sole: Floats,
    raw: Estimate,
    calibrated: Estimate,
    **true: Reading,
) -> Shown:
    """Return feet as two estimates and perhaps the truth have them, of soles as in :class:`Shown`."""
    readings = dict(true)
    now = Shown(time, position_sole, R_world_sole, readings, np.array(calibrated.flags))
    readings |= {"raw": _move_cop(now, raw), "calibrated": _move_cop(now, calibrated)}
    return now


def _move_cop(now: Shown, estimate: Estimate) -> Reading:
    """Return an estimate with its centre of pressure put under the true soles."""
    x, y = now.heading
    R_world_level = np.array([[x, -y], [y, x]])
    middle = now.position_sole[:, :2].mean(axis=0)
    where = middle + R_world_level @ np.asarray(estimate.cop, dtype=np.float64)
    covariance = estimate.cop_covariance
    return Reading(
        np.array(estimate.force, dtype=np.float64),
        np.array(estimate.vgrf, dtype=np.float64),
        where if estimate.cop_valid else np.full(2, np.nan),
        None if covariance is None else R_world_level @ np.asarray(covariance) @ R_world_level.T,
    )
