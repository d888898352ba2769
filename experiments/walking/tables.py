"""What to say in tables of a calibrated walk: the map, the agreement with the motion, flags, and errors."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surefoot.calibration import GRAVITY, Estimate, Flag, OnlineSetup, Parameters
from surefoot.experiments.logs.agreement import Agreement, agreement, asked_of, carried_by
from surefoot.experiments.logs.format import Log
from surefoot.experiments.study.tables import Table, number
from surefoot.experiments.walks.score import score_forces

__all__ = [
    "FLAG_WORDS",
    "Facts",
    "agreement_table",
    "flag_table",
    "parameter_table",
    "score_table",
    "shown_tables",
]

FLAG_WORDS = {
    "MISSING": "no reading arrived; the last one is held",
    "OUT_OF_RANGE": "a reading that no foot can give; the last one is held",
    "REFERENCE": "the motion is not known or not physical; nothing is learnt",
    "GAP": "the clock jumped; filters begin anew",
    "NO_CONTACT": "too little weight on the feet to learn from",
    "SINGULAR": "the data do not tell the parameters apart; they stay",
    "STANDING": "still collecting the standing start",
    "REJECTED": "the data ask for what no sensor does; refused",
    "SPIKE": "a single reading far off",
    "STUCK": "the channel keeps one value",
    "DEAD": "the channel does not follow the load",
    "FLIPPED": "the channel has the wrong sign",
    "SWAPPED": "the channel reads another one's load",
    "LOST": "the channel is out; its force comes from the others",
    "SATURATED": "the channel is at the end of its range",
}
"""What each bit of a flag means to who reads a page."""


class Facts(NamedTuple):
    """What tables and page are made of.

    Attributes:
        log: The log.
        start: Name of the map to start from.
        began: That map.
        estimate: What the method made of the log.
        settle: Samples before this time in s do not count.
    """

    log: Log
    start: str
    began: Parameters
    estimate: Estimate
    settle: float

    @property
    def before(self) -> NDArray[np.float64]:
        """Forces by the starting map in N, shape (N, K).

        Where no reading arrived, or one that no foot can give, the last one is held, as calibrators do.
        """
        force: NDArray[np.float64] = self.began.force(self.log.raw)
        seen = np.abs(force) <= OnlineSetup.plausible_weights * self.log.mass * GRAVITY
        last = np.maximum.accumulate(np.where(seen, np.arange(len(force))[:, None], -1), axis=0)
        held = np.take_along_axis(force, np.maximum(last, 0), axis=0)
        return np.where(last >= 0, held, 0.0)


def shown_tables(facts: Facts) -> tuple[Table, ...]:
    """List the tables besides the map that a terminal shows."""
    tables = [agreement_table(facts)]
    if facts.log.truth is not None:
        tables.append(score_table(facts))
    tables.append(flag_table(facts.log, facts.estimate.flags))
    return tuple(tables)


def parameter_table(log: Log, estimate: Estimate, began: Parameters, start: str) -> Table:
    """Show the map at the end of a log."""
    ratio = estimate.scale[-1] / began.scale
    shift = estimate.offset[-1] - ratio * began.offset
    sure = estimate.covariance
    std = None if sure is None else np.sqrt(np.diagonal(np.asarray(sure)[-1]))
    K = log.layout.channels
    unit, factor = ("1e-6 N/count", 1e6) if np.abs(began.scale).max() < 1e-2 else ("N/count", 1.0)
    rows = []
    for i, name in enumerate(log.layout.channel_names):
        gain, zero = f"{100 * (ratio[i] - 1):+.2f} %", f"{shift[i]:+.3f}"
        if std is not None:
            gain, zero = f"{gain} ± {100 * std[i]:.2f}", f"{zero} ± {std[K + i]:.3f}"
        rows.append(
            (
                name.replace("/", ", "),
                f"{factor * estimate.scale[-1, i]:.5f}",
                f"{estimate.offset[-1, i]:.4f}",
                gain,
                zero,
            )
        )
    columns = ("cell", f"scale ({unit})", "offset (N)", "scale changed by", "zero changed by (N)")
    note = f"Changes against {start}" + ("." if std is None else ", ± one standard deviation.")
    nis = consistency(estimate)
    if nis is not None:
        note += (
            f" Normalised innovations are {nis:.2f} per row; 1 is what the method expects of its own noise."
        )
    return Table("parameters", "The map at the end of the log", columns, tuple(rows), note)


def consistency(estimate: Estimate) -> float | None:
    """Say how the innovations compare with what a method expected of them.

    Args:
        estimate: N samples.

    Returns:
        Sum of the normalised innovations squared over the sum of their degrees of freedom: 1 where the noise
        is as the method supposes. ``None`` if the method claims none, or never had one.
    """
    if estimate.nis is None:
        return None
    seen = np.isfinite(estimate.nis)
    rows = float(np.sum(np.asarray(estimate.nis_rows)[seen]))
    return float(np.sum(np.asarray(estimate.nis)[seen])) / rows if rows else None


def agreement_table(facts: Facts) -> Table:
    """Show how far the feet are from what the motion asks for, before and after."""
    log, asked = facts.log, asked_of(facts.log)
    rows = []
    for name, force in _both(facts):
        found: Agreement = agreement(carried_by(log, force), asked, facts.settle)
        rows.append((name, number(found.vgrf), number(1e3 * found.cop), str(found.rows)))
    return Table(
        "agreement",
        "Distance from what the robot's own motion asks for (rms)",
        ("feet", "vGRF (N)", "CoP (mm)", "rows"),
        tuple(rows),
        "Both sides behind a zero-phase filter of 10 Hz. The motion has errors of its own: it is not truth.",
    )


def score_table(facts: Facts) -> Table:
    """Show errors against the truth of a simulated log.

    Raises:
        ValueError: If there is nothing to score.
    """
    log, truth = facts.log, facts.log.truth
    assert truth is not None
    rows = []
    for name, force in _both(facts):
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


def flag_table(log: Log, flags: NDArray[np.int64]) -> Table:
    """Show which flags were raised, how long and on which channels."""
    rows = []
    for flag in Flag:
        raised = (flags & flag.value) != 0
        if not raised.any():
            continue
        when = np.flatnonzero(raised.any(axis=1))
        share = raised.mean(axis=0)
        names = [
            name.replace("/", ", ")
            for name, part in zip(log.layout.channel_names, share, strict=True)
            if part
        ]
        where = "all channels" if len(names) == len(share) else "; ".join(names)
        span = f"{log.time[when[0]]:.2f} to {log.time[when[-1]]:.2f}"
        words = FLAG_WORDS.get(str(flag.name), str(flag.name).lower().replace("_", " "))
        rows.append((words, f"{100 * len(when) / len(flags):.2f} %", span, where))
    if not rows:
        rows.append(("nothing was flagged", "0 %", "–", "–"))
    return Table("flags", "Flags", ("flag", "of the samples", "between (s)", "on"), tuple(rows))


def _both(facts: Facts) -> tuple[tuple[str, NDArray[np.float64]], ...]:
    return (
        ("calibrated", facts.estimate.force),
        (f"by the {facts.start} map", facts.before),
    )
