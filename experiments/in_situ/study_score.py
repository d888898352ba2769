"""What a calibration of the simulated rig is worth: against the truth, and by the paper's own checks."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration.in_situ import InSituSet
from surefoot.experiments.force_torque.score import added_mass, semi_axes
from surefoot.experiments.in_situ.instruments import SensorTruth
from surefoot.experiments.in_situ.methods import FITTED, MethodResult

__all__ = ["fit_row", "set_rows", "wrench_error"]


def wrench_error(
    matrix: NDArray[np.float64], response: NDArray[np.float64], wrench: NDArray[np.float64]
) -> tuple[float, float]:
    """Measure a matrix on true wrenches: rms of (C A - I) w over the rms of w, for forces and for torques.

    Args:
        matrix: C in N and N m per count, shape (6, k).
        response: The true A, shape (k, 6).
        wrench: In N and N m, shape (n, 6).
    """
    off = wrench @ (matrix @ response - np.eye(6)).T
    shares = [np.linalg.norm(off[:, part]) / np.linalg.norm(wrench[:, part]) for part in (_FORCE, _TORQUE)]
    return float(shares[0]), float(shares[1])


def fit_row(found: MethodResult | str, truth: SensorTruth, wrench: NDArray[np.float64]) -> dict[str, Any]:
    """Score a calibration against the truth.

    Args:
        found: The calibration, or what was said in its place.
        truth: What the simulator knows.
        wrench: True wrenches of sets that were not fitted, shape (n, 6).

    Returns:
        ``limb_error`` (share of the limb's weight), ``com_error`` (m, largest of the axes), ``force_error``
        and ``torque_error`` (shares of the load) and ``said``.
    """
    if isinstance(found, str):
        nothing = dict.fromkeys(("limb_error", "com_error", "force_error", "torque_error"), np.nan)
        return {**nothing, "said": found}
    force, torque = wrench_error(found.matrix, truth.response, wrench)
    return {
        "limb_error": found.limb.mass / truth.limb.mass - 1.0,
        "com_error": float(np.max(np.abs(found.limb.com - truth.limb.com))),
        "force_error": force,
        "torque_error": torque,
        "said": "",
    }


def set_rows(found: MethodResult | str, sets: Sequence[InSituSet]) -> list[dict[str, Any]]:
    """Check the sets that were not fitted as the paper does (Tables I to III).

    Returns:
        A row a set: ``set`` (its number), ``axis_1`` to ``axis_3`` (N), ``ratio``, ``added`` (kg, true),
        ``mass`` (kg), ``place_x`` to ``place_z`` (m; NaN where nothing was added) and ``mass_error`` (kg),
        ``place_error`` (m, largest of the axes).
    """
    if isinstance(found, str):
        return []
    rows = []
    for j, data in enumerate(sets):
        if j < FITTED:
            continue
        wrench = (data.raw - found.offsets[j]) @ found.matrix.T
        axes = semi_axes(wrench[:, :3], data.gravity)
        weighed = added_mass(wrench, data.gravity, found.limb)
        hangs = data.added_mass > 0.0
        place = weighed.position if hangs else np.full(3, np.nan)
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


_FORCE, _TORQUE = slice(0, 3), slice(3, 6)
