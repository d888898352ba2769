"""Made episodes of an evaluation."""

from typing import Any

import numpy as np
import pandas as pd

from surefoot.experiments.episodes.episode import VERSIONS
from surefoot.experiments.episodes.run import sort_episodes

MEANS = {"true": 100.0, "none": 50.0, "quasi-static": 70.0, "window": 80.0, "moment": 97.0}
TRAINED = {"clean": "true", "wild": "randomised"}


def episodes(controller="clean", means=MEANS, severities=(1.0, 2.0), fell=0, seeds=20):
    """Episodes whose returns differ by seed, alike for all feeds, and by little besides."""
    rng = np.random.default_rng(7)
    base, rows = rng.normal(0.0, 5.0, seeds), []
    for feed, mean in means.items():
        for severity in severities[:1] if feed == "true" else severities:
            for seed, total in enumerate(mean + base + rng.normal(0.0, 0.5, seeds)):
                rows.append(row(feed, seed, total, controller, severity, fell=seed < fell))
    return rows


def row(
    feed: str, seed: int, total: float, controller="clean", severity=1.0, *, fell=False
) -> dict[str, Any]:
    """A row as an evaluation makes it."""
    made_with = dict.fromkeys(VERSIONS, "9") | {"controller_hash": controller, "error": ""}
    which = {"controller": controller, "feed": feed, "scenario": "balance"}
    which |= {"severity": 0.0 if feed == "true" else severity, "seed": seed}
    outcome = {
        "return": total,
        "fell": fell,
        "time": 9.0 if fell else 18.0,
        "cop_error": 0.01,
        "tracking": 0.02,
    }
    return which | outcome | made_with | {"trained": TRAINED.get(controller, "")}


def frame_of(*parts):
    return sort_episodes(pd.DataFrame([result for part in parts for result in part]))
