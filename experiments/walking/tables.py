"""Tables of a calibrated walk: the log, the map, the agreement with the motion, flags, and errors."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.arrays import Floats
from surefoot.calibration import GRAVITY, Estimate, Flag, OnlineSetup, Parameters
from surefoot.experiments.logs.format import Log
from surefoot.experiments.study.tables import Table, decimal, number, percent, span, with_deviation
from surefoot.experiments.walking.agreement import agreement, ground_of_forces, ground_of_motion
from surefoot.experiments.walks.score import hold_last, score_forces


class MapChange(NamedTuple):
    """How F = a F_start + b is: (a - 1) in percent, b in N and their standard deviations, (N, K) each."""

    scale: Floats
    offset: Floats
    std: tuple[Floats | None, Floats | None]


@dataclass(frozen=True, eq=False)
class Facts:
    """The data of tables, figures and page."""

    log: Log
    start: str  # name of the starting map
    initial: Parameters  # that map
    estimate: Estimate
    settle: float = 0.0  # samples before this time in s do not count in errors
    method: str = ""
    file: str = ""  # name of the log
    notices: tuple[str, ...] = ()  # what the log lacks

    @property
    def feet_alone(self) -> bool:
        """Whether the log has no references, and so no motion to agree with."""
        return bool(self.log.about.get("feet_alone", False))

    @cached_property
    def before(self) -> Floats:
        """Forces by the starting map in N, shape (N, K).

        Where no reading arrived, or one that no foot can give, the last one is held, as calibrators do.
        """
        force: Floats = self.initial.force(self.log.raw)
        seen = np.abs(force) <= OnlineSetup.plausible_weights * self.log.mass * GRAVITY
        return np.nan_to_num(hold_last(force, seen))

    def sides(self) -> tuple[tuple[str, Floats], ...]:
        """Return forces after and before, with their names in tables."""
        return ("calibrated", self.estimate.force), (f"by the {self.start} map", self.before)

    def change(self) -> MapChange:
        """Return how the map changes along the log."""
        estimate, initial = self.estimate, self.initial
        ratio = estimate.scale / initial.scale
        std: tuple[Floats | None, Floats | None] = (None, None)
        if estimate.covariance is not None:
            K = ratio.shape[1]
            variance = estimate.covariance[:, np.arange(2 * K), np.arange(2 * K)]
            both = np.sqrt(np.maximum(variance, 0.0))
            std = (100 * both[:, :K], both[:, K:])
        return MapChange(100 * (ratio - 1), estimate.offset - ratio * initial.offset, std)


def terminal_tables(facts: Facts) -> tuple[Table, ...]:
    """Return the tables besides the map that a terminal shows."""
    score = () if facts.log.truth is None else (score_table(facts),)
    moved = () if facts.feet_alone else (agreement_table(facts),)
    return (*moved, *score, flag_table(facts))


def log_table(facts: Facts) -> Table:
    """Table of the log, its contacts and its starting map."""
    log = facts.log

    def shares(phase: NDArray[np.bool_]) -> str:
        named = zip(log.layout.feet, np.asarray(phase).mean(axis=0), strict=True)
        return ", ".join(f"{foot.name} {100 * share:.0f} %" for foot, share in named)

    about = log.about
    model = (("model", f"{about['model']}, {about['model_mass_kg']:.4g} kg"),) if "model" in about else ()
    rows = (
        ("samples", decimal(len(log), "d")),
        ("duration", f"{log.time[-1] - log.time[0]:.2f} s at {1 / log.dt:.4g} Hz"),
        ("mass", f"{log.mass:.4g} kg"),
        ("channels", decimal(log.layout.channels, "d")),
        ("motion is late by", f"{log.lag} samples"),
        *model,
        ("contacts", str(about.get("contacts", "as the log says"))),
        ("surely in the air", shares(log.reference.swing)),
        ("surely on the ground", shares(log.reference.stance)),
        ("started from", f"the {facts.start} map"),
        ("errors count from", f"{facts.settle:g} s on"),
    )
    return Table("log", "What was calibrated", ("what", "given"), rows)


def parameter_table(facts: Facts) -> Table:
    """Return the map at the end of a log."""
    log, estimate, change = facts.log, facts.estimate, facts.change()
    unit, factor = ("1e-6 N/count", 1e6) if np.abs(facts.initial.scale).max() < 1e-2 else ("N/count", 1.0)
    scale_std, offset_std = change.std
    rows = []
    for i, name in enumerate(log.layout.channel_names):
        scale, offset = decimal(change.scale[-1, i], "+.2f"), decimal(change.offset[-1, i], "+.3f")
        if scale_std is not None and offset_std is not None:
            scale = with_deviation(change.scale[-1, i], scale_std[-1, i])
            offset = with_deviation(change.offset[-1, i], offset_std[-1, i])
        now = decimal(factor * estimate.scale[-1, i], ".5f"), decimal(estimate.offset[-1, i], ".4f")
        rows.append((name.replace("/", ", "), *now, scale, offset))
    columns = ("cell", f"scale ({unit})", "offset (N)", "scale changed by (%)", "offset changed by (N)")
    note = f"Changes against {facts.start}" + ("." if scale_std is None else ", ± one standard deviation.")
    nis = nis_per_row(estimate)
    if nis is not None:
        note += (
            f" Normalised innovations are {nis:.2f} per row; 1 is what the method expects of its own noise."
        )
    return Table("parameters", "The map at the end of the log", columns, tuple(rows), note)


def nis_per_row(estimate: Estimate) -> float | None:
    """Return normalised innovations squared per row, 1 where noise is as assumed; ``None`` without any."""
    if estimate.nis is None:
        return None
    seen = np.isfinite(estimate.nis)
    rows = float(np.sum(np.asarray(estimate.nis_rows)[seen]))
    return float(np.sum(np.asarray(estimate.nis)[seen])) / rows if rows else None


def agreement_table(facts: Facts) -> Table:
    """Return how far the feet are from the motion's forces, after and before."""
    log, asked = facts.log, ground_of_motion(facts.log)
    rows = []
    for name, force in facts.sides():
        found = agreement(ground_of_forces(log, force), asked, facts.settle)
        rows.append((name, number(found.vgrf), number(1e3 * found.cop), decimal(found.rows, "d")))
    return Table(
        "agreement",
        "Distance from what the robot's own motion asks for (rms)",
        ("feet", "vGRF (N)", "CoP (mm)", "rows"),
        tuple(rows),
        "Both sides behind a zero-phase filter of 10 Hz. The motion has errors of its own: it is not truth.",
    )


def score_table(facts: Facts) -> Table:
    """Return errors against the truth of a simulated log; raise ValueError if there is nothing to score."""
    log, truth = facts.log, facts.log.truth
    assert truth is not None
    rows = []
    for name, force in facts.sides():
        score = score_forces(
            force,
            truth.force,
            layout=log.layout,
            position_sole=truth.position_sole,
            R_world_sole=truth.R_world_sole,
            time=log.time,
            settle=facts.settle,
        )
        rows.append((name, number(1e3 * score.cop), number(score.vgrf), number(score.cell)))
    columns = ("rmse against the truth in the log", "CoP (mm)", "vGRF (N)", "single cell (N)")
    return Table("score", f"Errors from {facts.settle:g} s on", columns, tuple(rows))


def flag_table(facts: Facts) -> Table:
    """Return which flags were raised, how long and on which channels."""
    log, flags = facts.log, np.asarray(facts.estimate.flags)
    rows = []
    for flag in Flag:
        raised = (flags & flag.value) != 0
        if not raised.any():
            continue
        when = np.flatnonzero(raised.any(axis=1))
        channels = np.flatnonzero(raised.any(axis=0))
        names = [log.layout.channel_names[i].replace("/", ", ") for i in channels]
        where = "all channels" if len(names) == raised.shape[1] else "; ".join(names)
        between = span(log.time[when[0]], log.time[when[-1]], ".2f")
        rows.append((flag.words, percent(len(when) / len(flags), ".2f"), between, where))
    if not rows:
        rows.append(("nothing was flagged", percent(0.0), "–", "–"))
    return Table("flags", "Flags", ("flag", "of the samples", "between (s)", "on"), tuple(rows))
