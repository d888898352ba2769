"""The experiment of the in-situ paper, simulated: sensors of many seeds, four ways to calibrate them."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.experiments.in_situ.cases import (
    BATCH,
    KINDS,
    MOTIONS,
    SENSORS,
    compare_motion,
    compare_with_bound,
    exact_errors,
    sweep_and_calibrate,
)
from surefoot.experiments.study.page import save_frames
from surefoot.experiments.study.runner import runner
from surefoot.experiments.study.store import Case, Store
from surefoot.experiments.study.tables import Frame

FRAMES = ("exact", "fits", "sets", "white", "motions")  # the tables of numbers that a study makes
EXACT_RATE = 10.0  # samples per s that are enough without errors


@dataclass(frozen=True)
class InSituStudyOptions:
    """How much the study does; raise ValueError if a number is not positive."""

    out: Path = Path("out/compare-in-situ")
    seeds: int = 50  # sweeps, sensors and IMUs
    jobs: int = 2
    rate: float = 100.0  # samples per s; fast motion takes at least 100
    white_rate: float = 4.0  # of sets with white noise alone, whose samples the bound counts
    moving_seeds: int = 10  # at most, for motions
    kinds: tuple[str, ...] = tuple(KINDS)
    motions: tuple[int, ...] = tuple(range(len(MOTIONS)))
    quick: bool = False  # cut short by :meth:`quickly`

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("seeds", "jobs", "rate", "white_rate", "moving_seeds"):
            if not getattr(self, name) > 0:
                raise ValueError(f"'{name}' must be positive, got {getattr(self, name)!r}.")

    def quickly(self) -> "InSituStudyOptions":
        """Return the same with two seeds at 10 samples a second, to see whether all works."""
        few: dict[str, Any] = {"seeds": min(self.seeds, 2), "moving_seeds": 1}
        return replace(self, **few, rate=10.0, motions=(0, len(MOTIONS) - 1), quick=True)


@dataclass(eq=False)
class InSituStudyResults:
    """Results of the study; the functions of ``cases`` describe the rows of each table."""

    options: InSituStudyOptions
    exact: Frame = field(default_factory=pd.DataFrame)
    fits: Frame = field(default_factory=pd.DataFrame)
    sets: Frame = field(default_factory=pd.DataFrame)
    white: Frame = field(default_factory=pd.DataFrame)
    motions: Frame = field(default_factory=pd.DataFrame)
    shown: Frame = field(default_factory=pd.DataFrame)
    failures: dict[str, str] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)


def study_cases(options: InSituStudyOptions) -> dict[str, list[Case]]:
    """Return the cases of each stage."""
    rate = options.rate
    batches, moving = _batches(options.seeds), _batches(min(options.seeds, options.moving_seeds))

    def name_cases(run: Any, arguments: list[tuple[Any, ...]]) -> list[Case]:
        return [Case(f"{run.__name__}{given}", run, given) for given in arguments]

    return {
        "sensors without error": name_cases(exact_errors, [(s, min(rate, EXACT_RATE)) for s in SENSORS]),
        "sweep and calibrate": name_cases(sweep_and_calibrate, [(batch, rate) for batch in batches]),
        "compare with the bound": name_cases(
            compare_with_bound, [(b, kind, options.white_rate) for kind in options.kinds for b in batches]
        ),
        "compare motions": name_cases(
            compare_motion, [(i, b, rate) for i in options.motions for b in moving]
        ),
    }


def run_in_situ_study(options: InSituStudyOptions) -> InSituStudyResults:
    """Do everything but the page, and save it; StudyError if the folder is in use or the disk full."""
    results = InSituStudyResults(options)
    stages = study_cases(options)
    cases = [case for of_stage in stages.values() for case in of_stage]
    store = Store(options.out / "results")
    with store.open_for(), runner(options.jobs, results.seconds) as run:
        for stage, listed in stages.items():
            run.run(stage, listed, store)
    for name in (*FRAMES, "shown"):
        setattr(results, name, store.rows(name, cases))
    results.failures = store.failures(cases)
    save_frames(options.out / "tables", {name: getattr(results, name) for name in FRAMES}, (".csv",))
    return results


def _batches(count: int) -> list[tuple[int, ...]]:
    return [tuple(range(first, min(first + BATCH, count))) for first in range(0, count, BATCH)]
