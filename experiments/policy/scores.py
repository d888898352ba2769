"""What the episodes of an evaluation say together: means with intervals, paired by seed."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.experiments.policy.env import FEEDS
from surefoot.experiments.policy.evaluate import COP_INPUTS, EpisodeResult
from surefoot.experiments.score import Interval, mean_interval
from surefoot.experiments.tables import Table, with_interval

__all__ = ["episodes_frame", "in_order", "loss_won_back", "paired_difference", "score_table", "survival"]

RESAMPLES = 4000
"""Bootstrap samples of the seeds."""


def episodes_frame(results: Sequence[EpisodeResult]) -> pd.DataFrame:
    """Put episodes into a table, a row each, see :func:`in_order`."""
    return in_order(pd.DataFrame([asdict(result) for result in results]))


def in_order(frame: pd.DataFrame) -> pd.DataFrame:
    """Sort episodes: feeds from the true one to the best calibrated, and what was done to them."""
    ranks = {"feed": list(FEEDS), "cop_input": list(COP_INPUTS)}

    def rank(column: "pd.Series[Any]") -> "pd.Series[Any]":
        order = ranks.get(str(column.name))
        return column if order is None else column.map(order.index)

    return frame.sort_values(["feed", "cop_input", "severity", "seed"], key=rank, ignore_index=True)


def _returns(frame: pd.DataFrame, feed: str, severity: float | None, cop_input: str) -> "pd.Series[float]":
    wanted = (frame["feed"] == feed) & (frame["cop_input"] == cop_input)
    # The true feet know no severity: they are run once.
    if severity is not None and feed != "true":
        wanted &= frame["severity"] == severity
    found: pd.Series[float] = frame[wanted].set_index("seed")["total"].sort_index()
    if not found.index.is_unique:
        raise ValueError(f"Feed '{feed}' was run more than once with the same seed; name a severity.")
    return found


def paired_difference(
    frame: pd.DataFrame, first: tuple[str, str], second: tuple[str, str], severity: float | None = None
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
    a = _returns(frame, first[0], severity, first[1])
    b = _returns(frame, second[0], severity, second[1])
    both = a.index.intersection(b.index)
    if both.empty:
        raise ValueError(f"No seed was run with {first} and with {second}.")
    return mean_interval(a[both].to_numpy() - b[both].to_numpy())


def loss_won_back(frame: pd.DataFrame, feed: str, severity: float) -> tuple[float, float, float]:
    """Tell which share of the return lost to drifting feet a calibration wins back.

    Args:
        frame: Of :func:`episodes_frame`, with the feeds ``"true"`` and ``"none"`` in it.
        feed: The calibration.
        severity: Of the sensors.

    Returns:
        The share, and the ends of its 95 % interval, by bootstrap over seeds.

    Raises:
        ValueError: If no seed was run with all three.
    """
    runs = [_returns(frame, name, severity, "felt") for name in (feed, "none", "true")]
    both = runs[0].index.intersection(runs[1].index).intersection(runs[2].index)
    if both.empty:
        raise ValueError(f"No seed was run with 'true', 'none' and '{feed}' at severity {severity:g}.")
    own, drifting, true = (run[both].to_numpy() for run in runs)
    draws = np.random.default_rng(0).integers(len(both), size=(RESAMPLES, len(both)))
    won: NDArray[np.float64] = (own - drifting)[draws].mean(axis=1) / (true - drifting)[draws].mean(axis=1)
    low, high = np.quantile(won, [0.025, 0.975])
    return float((own - drifting).mean() / (true - drifting).mean()), float(low), float(high)


def score_table(frame: pd.DataFrame) -> Table:
    """Lay an evaluation out: a row for each feed, what was done to it, and severity."""
    rows = []
    complete = {"true", "none"} <= set(frame["feed"])
    for (feed, cop_input, severity), part in frame.groupby(["feed", "cop_input", "severity"], sort=False):
        share = ""
        if complete and feed not in ("true", "none"):
            won, low, high = loss_won_back(frame, str(feed), float(severity))
            share = f"{100 * won:.0f} % ({100 * low:.0f} to {100 * high:.0f})"
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
    return Table(
        "policy",
        "A balance policy on feet of different kinds",
        ("CoP fed back", "severity", "return", "loss won back", "falls", "time to fall / s", "CoP error / mm",
         "tracking error / mm"),
        tuple(rows),
        f"Means of {frame['seed'].nunique()} paired episodes with 95 % intervals.",
    )  # fmt: skip


def survival(frame: pd.DataFrame, feed: str = "true") -> float:
    """Share of the episodes of a feed, as it was felt, that did not end in a fall."""
    part = frame[(frame["feed"] == feed) & (frame["cop_input"] == "felt")]
    return float(1.0 - part["fell"].mean())
