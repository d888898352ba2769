"""The experiment of the in-situ paper, simulated: sensors of many seeds, three ways to calibrate them.

Everything lands in one folder: tables, figures, ``results.json`` and the page. Pieces that are finished are
kept under the hash of all that made them, so that a run that was interrupted goes on where it was.
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import joblib
import pandas as pd
from rich.console import Console

from surefoot.experiments.in_situ.refusals import CASES, refusal_row
from surefoot.experiments.in_situ.study_pieces import (
    BATCH,
    KINDS,
    MOTIONS,
    SENSORS,
    Shown,
    exact_piece,
    motion_piece,
    sweep_piece,
    white_piece,
)
from surefoot.experiments.study.files import atomic_path, write_text
from surefoot.experiments.study.runner import machine, runner
from surefoot.experiments.study.sources import source_hash
from surefoot.experiments.study.tables import Frame

__all__ = ["InSituStudyOptions", "InSituStudyResults", "run_in_situ_study"]

_SOURCES = tuple(f"surefoot.experiments.in_situ.{name}" for name in ("study_pieces", "refusals"))
"""What decides what a piece finds."""


@dataclass(frozen=True)
class InSituStudyOptions:
    """How much the study does.

    Attributes:
        out: Folder for everything that is made.
        seeds: Number of sweeps, sensors and IMUs; the seeds are 0, 1, ...
        jobs: Processes that work at the same time.
        rate: Samples per s; fast motion takes at least 100.
        moving_seeds: Seeds at most for which motions are compared.
        refused_seeds: Seeds at most that the spoilt experiments are tried on.
        motions: Which of MOTIONS are compared, by their places.
        quick: Whether it was cut short by :meth:`quickly`.

    Raises:
        ValueError: If a number is not positive.
    """

    out: Path = Path("out/in-situ-study")
    seeds: int = 50
    jobs: int = 2
    rate: float = 100.0
    moving_seeds: int = 10
    refused_seeds: int = 3
    motions: tuple[int, ...] = tuple(range(len(MOTIONS)))
    quick: bool = False

    def __post_init__(self) -> None:
        """Refuse what cannot be done."""
        for name in ("seeds", "jobs", "rate", "moving_seeds", "refused_seeds"):
            if not getattr(self, name) > 0:
                raise ValueError(f"'{name}' must be positive, got {getattr(self, name)!r}.")

    def quickly(self) -> "InSituStudyOptions":
        """The same with two seeds at 10 samples a second, to see whether all works."""
        return replace(
            self,
            seeds=min(self.seeds, 2),
            rate=10.0,
            moving_seeds=1,
            refused_seeds=1,
            motions=(0, len(MOTIONS) - 1),
            quick=True,
        )


@dataclass(eq=False)
class InSituStudyResults:
    """What the study found.

    Attributes:
        options: How it was run.
        exact: A row a sensor: the paper's method without an error of the sensor.
        fits: A row a sensor, seed and method.
        sets: A row a set that was not fitted, by sensor, seed and method.
        white: A row a sensor, seed and kind of sensor: errors beside their bound and the claimed covariance.
        motions: A row a sensor, seed and motion.
        refusals: A row a spoilt experiment and seed.
        shown: What figures show.
        seconds: Time that each stage took in s.
        machine: What it ran on.
    """

    options: InSituStudyOptions
    exact: Frame = field(default_factory=pd.DataFrame)
    fits: Frame = field(default_factory=pd.DataFrame)
    sets: Frame = field(default_factory=pd.DataFrame)
    white: Frame = field(default_factory=pd.DataFrame)
    motions: Frame = field(default_factory=pd.DataFrame)
    refusals: Frame = field(default_factory=pd.DataFrame)
    shown: tuple[Shown, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    machine: str = ""

    @property
    def frames(self) -> dict[str, Frame]:
        """All tables of figures, by name."""
        names = ("exact", "fits", "sets", "white", "motions", "refusals")
        return {name: getattr(self, name) for name in names}


def run_in_situ_study(options: InSituStudyOptions, *, console: Console | None = None) -> InSituStudyResults:
    """Do everything but the page.

    Args:
        options: How much.
        console: Where progress is shown; the terminal's error output by default.

    Returns:
        What was found; it is in files under ``options.out`` as well.
    """
    results = InSituStudyResults(options, machine=machine())
    seeds = _batches(options.seeds)
    moving = _batches(min(options.seeds, options.moving_seeds))
    # Once for all: what is imported now is what will run.
    sources = source_hash(*_SOURCES)
    with runner(options.jobs, results.seconds, console) as stage:

        def run(what: str, function: Callable[..., Any], arguments: list[tuple[Any, ...]]) -> list[Any]:
            folder = options.out / "pieces"
            return stage.do(what, [(_kept, (folder, sources, function, given)) for given in arguments])

        rate = options.rate
        exact = run("sensors without error", exact_piece, [(s, min(rate, 10.0)) for s in SENSORS])
        swept = run("sweep and calibrate", sweep_piece, [(batch, rate) for batch in seeds])
        white = run("hold against the bound", white_piece, [(b, kind) for kind in KINDS for b in seeds])
        moved = run("compare motions", motion_piece, [(i, b, rate) for i in options.motions for b in moving])
        tried = [
            (i, seed, min(rate, 5.0))
            for i in range(len(CASES))
            for seed in range(min(options.seeds, options.refused_seeds))
        ]
        refused = run("spoil experiments", refusal_row, tried)
    results.exact, results.refusals = pd.DataFrame(exact), pd.DataFrame(refused)
    results.fits = pd.concat([fits for fits, _, _ in swept], ignore_index=True)
    results.sets = pd.concat([sets for _, sets, _ in swept], ignore_index=True)
    results.shown = tuple(one for _, _, shown in swept for one in shown)
    results.white = pd.concat(white, ignore_index=True)
    results.motions = pd.concat(moved, ignore_index=True)
    _save(results)
    return results


def _batches(count: int) -> list[tuple[int, ...]]:
    return [tuple(range(first, min(first + BATCH, count))) for first in range(0, count, BATCH)]


def _kept(folder: Path, sources: str, function: Callable[..., Any], given: tuple[Any, ...]) -> Any:
    """Do a piece, or read what came of it before."""
    made_of = repr((function.__name__, given, sources))
    path = folder / f"{function.__name__}_{sha256(made_of.encode()).hexdigest()[:16]}.joblib"
    if path.is_file():
        return joblib.load(path)
    found = function(*given)
    with atomic_path(path) as part:
        joblib.dump(found, part, compress=3)
    return found


def _save(results: InSituStudyResults) -> None:
    out = results.options.out
    for name, frame in results.frames.items():
        with atomic_path(out / "tables" / f"{name}.csv") as part:
            frame.to_csv(part, index=False)
    facts = {
        "options": {k: str(v) if isinstance(v, Path) else v for k, v in asdict(results.options).items()},
        "machine": results.machine,
        "seconds": results.seconds,
    }
    write_text(out / "results.json", json.dumps(facts, indent=1))
