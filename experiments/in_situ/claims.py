"""Claims of the simulated in-situ experiment, and their verdicts."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from surefoot.experiments.in_situ.study import InSituStudyResults
from surefoot.experiments.study.tables import Frame, plural

OURS = "measurement"  # the method that is to keep the limits


class Limit(NamedTuple):
    """A limit that every number has to keep."""

    name: str
    most: float
    values: NDArray[np.float64]  # one number a sensor, seed and set (or one in all)
    refused: int = 0  # numbers that are missing because a sound fit was refused
    printed: str = ""  # in the paper

    @property
    def share(self) -> float:
        """Share of the numbers that are within it; a refused fit is none of them."""
        count = len(self.values) + self.refused
        return float(np.sum(self.values <= self.most)) / count if count else float("nan")

    @property
    def met(self) -> bool:
        """Whether all numbers are within it."""
        return len(self.values) > 0 and self.share == 1.0


class Nees(NamedTuple):
    """The mean of squared errors by the fit's covariance, over their number, and where 95 % of means lie."""

    mean: float
    low: float
    high: float

    @property
    def inside(self) -> bool:
        """Whether the mean lies in the interval."""
        return self.low <= self.mean <= self.high


def consistency(part: Frame) -> Nees:
    """Return the mean of the normalised squared errors of some rows of ``white``."""
    nees = part["nees"].dropna()
    if nees.empty:
        return Nees(float("nan"), float("nan"), float("nan"))
    freedom = int(part["unknowns"].iloc[0]) * len(nees)
    low, high = chi2.ppf([0.025, 0.975], freedom) / freedom
    return Nees(float(nees.sum() / freedom), float(low), float(high))


def over_bound(part: Frame, quantity: str) -> float:
    """Return the rms error of rows of ``white`` over its bound: ``quantity`` is force, torque or limb."""
    there = part[np.isfinite(part[f"{quantity}_square"])]
    if there.empty:
        return float("nan")
    return float(np.sqrt(there[f"{quantity}_square"].sum() / there[f"{quantity}_bound"].sum()))


def limits_of(results: InSituStudyResults) -> tuple[Limit, ...]:
    """Compare the targets with the results."""
    fits = results.fits[results.fits["method"] == OURS]
    sets = results.sets[results.sets["method"] == OURS]
    # A sensor whose readings ended with the converter is refused rightly.
    refused = int(((fits["refusal"] != "") & ~fits["clipped"]).sum())
    # Each fit that was refused leaves its sets, of which those with a mass have a place, without a number.
    key = ["sensor", "seed", "method"]
    per_fit = int(results.sets.groupby(key).size().max())
    placed = int(results.sets[results.sets["place_error"].notna()].groupby(key).size().max())
    exact = results.exact[["offset", "matrix_force", "matrix_torque", "limb", "first_moment"]]
    still = [part for _, part in results.white[results.white["kind"] == "still"].groupby("sensor")]
    ratios = np.array([over_bound(part, one) for part in still for one in ("force", "torque")])
    # How far the mean is out of its interval, in half widths about its middle.
    known = [consistency(part) for part in still]
    weight = np.abs(fits["limb_error"].dropna().to_numpy())
    off = np.array([abs(2.0 * one.mean - one.low - one.high) / (one.high - one.low) for one in known])
    ratio, mass, position = (sets[name].dropna() for name in ("ratio", "mass_error", "place_error"))
    lost = refused * per_fit
    place = "its position, error in m along the worst axis (Table III)"
    half_widths = "covariance, NEES off the middle of its 95 % interval, in half widths"
    return (
        Limit("III-B and III-C without noise, relative error", 1e-9, exact.to_numpy().ravel()),
        Limit("longest / shortest semi-axis (Table I)", 1.03, ratio.to_numpy(), lost, "1.04 to 1.15"),
        Limit("added mass, error in kg (Table II)", 0.01, mass.to_numpy(), lost, "0.05"),
        Limit(place, 0.01, position.to_numpy(), refused * placed, "up to 0.11"),
        Limit("weight of the limb, relative error", 0.01, weight, refused, "about -0.38 (leg)"),
        Limit("offset, rmse over the Cramér-Rao bound", 1.3, ratios),
        Limit(half_widths, 1.0, off),
    )


def summary_findings(results: InSituStudyResults) -> Iterator[str]:
    """Say how many limits all seeds kept, and how many sensors reached the end of their converter."""
    limits = limits_of(results)
    met = sum(limit.met for limit in limits)
    yield f"{met} of {plural(len(limits), 'target')} were reached by every seed, sensor and set."
    clipped = results.fits[results.fits["clipped"]]
    if len(clipped):
        ours = clipped[clipped["method"] == OURS]
        sensors = len(results.fits) // results.fits["method"].nunique()
        yield (
            f"{len(ours)} of {plural(sensors, 'sensor')} reached the end of their converter; "
            f"{int((ours['refusal'] != '').sum())} of these were refused, as they must be."
        )
