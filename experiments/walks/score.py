"""How far calibrated forces are from the truth, or from a baseline.

All errors are root mean squares over the samples of one walk from a settling time on:

* **CoP**: the centre of pressure of both feet together in the world, sqrt(mean(ex^2 + ey^2)). Both sides use
  the *true* poses of the soles, so that the error is one of forces alone. Only samples count in which the
  true vertical force exceeds 5 N. Where the estimated force does not, its centre of pressure is held, as an
  observation holds it, and still counts.
* **foot's CoP**: that of each foot in its own sole's frame, over both feet, where the true load of the foot
  exceeds 5 N; held likewise. The total hides errors of one foot in the other's favour.
* **vGRF**: the vertical force of both feet together; ``vgrf_foot`` is that of each foot.
* **cell**: the force of single cells, over all cells.

The CoP paper scores against its own calibration from weights applied to the same counts instead of a truth;
that is the same formula with other forces in the truth's place.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_feet, cop_of_wrench, sole_wrenches
from surefoot.calibration.layout import FeetLayout
from surefoot.experiments.arrays import Floats


class Score(NamedTuple):
    """Errors of one estimate over one walk, rms."""

    cop: float  # in m
    cop_x: float  # its part along the world's x axis (forward) in m
    cop_y: float  # its part along y (left) in m
    cop_foot: float  # of single feet in m
    vgrf: float  # of both feet together in N
    vgrf_foot: float  # of single feet in N
    cell: float  # in N
    samples: int  # that count
    held: float  # share of them in which the estimate had no centre of pressure of its own


def cop_world(force: Floats, layout: FeetLayout, position_sole: Floats, R_world_sole: Floats) -> Floats:
    """Return the CoP of both feet in the world in m, (N, 2), held below 5 N; NaN before the first.

    Of forces in N, (N, K), and the sole frames' origins in m, (N, 2, 3), and rotations to the world, (N, 2,
    3, 3).
    """
    cop = cop_of_feet(sole_wrenches(force, layout), position_sole, R_world_sole)
    return hold_last(cop, np.isfinite(cop).all(axis=-1, keepdims=True))


def score_forces(
    estimate: Floats,
    truth: Floats,
    *,
    layout: FeetLayout,
    position_sole: Floats,
    R_world_sole: Floats,
    time: Floats,
    settle: float = 0.0,
) -> Score:
    """Score calibrated forces in N, (N, K), against other ones, at times in s, (N,), from ``settle`` s on.

    Poses are the true ones, as in :func:`cop_world`. Rows with a value that is not finite (no sample had
    arrived) are left out. Raises ValueError if no sample is left to count.
    """
    finite = np.isfinite(estimate).all(axis=-1) & np.isfinite(truth).all(axis=-1)
    counted = finite & (time >= settle)
    if not counted.any():
        raise ValueError(
            f"No sample from {settle:g} s on has finite forces, so there is nothing to score; "
            f"the walk ends at {time[-1]:g} s: walk longer or settle for less."
        )
    vgrf_estimate = vertical_forces(estimate, layout, R_world_sole)
    vgrf_truth = vertical_forces(truth, layout, R_world_sole)
    pressed = counted & (vgrf_truth.sum(axis=-1) > FORCE_THRESHOLD)
    cop_estimate = cop_world(estimate, layout, position_sole, R_world_sole)
    error = cop_estimate - cop_world(truth, layout, position_sole, R_world_sole)
    pressed &= np.isfinite(error).all(axis=-1)
    lost = vgrf_estimate.sum(axis=-1) <= FORCE_THRESHOLD
    cop_x, cop_y = np.sqrt(np.mean(error[pressed] ** 2, axis=0)) if pressed.any() else (np.nan, np.nan)
    return Score(
        cop=float(np.hypot(cop_x, cop_y)),
        cop_x=float(cop_x),
        cop_y=float(cop_y),
        cop_foot=rms(foot_errors(estimate, truth, layout)[counted]),
        vgrf=rms((vgrf_estimate - vgrf_truth).sum(axis=-1)[counted]),
        vgrf_foot=rms((vgrf_estimate - vgrf_truth)[counted]),
        cell=rms((estimate - truth)[counted]),
        samples=int(counted.sum()),
        held=float(np.mean(lost[pressed])) if pressed.any() else float("nan"),
    )


def foot_errors(estimate: Floats, truth: Floats, layout: FeetLayout) -> Floats:
    """Return how far each foot's CoP is off in m, (N, 2), of forces in N, (N, K); NaN up to 5 N of load."""
    found, expected = (cop_of_wrench(sole_wrenches(force, layout)) for force in (estimate, truth))
    there = np.isfinite(found).all(axis=-1)
    own = np.stack([hold_last(found[:, i], there[:, i, None]) for i in range(found.shape[1])], axis=1)
    off: Floats = np.linalg.norm(own - expected, axis=-1)
    return off


def vertical_forces(force: Floats, layout: FeetLayout, R_world_sole: Floats) -> Floats:
    """Return the vertical force of each foot in N, shape (N, 2); arguments as in :func:`cop_world`."""
    wrench = sole_wrenches(force, layout)
    vertical: Floats = np.sum(R_world_sole[..., 2, :] * wrench[..., :3], axis=-1)
    return vertical


def rms(values: ArrayLike) -> float:
    """Return the root mean square of the finite values; NaN if there is none."""
    array = np.asarray(values, dtype=np.float64)
    array = array[np.isfinite(array)]
    return float(np.sqrt(np.mean(array**2))) if array.size else float("nan")


def hold_last(values: Floats, there: NDArray[np.bool_] | None = None) -> Floats:
    """Carry the last values that are there (finite by default) over others, (N, K); NaN before the first."""
    there = np.isfinite(values) if there is None else there
    last = np.maximum.accumulate(np.where(there, np.arange(len(values))[:, None], -1), axis=0)
    carried: Floats = np.take_along_axis(values, np.maximum(last, 0), axis=0)
    return np.where(last >= 0, carried, np.nan)
