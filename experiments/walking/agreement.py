"""How well calibrated forces agree with those that the robot's own motion requires.

The feet's total and centre of pressure against those that mass, joints and IMU ask for (CoP paper, Eqs. 9 to
11), behind the paper's zero-phase filter. A calibrator that follows the motion makes it small whether the
motion is right or not: agreement is not truth.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import Reference, ground_reference, zero_phase
from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_moments, level_moments, sole_wrenches
from surefoot.experiments.logs.format import MAX_GAP, Log
from surefoot.experiments.walks.score import rms

LARGEST = 1e6  # magnitude in any unit of references that calibrators leave out
CUTOFF = 10.0  # cutoff of the filter that both sides pass, in Hz


class Ground(NamedTuple):
    """The ground under both feet, at the moments that the references describe: N - lag rows."""

    time: Floats  # in s
    vgrf: Floats  # of both feet in N; NaN where it is not known
    cop: Floats  # from the middle of the soles, level axes, in m, two columns; NaN for none


class Agreement(NamedTuple):
    """Root mean square distances between two sides: force in N, CoP in m, over how many rows."""

    vgrf: float
    cop: float
    rows: int


def ground_of_motion(log: Log) -> Ground:
    """Ground force and CoP that the robot's motion requires."""
    reference = _late_references(log)
    height = np.asarray(reference.position_sole)[..., 2].min(axis=-1)
    asked = ground_reference(reference, log.mass, height=height)
    return _ground(log, asked.vgrf, asked.moment)


def ground_of_forces(log: Log, force: Floats) -> Ground:
    """Ground force and CoP by forces of the feet's channels in N, shape (N, K)."""
    reference = _late_references(log)
    wrench = sole_wrenches(force[: len(log) - log.lag], log.layout)
    vgrf, moment = level_moments(wrench, reference.position_sole, reference.R_level_sole)
    return _ground(log, vgrf.sum(axis=-1), moment.sum(axis=-2))


def agreement(one: Ground, other: Ground, settle: float = 0.0) -> Agreement:
    """Compare two sides of one log, from a time in s on; NaN if no row counts."""
    counted = np.isfinite(one.cop).all(axis=-1) & np.isfinite(other.cop).all(axis=-1) & (one.time >= settle)
    if not counted.any():
        return Agreement(np.nan, np.nan, 0)
    place = np.linalg.norm((one.cop - other.cop)[counted], axis=-1)
    return Agreement(rms((one.vgrf - other.vgrf)[counted]), rms(place), int(counted.sum()))


def _late_references(log: Log) -> Reference:
    """Return the references from the first that describes a row, without those that cannot be."""
    late = take_rows(log.reference, slice(log.lag, None))
    sound = np.ones(len(log) - log.lag, dtype=bool)
    for part in late:
        sound &= np.all(np.abs(part.reshape(len(part), -1)) <= LARGEST, axis=1)
    if sound.all():
        return late  # without a copy, which would be as large as the log

    def blank(part: NDArray[Any]) -> NDArray[Any]:
        keep = sound.reshape(-1, *[1] * (part.ndim - 1))
        return part if part.dtype == bool else np.where(keep, part, np.nan)

    return Reference(*map(blank, late))


def _ground(log: Log, vgrf: Floats, moment: Floats) -> Ground:
    """Filter between gaps, and divide."""
    time = log.time[: len(log) - log.lag]
    middle = np.asarray(log.reference.position_sole)[log.lag :, :, :2].mean(axis=1)
    moment = moment - middle * vgrf[:, None]
    both = np.column_stack([vgrf, moment])
    parts = np.split(both, np.flatnonzero(np.diff(time) > MAX_GAP) + 1)
    if 0.5 / log.dt > CUTOFF:
        parts = [zero_phase(part, CUTOFF, log.dt) if len(part) > 1 else part for part in parts]
    both = np.concatenate(parts)
    return Ground(time, both[:, 0], np.asarray(cop_of_moments(both[:, 0], both[:, 1:], FORCE_THRESHOLD)))
