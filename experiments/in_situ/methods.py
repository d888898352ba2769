"""The ways to calibrate a six-axis sensor in situ that are held against each other."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.imu import savitzky_golay
from surefoot.calibration.in_situ import (
    InSituFit,
    InSituOptions,
    InSituSet,
    Limb,
    calibrate_in_situ,
    estimate_matrix,
    estimate_offset,
)
from surefoot.experiments.force_torque.score import offset_of_set

__all__ = ["FITTED", "METHODS", "MethodResult", "calibrate_by_all", "filtered", "paper_calibration"]

FITTED = 4
"""Sets that are fitted, the first ones; the others validate (in-situ paper, IV)."""

METHODS = {
    "surefoot": "surefoot",
    "no-loop": "surefoot without hysteresis",
    "paper": "paper (III-B, III-C)",
    "manufacturer": "manufacturer's matrix",
}
"""What is compared, and what tables call it."""

FILTER = 3.0
"""Length of the paper's filter in s: 301 samples at 100 Hz."""


@dataclass(frozen=True, eq=False)
class MethodResult:
    """What a method made of a sensor's sets.

    Attributes:
        matrix: C in N and N m per count, shape (6, 6).
        offsets: o of every set in counts, shape (J, 6).
        limb: The body beyond the sensor.
    """

    matrix: NDArray[np.float64]
    offsets: NDArray[np.float64]
    limb: Limb


def calibrate_by_all(
    sets: Sequence[InSituSet], nominal: NDArray[np.float64], options: InSituOptions
) -> dict[str, MethodResult | str]:
    """Calibrate by every method, or say why one refused.

    Args:
        sets: The first :data:`FITTED` are fitted, the others get an offset each.
        nominal: The maker's matrix, shape (6, 6).
        options: Of the measurement-space fit.

    Returns:
        A calibration, or what was said in its place, by the names of :data:`METHODS`.
    """
    found: dict[str, MethodResult | str] = {}
    for name, loops in (("surefoot", True), ("no-loop", False)):
        fit = calibrate_in_situ(sets[:FITTED], options=replace(options, hysteresis=loops), refuse=False)
        found[name] = str(fit.refusals[0]) if fit.refusals else of_fit(fit, sets)
    try:
        paper = paper_calibration(sets)
    except ValueError as refusal:
        found["paper"] = found["manufacturer"] = str(refusal)
        return found
    found["paper"] = paper
    # The paper weighs with the maker's matrix as well, and takes off the limb that its own method found.
    found["manufacturer"] = replace(paper, matrix=nominal)
    return found


def of_fit(fit: InSituFit, sets: Sequence[InSituSet]) -> MethodResult:
    """Add the offsets of the sets that were not fitted; what hangs there is not looked up."""
    others = [
        offset_of_set(data.raw, data.gravity, fit.response, fit.noise) for data in sets[len(fit.offsets) :]
    ]
    return MethodResult(fit.matrix, np.array([*fit.offsets, *others]), fit.limb)


def paper_calibration(sets: Sequence[InSituSet]) -> MethodResult:
    """Calibrate as the paper does: filter, offset of each set (III-B), matrix from the first four (III-C).

    Args:
        sets: At rest, or slow.

    Raises:
        CalibrationRefused: If the rank of Eq. 21 is short.
    """
    smooth = [filtered(data) for data in sets]
    offsets = np.array([estimate_offset(data.raw, data.gravity).offset for data in smooth])
    fit = estimate_matrix(smooth[:FITTED], offsets[:FITTED], noise_margin=0.0)
    return MethodResult(fit.matrix, offsets, fit.limb)


def filtered(data: InSituSet) -> InSituSet:
    """Filter counts and gravity as the paper does, by cubics over 3 s."""
    assert data.time is not None
    window = 2 * round(FILTER / float(data.time[1] - data.time[0]) / 2.0) + 1
    return replace(data, raw=savitzky_golay(data.raw, window), gravity=savitzky_golay(data.gravity, window))
