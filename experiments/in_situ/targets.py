"""What the simulated in-situ experiment is to reach, and whether it did."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.study.tables import Frame

__all__ = ["Consistency", "Target", "consistency", "over_bound", "targets_of"]

OURS = "surefoot"
"""The method that is to reach the targets."""


class Target(NamedTuple):
    """Something to reach.

    Attributes:
        name: What is measured.
        most: What it may be at most.
        values: One number a sensor, seed and set (or one in all).
        refused: Numbers that are missing because a sound fit was refused.
        printed: What the paper printed for it.
    """

    name: str
    most: float
    values: NDArray[np.float64]
    refused: int = 0
    printed: str = ""

    @property
    def share(self) -> float:
        """Share of the numbers that are within it; a refused fit is none of them."""
        count = len(self.values) + self.refused
        return float(np.sum(self.values <= self.most)) / count if count else float("nan")

    @property
    def met(self) -> bool:
        """Whether all numbers are within it."""
        return len(self.values) > 0 and self.share == 1.0


class Consistency(NamedTuple):
    """Squared errors by the covariance claimed, over their number.

    Attributes:
        mean: Over the seeds; 1 for fits that know themselves.
        low: Of the interval that holds 95 % of such means.
        high: Its other end.
    """

    mean: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the mean lies in the interval."""
        return self.low <= self.mean <= self.high


def consistency(part: Frame) -> Consistency:
    """Average the normalised squared errors of some rows of ``white``."""
    nees = part["nees"].dropna()
    if nees.empty:
        return Consistency(float("nan"), float("nan"), float("nan"))
    freedom = int(part["unknowns"].iloc[0]) * len(nees)
    low, high = chi2.ppf([0.025, 0.975], freedom) / freedom
    return Consistency(float(nees.sum() / freedom), float(low), float(high))


def over_bound(part: Frame, what: str) -> float:
    """Divide the root mean square error of some rows of ``white`` by its bound.

    Args:
        part: The rows.
        what: "force" or "torque" of the offsets, or "limb" for its mass.
    """
    there = part[np.isfinite(part[f"{what}_square"])]
    if there.empty:
        return float("nan")
    return float(np.sqrt(there[f"{what}_square"].sum() / there[f"{what}_bound"].sum()))


def targets_of(results: InSituStudyResults) -> tuple[Target, ...]:
    """Hold what was found against what was to be reached."""
    fits = results.fits[results.fits["method"] == OURS]
    sets = results.sets[results.sets["method"] == OURS]
    # A sensor whose readings ended with the converter is refused rightly.
    refused = int(((fits["said"] != "") & ~fits["clipped"]).sum())
    # Each fit that was refused leaves its sets, of which those with a mass have a place, without a number.
    per_fit = int(results.sets.groupby(["sensor", "seed", "method"]).size().max())
    placed = int(
        results.sets[results.sets["place_error"].notna()].groupby(["sensor", "seed", "method"]).size().max()
    )
    errors = ["offset", "matrix_force", "matrix_torque", "limb", "first_moment"]
    still = results.white[results.white["kind"] == "still"]
    by_sensor = [part for _, part in still.groupby("sensor")]
    ratios = [over_bound(part, what) for part in by_sensor for what in ("force", "torque")]
    # How far the mean is out of its interval, in half widths about its middle.
    known = [consistency(part) for part in by_sensor]
    off = [abs(2.0 * one.mean - one.low - one.high) / (one.high - one.low) for one in known]
    return (
        Target(
            "III-B and III-C without noise, relative error", 1e-9, results.exact[errors].to_numpy().ravel()
        ),
        Target(
            "longest / shortest semi-axis (Table I)",
            1.03,
            sets["ratio"].to_numpy(),
            refused * per_fit,
            "1.04 to 1.15",
        ),
        Target(
            "added mass, error in kg (Table II)",
            0.01,
            sets["mass_error"].to_numpy(),
            refused * per_fit,
            "0.05",
        ),
        Target(
            "its position, error in m along the worst axis (Table III)",
            0.01,
            sets["place_error"].dropna().to_numpy(),
            refused * placed,
            "up to 0.11",
        ),
        Target(
            "weight of the limb, relative error",
            0.01,
            np.abs(fits["limb_error"].dropna().to_numpy()),
            refused,
            "about -0.38 (leg)",
        ),
        Target("offset, rmse over the Cramér-Rao bound", 1.3, np.array(ratios)),
        Target("covariance, NEES off the middle of its 95 % interval, in half widths", 1.0, np.array(off)),
    )
