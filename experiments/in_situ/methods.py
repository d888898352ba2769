"""The ways to calibrate a six-axis sensor in situ that are compared, and their scores."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surefoot.arrays import Floats
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
from surefoot.experiments.force_torque.validation import added_mass, force_ellipsoid, offset_of_set
from surefoot.experiments.in_situ.instruments import SensorTruth

FITTED = 4  # sets that are fitted, the first ones; the others validate (in-situ paper, IV)

METHODS = {
    "measurement": "measurement-space fit",
    "no-loop": "the same without hysteresis",
    "paper": "paper (III-B, III-C)",
    "manufacturer": "manufacturer's matrix",
}
"""Methods and their names in tables."""

FILTER = 3.0  # length of the paper's filter in s: 301 samples at 100 Hz
FORCE, TORQUE = slice(0, 3), slice(3, 6)  # parts of a wrench


@dataclass(frozen=True, eq=False)
class MethodResult:
    """A method's result from a sensor's sets."""

    matrix: Floats  # C in N and N m per count, shape (6, 6)
    offsets: Floats  # o of every set in counts, shape (J, 6)
    limb: Limb  # beyond the sensor


def calibrate_by_all(
    sets: Sequence[InSituSet], nominal: Floats, options: InSituOptions
) -> dict[str, MethodResult | str]:
    """Calibrate the first :data:`FITTED` sets by every method, or say why not; others get offsets."""
    found: dict[str, MethodResult | str] = {}
    for name, loops in (("measurement", True), ("no-loop", False)):
        fit = calibrate_in_situ(sets[:FITTED], options=replace(options, hysteresis=loops), refuse=False)
        found[name] = add_offsets(fit, sets)
    try:
        paper = paper_calibration(sets)
    except ValueError as refusal:
        return found | dict.fromkeys(("paper", "manufacturer"), str(refusal))
    # The paper weighs with the maker's matrix as well, and takes off the limb that its own method found.
    return found | {"paper": paper, "manufacturer": replace(paper, matrix=nominal)}


def add_offsets(fit: InSituFit, sets: Sequence[InSituSet]) -> MethodResult | str:
    """Return a fit with offsets for unseen sets, whatever hangs there, or its first refusal."""
    if fit.refusals:
        return str(fit.refusals[0])
    unseen = sets[len(fit.offsets) :]
    others = [offset_of_set(one.raw, one.gravity, fit.response, fit.noise) for one in unseen]
    return MethodResult(fit.matrix, np.array([*fit.offsets, *others]), fit.limb)


def paper_calibration(sets: Sequence[InSituSet]) -> MethodResult:
    """Calibrate as the paper does: filter, offset of each set (III-B), matrix from the first four (III-C)."""
    smooth = [filter_set(data) for data in sets]
    offsets = np.array([estimate_offset(data.raw, data.gravity).offset for data in smooth])
    fit = estimate_matrix(smooth[:FITTED], offsets[:FITTED], noise_margin=0.0)
    return MethodResult(fit.matrix, offsets, fit.limb)


def filter_set(data: InSituSet) -> InSituSet:
    """Return a set whose counts and gravity are filtered as in the paper, by cubics over 3 s."""
    assert data.time is not None
    window = 2 * round(FILTER / float(data.time[1] - data.time[0]) / 2.0) + 1
    return replace(data, raw=savitzky_golay(data.raw, window), gravity=savitzky_golay(data.gravity, window))


def wrench_error(matrix: Floats, response: Floats, wrench: Floats) -> tuple[float, float]:
    """Return rms of (C A - I) w over the rms of w, for forces and for torques, of C and the true A and w."""
    off = wrench @ (matrix @ response - np.eye(6)).T
    shares = [np.linalg.norm(off[:, part]) / np.linalg.norm(wrench[:, part]) for part in (FORCE, TORQUE)]
    return float(shares[0]), float(shares[1])


def fit_row(found: MethodResult | str, truth: SensorTruth, wrench: Floats) -> dict[str, Any]:
    """Score a calibration under true wrenches that were not fitted, (n, 6): in shares, ``com_error`` in m."""
    if isinstance(found, str):
        nothing = dict.fromkeys(("limb_error", "com_error", "force_error", "torque_error"), np.nan)
        return {**nothing, "refusal": found}
    force, torque = wrench_error(found.matrix, truth.response, wrench)
    return {
        "limb_error": found.limb.mass / truth.limb.mass - 1.0,
        "com_error": float(np.max(np.abs(found.limb.com - truth.limb.com))),
        "force_error": force,
        "torque_error": torque,
        "refusal": "",
    }


def set_rows(found: MethodResult | str, sets: Sequence[InSituSet]) -> list[dict[str, Any]]:
    """Check the sets that were not fitted as the paper does (Tables I to III): axes in N, kg, places in m."""
    if isinstance(found, str):
        return []
    rows = []
    for j, data in enumerate(sets[FITTED:], FITTED):
        wrench = (data.raw - found.offsets[j]) @ found.matrix.T
        axes = force_ellipsoid(wrench[:, FORCE], data.gravity).semi_axes
        weighed = added_mass(wrench, data.gravity, found.limb)
        place = weighed.position if data.added_mass > 0.0 else np.full(3, np.nan)
        rows.append(
            {
                "set": j + 1,
                **{f"axis_{i + 1}": float(axes[i]) for i in range(3)},
                "ratio": float(axes[0] / axes[2]),
                "added": data.added_mass,
                "mass": weighed.mass,
                "mass_error": abs(weighed.mass - data.added_mass),
                **{f"place_{axis}": float(p) for axis, p in zip("xyz", place, strict=True)},
                "place_error": float(np.max(np.abs(place - data.added_com))),
            }
        )
    return rows
