"""How far calibrated forces are from the truth, or from a baseline.

All errors are root mean squares over the samples of one walk from a settling time on:

* **CoP**: the centre of pressure of both feet together in the world, sqrt(mean(ex^2 + ey^2)). Both sides use
  the *true* poses of the soles, so that the error is one of forces alone. Only samples count in which the
  true vertical force exceeds 5 N. Where the estimated force does not, its centre of pressure is held, as an
  observation holds it, and still counts.
* **foot's CoP**: that of each foot in its own sole's frame, over both feet, where the true load of the foot
  exceeds 5 N; held likewise. The total hides errors of one foot in the other's favour.
* **vGRF**: the vertical force of both feet together.
* **cell**: the force of single cells, over all cells.

The CoP paper scores against its own calibration from weights applied to the same counts instead of a truth;
that is the same formula with other forces in the truth's place.
"""

from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from surefoot.arrays import Floats
from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_feet, cop_of_wrench, sole_wrenches
from surefoot.calibration.layout import FeetLayout

RUNNING = 2.0  # length in s of the running error


class Score(NamedTuple):
    """Errors of one estimate over one walk, rms."""

    cop: float  # in m
    cop_foot: float  # of single feet in m
    vgrf: float  # of both feet together in N
    cell: float  # in N


class Errors(NamedTuple):
    """Errors of an estimate at each of N samples."""

    cop: Floats  # size in m, shape (N,); NaN where it does not count
    cop_foot: Floats  # likewise of each foot, shape (N, 2)
    vgrf: Floats  # in N, shape (N,)
    cell: Floats  # of the channels that are forces in N, shape (N, C)

    def rms(self, counted: NDArray[np.bool_]) -> dict[str, float]:
        """Return root mean squares over some samples, by the names of the errors."""
        return {name: rms(part[counted]) for name, part in self._asdict().items()}


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
    errors = errors_of(estimate, truth, layout, position_sole, R_world_sole)
    return Score(**errors.rms(counted))


def errors_of(
    estimate: Floats,
    truth: Floats,
    layout: FeetLayout,
    position_sole: Floats,
    R_world_sole: Floats,
    true_cop: Floats | None = None,
) -> Errors:
    """Return errors of forces in N, (N, K), against others, or a CoP that is known better in m, (N, 2)."""
    poses = (layout, position_sole, R_world_sole)
    vgrf, true_vgrf = (vertical_forces(f, layout, R_world_sole).sum(axis=-1) for f in (estimate, truth))
    true_cop = cop_world(truth, *poses) if true_cop is None else true_cop
    off = np.linalg.norm(cop_world(estimate, *poses) - true_cop, axis=-1)
    cop: Floats = np.where(true_vgrf > FORCE_THRESHOLD, off, np.nan)
    cell = (estimate - truth)[:, are_forces(layout)]
    return Errors(cop, _foot_errors(estimate, truth, layout), vgrf - true_vgrf, cell)


def are_forces(layout: FeetLayout) -> list[bool]:
    """Return which channels are forces: torques of a six-axis sensor are in another unit."""
    return [not name.rpartition("/")[2].startswith("t") for name in layout.channel_names]


def _foot_errors(estimate: Floats, truth: Floats, layout: FeetLayout) -> Floats:
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


def running_rmse(time: Floats, error: Floats) -> Floats:
    """Return the rms of the last 2 s at each sample, shape (N,), of times in s and sizes of errors.

    Errors that are NaN do not count. The result is NaN before there were 2 s, and where no sample counts.
    """
    square = pd.Series(np.where(np.isfinite(error), error, np.nan) ** 2, pd.to_timedelta(time, unit="s"))
    mean = square.rolling(pd.Timedelta(RUNNING, unit="s"), min_periods=1).mean().to_numpy()
    return np.where(time >= time[0] + RUNNING, np.sqrt(np.maximum(mean, 0.0)), np.nan)


def running_errors(time: Floats, error: Floats, interval: float) -> list[dict[str, float]]:
    """Return ``time`` and the running error ``cop``, one row per ``interval`` in s of evenly spaced times."""
    every = max(round(interval / float(time[1] - time[0])), 1)
    running = running_rmse(time, error)
    rows = zip(time[::every], running[::every], strict=True)
    return [{"time": float(moment), "cop": float(value)} for moment, value in rows]
