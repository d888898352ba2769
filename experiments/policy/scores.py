"""What the episodes of an evaluation say together: means with intervals, paired by seed."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.experiments._frames import Frame
from surefoot.experiments.controllers_by_name import short_name
from surefoot.experiments.policy.env import FEEDS
from surefoot.experiments.policy.evaluate import COP_INPUTS, EpisodeResult
from surefoot.experiments.score import Interval, mean_interval
from surefoot.experiments.tables import Table, with_interval

__all__ = [
    "Run",
    "controllers_of",
    "episodes_frame",
    "in_order",
    "labels",
    "loss_won_back",
    "paired_difference",
    "score_table",
    "survival",
    "won_back",
]

RESAMPLES = 4000
"""Bootstrap samples of the seeds."""


class Run(NamedTuple):
    """Episodes that differ by nothing but severity and seed.

    Attributes:
        feed: What was fed back.
        cop_input: What was done to it.
        controller: Who acted; ``None`` where there is but one.
    """

    feed: str
    cop_input: str = "felt"
    controller: str | None = None


def episodes_frame(results: Sequence[EpisodeResult]) -> Frame:
    """Put episodes into a table, a row each, see :func:`in_order`."""
    return in_order(pd.DataFrame([asdict(result) for result in results]))


def in_order(frame: Frame) -> Frame:
    """Sort episodes: controllers as they come, feeds from the true one to the best calibrated, and so on."""
    ranks = {"feed": list(FEEDS), "cop_input": list(COP_INPUTS)}
    keys = ["feed", "cop_input", "severity", "seed"]
    if "controller" in frame:
        ranks["controller"] = controllers_of(frame)
        keys.insert(0, "controller")

    def rank(column: "pd.Series[Any]") -> "pd.Series[Any]":
        order = ranks.get(str(column.name))
        return column if order is None else column.map(order.index)

    return frame.sort_values(keys, key=rank, ignore_index=True)


def controllers_of(frame: Frame) -> list[str]:
    """Name each controller once, as they come."""
    return list(dict.fromkeys(frame["controller"]))


def labels(controllers: Sequence[str]) -> dict[str, str]:
    """Name controllers briefly, and no two of them alike.

    >>> labels(["a/one.npz", "a/two.npz", "b/two.npz"])
    {'a/one.npz': 'one', 'a/two.npz': 'a/two.npz', 'b/two.npz': 'b/two.npz'}
    """
    short = [short_name(name) for name in controllers]
    return {
        name: brief if short.count(brief) == 1 else name
        for name, brief in zip(controllers, short, strict=True)
    }


def _returns(frame: Frame, run: Run, severity: float | None) -> "pd.Series[float]":
    wanted = (frame["feed"] == run.feed) & (frame["cop_input"] == run.cop_input)
    if run.controller is not None:
        wanted &= frame["controller"] == run.controller
    # The true feet know no severity: they are run once.
    if severity is not None and run.feed != "true":
        wanted &= frame["severity"] == severity
    found: pd.Series[float] = frame[wanted].set_index("seed")["total"].sort_index()
    if not found.index.is_unique:
        raise ValueError(
            f"Feed '{run.feed}' was run more than once with the same seed; name a severity and a controller."
        )
    return found


def paired_difference(
    frame: Frame,
    first: Run | tuple[str, str],
    second: Run | tuple[str, str],
    severity: float | None = None,
) -> Interval:
    """Compare the returns of two runs of the same seeds.

    Args:
        frame: Of :func:`episodes_frame`.
        first: Feed and what was done to it.
        second: Likewise.
        severity: Of the sensors; the true feet have none.

    Returns:
        First less second, with its 95 % interval over seeds.

    Raises:
        ValueError: If no seed is in both.
    """
    a, b = (_returns(frame, Run(*run), severity) for run in (first, second))
    both = a.index.intersection(b.index)
    if both.empty:
        raise ValueError(f"No seed was run with {tuple(first)} and with {tuple(second)}.")
    return mean_interval(a[both].to_numpy() - b[both].to_numpy())


def loss_won_back(frame: Frame, feed: str, severity: float) -> tuple[float, float, float]:
    """Tell which share of the return lost to drifting feet a calibration wins back.

    Args:
        frame: Of :func:`episodes_frame`, of one controller, with the feeds ``"true"`` and ``"none"`` in it.
        feed: The calibration.
        severity: Of the sensors.

    Returns:
        The share, and the ends of its 95 % interval, by bootstrap over seeds.

    Raises:
        ValueError: If no seed was run with all three.
    """
    runs = [_returns(frame, Run(name), severity) for name in (feed, "none", "true")]
    both = runs[0].index.intersection(runs[1].index).intersection(runs[2].index)
    if both.empty:
        raise ValueError(f"No seed was run with 'true', 'none' and '{feed}' at severity {severity:g}.")
    own, drifting, true = (run[both].to_numpy() for run in runs)
    draws = np.random.default_rng(0).integers(len(both), size=(RESAMPLES, len(both)))
    won: NDArray[np.float64] = (own - drifting)[draws].mean(axis=1) / (true - drifting)[draws].mean(axis=1)
    low, high = np.quantile(won, [0.025, 0.975])
    return float((own - drifting).mean() / (true - drifting).mean()), float(low), float(high)


def score_table(frame: Frame, name: str = "policy", title: str = "Feet of different kinds") -> Table:
    """Lay an evaluation out: a row for each controller, feed, what was done to it, and severity.

    Args:
        frame: Of :func:`episodes_frame`. Where there is but one controller, it has no column.
        name: Of the table.
        title: Of the table.
    """
    rows: list[tuple[str, ...]] = []
    several = "controller" in frame and frame["controller"].nunique() > 1
    parts = [(who, frame[frame["controller"] == who]) for who in controllers_of(frame)] if several else []
    brief = labels([who for who, _ in parts])
    for who, own in parts or [("", frame)]:
        rows += [(brief[who], *cells) if several else cells for cells in _score_rows(own)]
    return Table(
        name,
        title,
        (*("controller",) * several, "CoP fed back", "severity", "return", "loss won back", "falls",
         "time to fall / s", "CoP error / mm", "tracking error / mm"),
        tuple(rows),
        f"Means of {frame['seed'].nunique()} paired episodes with 95 % intervals; 'loss won back' only where "
        "drifting feet cost something beyond the interval.",
    )  # fmt: skip


def _score_rows(frame: Frame) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = []
    for (feed, cop_input, severity), part in frame.groupby(["feed", "cop_input", "severity"], sort=False):
        share = ""
        found = won_back(frame, str(feed), float(severity))
        if found is not None:
            share = f"{100 * found[0]:.1f} % ({100 * found[1]:.0f} to {100 * found[2]:.0f})"
        name = str(feed) if cop_input == "felt" else f"{feed}, {cop_input}"
        rows.append(
            (
                name,
                "–" if feed == "true" else f"{severity:g}",
                with_interval(part["total"], digits=4),
                share,
                f"{int(part['fell'].sum())} of {len(part)}",
                with_interval(part.loc[part["fell"], "time"]),
                with_interval(part["cop_error"], 1e3),
                with_interval(part["tracking"], 1e3),
            )
        )
    return rows


def won_back(frame: Frame, feed: str, severity: float) -> tuple[float, float, float] | None:
    """Tell the share of the loss that is won back, see :func:`loss_won_back`, if there is one to tell.

    Args:
        frame: Of :func:`episodes_frame`, of one controller.
        feed: What was fed back.
        severity: Of the sensors.

    Returns:
        The share and its interval; ``None`` if it is no calibration, was not run on the same seeds, or
        drifting feet cost nothing beyond the interval.
    """
    runs = [_returns(frame, Run(name), severity).index for name in (feed, "none", "true")]
    if feed in ("true", "none") or runs[0].intersection(runs[1]).intersection(runs[2]).empty:
        return None
    loss = paired_difference(frame, Run("true"), Run("none"), severity)
    return loss_won_back(frame, feed, severity) if loss.apart and loss.mean > 0.0 else None


def survival(frame: Frame, feed: str = "true") -> float:
    """Share of the episodes of a feed, as it was felt, that did not end in a fall."""
    part = frame[(frame["feed"] == feed) & (frame["cop_input"] == "felt")]
    return float(1.0 - part["fell"].mean())
