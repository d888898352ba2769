"""What the episodes of an evaluation say together: means with intervals, paired by seed."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from surefoot.experiments.policy.controllers import labels
from surefoot.experiments.policy.env import FEEDS
from surefoot.experiments.policy.evaluate import COP_INPUTS, EpisodeResult
from surefoot.experiments.study.statistics import Interval, mean_interval
from surefoot.experiments.study.tables import Frame, Table, number, with_interval

__all__ = [
    "Run",
    "controllers_of",
    "episodes_frame",
    "in_order",
    "loss_won_back",
    "paired_difference",
    "same_seeds",
    "score_table",
    "seed_ranges",
    "seeds_text",
    "survival",
    "won_back",
]

RESAMPLES = 4000
"""Bootstrap samples of the seeds."""

FEW_FALLS = 5
"""Falls below which the mean time to fall has no interval worth the name."""


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


def seed_ranges(seeds: Iterable[int]) -> list[tuple[int, int]]:
    """Put seeds together that follow each other: first and last of each row of them.

    >>> seed_ranges([7, 3, 1, 2])
    [(1, 3), (7, 7)]
    """
    found: list[tuple[int, int]] = []
    for seed in sorted({int(seed) for seed in seeds}):
        if found and seed == found[-1][1] + 1:
            found[-1] = (found[-1][0], seed)
        else:
            found.append((seed, seed))
    return found


def seeds_text(seeds: Iterable[int]) -> str:
    """Name seeds.

    >>> seeds_text([7, 3, 1, 2])
    '1 to 3, 7'
    """
    return ", ".join(
        str(first) if first == last else f"{first} to {last}" for first, last in seed_ranges(seeds)
    )


def same_seeds(frame: Frame) -> bool:
    """Tell whether every row of :func:`score_table` is of the same seeds."""
    keys = [key for key in ("controller", "feed", "cop_input", "severity") if key in frame]
    return len({frozenset(seeds) for _, seeds in frame.groupby(keys, sort=False)["seed"]}) <= 1


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
    own, drifting, true = _on_common_seeds(frame, feed, severity)
    if not len(own):
        raise ValueError(f"No seed was run with 'true', 'none' and '{feed}' at severity {severity:g}.")
    draws = np.random.default_rng(0).integers(len(own), size=(RESAMPLES, len(own)))
    won: NDArray[np.float64] = (own - drifting)[draws].mean(axis=1) / (true - drifting)[draws].mean(axis=1)
    low, high = np.quantile(won, [0.025, 0.975])
    return float((own - drifting).mean() / (true - drifting).mean()), float(low), float(high)


def _on_common_seeds(frame: Frame, feed: str, severity: float) -> list[NDArray[np.float64]]:
    """Returns with a feed, with drifting feet and with true ones, of the seeds that all three have."""
    runs = [_returns(frame, Run(name), severity) for name in (feed, "none", "true")]
    common = runs[0].index.intersection(runs[1].index).intersection(runs[2].index)
    return [run[common].to_numpy() for run in runs]


def score_table(frame: Frame, name: str = "policy", title: str = "Feet of different kinds") -> Table:
    """Lay an evaluation out: a row for each controller, feed, what was done to it, and severity.

    Args:
        frame: Of :func:`episodes_frame`. Where there is but one controller, it has no column.
        name: Of the table.
        title: Of the table.
    """
    rows: list[tuple[str, ...]] = []
    if same_seeds(frame):
        means = f"Means of {frame['seed'].nunique()} paired episodes"
    else:
        means = "Means of as many episodes as 'falls' says, not of the same seeds in all rows,"
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
        f"{means} with 95 % intervals; 'loss won back' only where drifting feet cost something beyond the "
        f"interval; of fewer than {FEW_FALLS} falls the shortest and the longest time.",
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
                _times_to_fall(part.loc[part["fell"], "time"]),
                with_interval(part["cop_error"], 1e3),
                with_interval(part["tracking"], 1e3),
            )
        )
    return rows


def _times_to_fall(times: "pd.Series[float]") -> str:
    """Write a mean with its interval, or of few falls the shortest and the longest."""
    if len(times) >= FEW_FALLS or len(times) < 2:
        return with_interval(times)
    return f"{number(times.min(), 3)} to {number(times.max(), 3)}"


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
    if feed in ("true", "none"):
        return None
    _, drifting, true = _on_common_seeds(frame, feed, severity)
    loss = mean_interval(true - drifting)
    return loss_won_back(frame, feed, severity) if loss.apart and loss.mean > 0.0 else None


def survival(frame: Frame, feed: str = "true") -> float:
    """Share of the episodes of a feed, as it was felt, that did not end in a fall."""
    part = frame[(frame["feed"] == feed) & (frame["cop_input"] == "felt")]
    return float(1.0 - part["fell"].mean())
