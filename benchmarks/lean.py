"""Evaluate the leaning G1, and compare training on drifting feet with calibrating them.

    python benchmarks/lean.py --out out/lean

The script trains the policies that the folder lacks (five per kind of feet), evaluates them by
:func:`surefoot.evaluate` on seeds that no training had, and writes three tables into ``docs/data/lean`` and a
figure into ``docs/images``. The same command continues a run that was stopped.

=============  =========================================================================================
table          content
=============  =========================================================================================
``feeds``      policies on true, raw and calibrated feet, and policies that use no feet
``share``      largest share of the support that is reached with at most 5 % falls
``randomise``  policies trained on true, drifting and no feet, each on drifting and on calibrated feet
=============  =========================================================================================
"""

import argparse
import json
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

import surefoot
from surefoot import evaluate
from surefoot.envs.g1.lean import MOVE, STAY
from surefoot.experiments.evaluate.statistics import RAW, TRUE, Run, difference, mean_over, returns_of
from surefoot.experiments.policy.imitate import POLICY, Imitation, imitate
from surefoot.experiments.study.figures import figure_at
from surefoot.experiments.study.statistics import fall_share
from surefoot.experiments.study.tables import Frame

ENV = "surefoot/G1Lean-v0"
TRAININGS = 5
NAMES = {
    "true": "true feet",
    "blind": "no feet",
    "randomised": "drifting feet",
    "history": "drifting feet with traces",
    "zero": "nobody acts",
}
"""What policies were trained on, in words."""

TRACES = "surefoot.experiments.policy.view:Traces"
CALIBRATED = ("tare", "window", "moment")
SHARES, WAIT = (
    np.round(np.linspace(0.65, 1.0, 8), 2),
    4.0,
)  # shares of one episode, and s before its first move
MOST_FALLS = 0.05
ROOT = Path(__file__).parents[1]


def train_missing(out: Path, arm: str) -> list[str]:
    """Return the policy files of an arm, after training those that are missing."""
    folders = [out / f"{arm}-{seed}" for seed in range(TRAININGS)]
    for seed, folder in enumerate(folders):
        if not (folder / POLICY).is_file():
            print(f"Training {folder.name}", flush=True)
            imitate(folder, Imitation(sensors=arm, seed=seed))
    return [str(folder / POLICY) for folder in folders]


def run(out: Path, seeds: int) -> dict[str, Frame]:
    """Return the episodes of each part of the study; the last four parts have half as many."""

    def part(name: str, arm: str, feeds: Sequence[str], severities: Sequence[float], **more: Any) -> Any:
        print(f"Evaluating {name}", flush=True)
        policy = {arm: "zero" if arm == "zero" else train_missing(out, arm)}
        given = {"seeds": seeds, **more}
        rows = evaluate(ENV, policy, feeds=feeds, severities=severities, out=out / name, **given).rows
        return rows[rows["error"] == ""]

    half: dict[str, Any] = {"seeds": max(seeds // 2, 1)}
    far = {**half, "env_options": {"share": (SHARES[0], SHARES[-1]), "reaches": len(SHARES)}}
    return {
        "feet": part("feet", "true", (TRUE, RAW, *CALIBRATED), (1.0, 2.0, 3.0)),
        "blind": part("blind", "blind", (TRUE,), (2.0,)),
        "nobody": part("nobody", "zero", (TRUE,), (2.0,), seeds=seeds * TRAININGS),
        "share": part("share", "true", (TRUE, RAW, "tare", "moment"), (2.0,), **far),
        "share blind": part("share-blind", "blind", (TRUE,), (2.0,), **far),
        "randomised": part("randomised", "randomised", (TRUE, RAW, "moment"), (2.0,), **half),
        "history": part("history", "history", (TRUE, RAW, "moment"), (2.0,), wrap=TRACES, **half),
    }


def score_table(rows: Frame) -> Frame:
    """Return one row per policy, feed and severity; differences are from the policy on true feet."""
    best, table = Run("true", TRUE, 0.0), []
    for (policy, feed, severity), group in rows.groupby(["policy", "feed", "severity"], sort=False):
        own = Run(policy, feed, severity)
        mean, falls = mean_over(returns_of(rows, own)), fall_share(group["fell"])
        less = None if own == best else difference(rows, best, own)
        cell = {
            "policy": NAMES[policy],
            "feet": "-" if policy in ("blind", "zero") else feed,
            "severity": "-" if feed == TRUE else f"{severity:g}",
            "return": f"{mean.mean:.3f} ± {mean.half:.3f}",
            "below true feet": "" if less is None else f"{less.mean:.3f} ± {less.half:.3f}",
            "falls": f"{group['fell'].sum()} of {len(group)}",
            "falls / %": f"{100 * falls.low:.0f} to {100 * falls.high:.0f}",
            "CoP error / mm": f"{1e3 * group['cop_error'].mean():.1f}",
        }
        table.append(cell)
    return pd.DataFrame(table)


def falls_by_share(rows: Frame) -> NDArray[np.bool_]:
    """Return for each episode and share whether the robot has fallen up to it, shape (episodes, shares)."""
    reach = np.floor((rows["time"].to_numpy() - WAIT) / (MOVE + STAY))
    at = np.where(rows["fell"], np.clip(reach, 0, len(SHARES) - 1), len(SHARES))
    fallen: NDArray[np.bool_] = np.arange(len(SHARES)) >= at[:, None]
    return fallen


def largest_share(fallen: NDArray[np.bool_]) -> float:
    """Return the largest share with at most 5 % falls; 0 if there are more at the smallest one."""
    allowed = np.flatnonzero(fallen.mean(axis=0) <= MOST_FALLS)
    return float(SHARES[allowed[-1]]) if len(allowed) else 0.0


def share_table(rows: Frame) -> Frame:
    """Return the largest share of each policy and feed, with its bootstrap interval over seeds."""
    rng, table = np.random.default_rng(0), []
    for (policy, feed), group in rows.groupby(["policy", "feed"], sort=False):
        fallen, seeds = falls_by_share(group), group["seed"].to_numpy()
        of_seed = [fallen[seeds == seed] for seed in np.unique(seeds)]
        draws = rng.integers(len(of_seed), size=(2000, len(of_seed)))
        found = [largest_share(np.concatenate([of_seed[i] for i in draw])) for draw in draws]
        low, high = np.quantile(found, [0.025, 0.975], method="nearest")
        cell = {"policy": NAMES[policy], "feet": "-" if policy == "blind" else feed}
        cell["largest share"] = f"{largest_share(fallen):.2f} ({low:.2f} to {high:.2f})"
        for share, falls in zip(SHARES, fallen.mean(axis=0), strict=True):
            cell[f"fallen at {share:.2f} / %"] = f"{100 * falls:.0f}"
        table.append({**cell, "episodes": str(len(group))})
    return pd.DataFrame(table)


def draw_shares(rows: Frame, path: Path) -> None:
    """Draw the share of falls against the share of the support."""
    looks = {
        ("true", TRUE): ("true feet", "#009E73"),
        ("true", "moment"): ("calibrated (moment)", "#0072B2"),
        ("true", "tare"): ("tared in swing", "#E69F00"),
        ("true", RAW): ("raw", "#D55E00"),
        ("blind", TRUE): ("no feet", "#808080"),
    }
    with figure_at(path, 6.4, 3.6) as figure:
        axes = figure.subplots()
        for (policy, feed), (label, colour) in looks.items():
            group = rows[(rows["policy"] == policy) & (rows["feed"] == feed)]
            falls = 100.0 * falls_by_share(group).mean(axis=0)
            axes.plot(100.0 * SHARES, falls, label=label, color=colour, marker="o", markersize=3)
        axes.axhline(100.0 * MOST_FALLS, color="#808080", linewidth=0.8, linestyle=":")
        axes.set(xlabel="share of the support that is used / %", ylabel="robots that have fallen / %")
        axes.legend(frameon=False)


def main() -> None:
    """Train, evaluate, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/lean"))
    parser.add_argument("--seeds", type=int, default=10, help="episodes of each of the five trainings")
    parser.add_argument("--tables", type=Path, default=ROOT / "docs" / "data" / "lean")
    parser.add_argument("--figure", type=Path, default=ROOT / "docs" / "images" / "lean.png")
    asked = parser.parse_args()
    parts = run(asked.out, asked.seeds)
    arms: Frame = pd.concat([parts[name] for name in ("feet", "blind", "randomised", "history")])
    compared = arms["severity"].isin((0.0, 2.0)) & arms["feed"].isin((TRUE, RAW, "moment"))
    shares: Frame = pd.concat([parts["share"], parts["share blind"]])
    tables = {
        "feeds": score_table(pd.concat([parts["feet"], parts["blind"], parts["nobody"]])),
        "share": share_table(shares),
        "randomise": score_table(arms[compared]),
    }
    asked.tables.mkdir(parents=True, exist_ok=True)
    for name, table in tables.items():
        table.to_csv(asked.tables / f"{name}.csv", index=False)
        print(f"\n{name}\n{table.to_string(index=False)}")
    software = f"surefoot {surefoot.__version__}"
    made = {"command": "python benchmarks/lean.py", "software": software, "date": str(date.today())}
    (asked.tables / "made.json").write_text(json.dumps(made, indent=2) + "\n")
    draw_shares(shares, asked.figure)


if __name__ == "__main__":
    main()
