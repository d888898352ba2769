"""How well calibrated forces agree with those that the robot's own motion requires.

The feet's total and centre of pressure against those that mass, joints and IMU ask for (CoP paper, Eqs. 9 to
11), behind the paper's zero-phase filter. A calibrator that follows the motion makes it small whether the
motion is right or not: agreement is not truth.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats, take_rows
from surefoot.calibration import Estimate, Parameters, Reference, ground_reference, zero_phase
from surefoot.calibration.comparison import INDEPENDENT, SURE, Residuals, evidence_for_start
from surefoot.calibration.cop import FORCE_THRESHOLD, cop_of_moments, level_moments, sole_wrenches
from surefoot.calibration.results import Finding
from surefoot.experiments.logs.clock import find_gaps
from surefoot.experiments.logs.format import Log
from surefoot.experiments.walking.claims import AIR, BLOCK, COM, COP, FORCE, MASS, claims_of, ground_rows
from surefoot.experiments.walks.score import rms

LARGEST = 1e6  # magnitude in any unit of references that calibrators leave out
CUTOFF = 10.0  # cutoff of the filter that both sides pass, in Hz
AHEAD = 1.0  # time in s between the last sample that a map was learnt from and the sample it is tested on
SLACK = 2.0  # standard deviations of the robot's mass and centre of mass that no map is blamed for


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


class _Quantity(NamedTuple):
    """A quantity by which maps are compared: residuals in rows that neither was learnt from."""

    name: str
    factor: float  # of the unit in messages
    unit: str
    slack: float  # constant residual that errors of the robot's model explain
    floor: float  # standard deviation of the noise of a row
    learnt: Floats  # shape (n, C)
    start: Floats

    @property
    def evidence(self) -> float:
        """Logarithm of how much likelier the rows are by the start than by the learnt map."""
        count, components = self.start.shape
        if count == 0:
            return 0.0
        sides, ones = (Residuals.of(self.learnt), Residuals.of(self.start)), np.ones(components)
        return evidence_for_start(
            *sides, self.slack * ones, self.floor**2 * ones, count * BLOCK / INDEPENDENT
        )

    def __str__(self) -> str:
        """Root mean squares by the learnt map and by the start."""
        if len(self.start) == 0:
            return ""
        learnt, start = (
            self.factor * np.sqrt(np.square(side).sum(axis=1).mean()) for side in (self.learnt, self.start)
        )
        return f"{self.name} {learnt:.3g} {self.unit} (start {start:.3g} {self.unit})"


def compare_with_start(
    log: Log, initial: Parameters, estimate: Estimate, noticed: Sequence[Finding] = ()
) -> list[Finding]:
    """Return a finding if the learnt map agrees worse with the motion than the map it started from.

    A sample is tested by the map of :data:`AHEAD` s earlier, which was not learnt from it, in the second half
    of the log. What was ``noticed`` about the log may be the reason, and is repeated.
    """
    found = _quantities(log, initial, estimate)
    evidence = max(one.evidence for one in found)
    if evidence < SURE:
        return []
    reason = (
        "The learnt map agrees with the robot's motion worse than the map that it started from, by samples "
        f"that neither was learnt from: {', '.join(filter(None, map(str, found)))}."
    )
    cure = "Keep the starting map, and check mass, joints, IMU and clocks, or record another walk."
    reason = " ".join([reason, *(one.reason for one in noticed if not one.refuses)])
    return [Finding("worse than the start", reason, cure, evidence, SURE)]


def _quantities(log: Log, initial: Parameters, estimate: Estimate) -> list[_Quantity]:
    """Return the residuals of vertical force, centre of pressure and forces on swinging feet."""
    claims = claims_of(log, initial, 1.0)
    half, count = len(log) // 2, len(claims.raw)
    at = np.maximum(np.arange(count) - max(round(AHEAD / log.dt), 1), 0)
    learnt = np.asarray(estimate.scale)[at] * claims.raw + np.asarray(estimate.offset)[at]
    columns, asked = ground_rows(claims)
    swing = claims.reference.swing
    in_air = columns[:, 0] * swing[:, log.layout.foot_of_channel]
    sides = []
    for force in (learnt, claims.force):
        ground = np.einsum("nck,nk->nc", columns[:, :3], force) / claims.weight - asked[:, :3]
        air = (in_air * force).sum(axis=1, keepdims=True) / claims.weight
        ground[swing.all(axis=1)], air[~swing.any(axis=1)] = np.nan, np.nan
        sides.append([_block_means(part[half:], log.dt) for part in (ground[:, 1:], ground[:, :1], air)])
    named = (
        ("centre of pressure", 1e3, "mm", COM, COP),
        ("force", 100.0, "% of the weight", MASS, FORCE),
        ("feet in the air", 100.0, "% of the weight", 0.0, AIR),
    )
    found = []
    for (name, factor, unit, slack, floor), *rows in zip(named, *sides, strict=True):
        kept = np.isfinite(rows[0] + rows[1]).all(axis=1)
        found.append(_Quantity(name, factor, unit, SLACK * slack, floor, *(side[kept] for side in rows)))
    return found


def _block_means(rows: Floats, dt: float) -> Floats:
    """Return means over blocks, shape (n, C); NaN where a sample is missing."""
    size = max(round(BLOCK / dt), 1)
    count = len(rows) // size
    means: Floats = rows[: count * size].reshape(count, size, rows.shape[1]).mean(axis=1)
    return means


def _late_references(log: Log) -> Reference:
    """Return the references from the first that describes a row, without those that cannot be."""
    late: Reference = take_rows(log.reference, slice(log.lag, None))
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
    parts = np.split(both, np.flatnonzero(find_gaps(np.diff(time))) + 1)
    if 0.5 / log.dt > CUTOFF:
        parts = [zero_phase(part, CUTOFF, log.dt) if len(part) > 1 else part for part in parts]
    both = np.concatenate(parts)
    return Ground(time, both[:, 0], np.asarray(cop_of_moments(both[:, 0], both[:, 1:], FORCE_THRESHOLD)))
