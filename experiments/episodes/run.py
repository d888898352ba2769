"""Run the episodes of a plan that are not there yet, one again from its row; and read rows, or refuse them.

Each row names its episode and the versions that made it: no policy's file is read again for it.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from surefoot.experiments.episodes.episode import (
    OUTCOME,
    TABLE,
    VERSIONS,
    Episode,
    check_episode,
    row_of_failure,
    run_case,
    versions,
)
from surefoot.experiments.episodes.plan import EpisodePlan
from surefoot.experiments.episodes.scores import controllers_of
from surefoot.experiments.study.page import save_frames
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.runner import attempt, runner
from surefoot.experiments.study.sources import own_code
from surefoot.experiments.study.store import PLAN, Case, Store
from surefoot.experiments.study.tables import Column, Frame
from surefoot.experiments.walks.walkers import FEEDS, check_feed


@dataclass(frozen=True, eq=False)
class EpisodeResults:
    """The results of a study, a row an episode, and how many this run added; a temporary folder is gone."""

    plan: EpisodePlan
    folder: Path
    rows: Frame
    computed: int

    @property
    def failed(self) -> Frame:
        """The rows of episodes that could not be run through."""
        return self.rows[self.rows["error"] != ""]

    @property
    def finished(self) -> Frame:
        """The rows of all others."""
        return self.rows[self.rows["error"] == ""]


def run_plan(
    plan: EpisodePlan, folder: Path | None = None, *, jobs: int = 1, any_version: bool = False
) -> EpisodeResults:
    """Run every episode of a plan that has no row yet, seed by seed, keep them in a folder, or nowhere.

    Raises ValueError if something is refused before anything is run, StudyError if the folder cannot be used,
    the disk is full, or the code is changed meanwhile.
    """
    with ExitStack() as stack:
        if folder is None:
            folder = Path(stack.enter_context(TemporaryDirectory()))
        # Seed by seed: what is there of a study that was stopped is paired.
        cases = [case_of(episode) for episode in sorted(plan.episodes, key=lambda episode: episode.seed)]
        store = Store(folder)
        if (folder / PLAN).is_file():
            store.read()
            # What is whole is not run again, whatever made it.
            any_version |= all(store.holds(case, any_version=True) for case in cases)
        stack.enter_context(store.open_for(plan.as_dict(), versions(), any_version=any_version))
        missing = [case for case in cases if not store.holds(case, any_version=any_version)]
        computed = 0
        if missing:
            with working("trying out each kind"):
                _try_out([case.arguments[0] for case in missing])
            crew = stack.enter_context(runner(jobs))
            computed = crew.run(
                "Episodes",
                cases,
                store,
                failed=lambda case, error: {TABLE: [row_of_failure(case.arguments[0], error)]},
                count={"fell": lambda outcome: any(row["fell"] for row in outcome.tables.get(TABLE, ()))},
                any_version=any_version,
            )
        rows = store.rows(TABLE, cases).sort_values("case", ignore_index=True)
        save_frames(folder, {TABLE: rows}, (".parquet",))
        return EpisodeResults(plan, folder, rows, computed)


def case_of(episode: Episode) -> Case:
    """Return an episode as a case of a study."""
    depends = "".join((episode.to_json(), *own_code(episode.feed, episode.cells)))
    return Case(f"episode {episode.number}", run_case, (episode,), depends=depends)


def _try_out(episodes: list[Episode]) -> None:
    """Raise ValueError at a scenario or a controller that cannot even be made: here, and not one by one."""
    hardest = sorted(episodes, key=lambda episode: episode.severity)
    # The last of a kind stays: of each scenario and of each controller the episode with the worst feet.
    kinds = {(name, getattr(e, name)): e for e in hardest for name in ("scenario", "controller")}
    tried = {episode.number: episode for episode in kinds.values()}
    for number in sorted(tried):
        check_episode(tried[number])


@dataclass(frozen=True)
class Replayed:
    """An episode, its row in the results, and the row of its repetition."""

    episode: Episode
    then: Mapping[str, Any]
    now: Mapping[str, Any]

    @property
    def different(self) -> tuple[str, ...]:
        """Names of the outcomes that came out otherwise, in any digit; of errors the last line counts."""
        changed = [name for name in OUTCOME if not _same(self.then[name], self.now[name])]
        last = {str(row["error"]).strip().rpartition("\n")[2] for row in (self.then, self.now)}
        return (*changed, *(["error"] if len(last) > 1 else []))

    @property
    def other_versions(self) -> tuple[str, ...]:
        """Versions that differ between then and now, in words."""
        changed = [name for name in VERSIONS if self.then[name] != self.now[name]]
        return tuple(f"{name} {self.then[name]} -> {self.now[name]}" for name in changed)


def replay_episode(path: Path, number: int) -> Replayed:
    """Run an episode of a folder or table again and compare it with its row; ValueError if none."""
    frame = read_rows(path)
    if missing := [name for name in ("case", "spec", *OUTCOME, *VERSIONS) if name not in frame]:
        raise ValueError(
            f"'{path}' lacks the column '{missing[0]}': it is no table of episodes, or an earlier version of "
            "surefoot wrote it, which can replay it."
        )
    found = frame[frame["case"] == number]
    if not len(found):
        raise ValueError(
            f"There is no case {number} in '{path}'; it has {len(frame)}, from {frame['case'].min()} to "
            f"{frame['case'].max()}."
        )
    then = found.iloc[0].to_dict()
    episode = Episode.from_json(then["spec"])
    # Whatever goes wrong in it is part of the row.
    outcome = attempt(case_of(episode))
    now = row_of_failure(episode, outcome.error) if outcome.error else outcome.tables[TABLE][0]
    return Replayed(episode, then, now)


def _same(one: Any, other: Any) -> bool:
    both_nan: bool = one != one and other != other
    return both_nan or bool(one == other)


EPISODES = f"{TABLE}.parquet"

_UNNAMED = "policy"  # name of a controller that nobody named

NEEDED = ("controller", "feed", "scenario", "severity", "seed", "return", "fell", "time")
"""Columns of an episode that a page needs, besides errors, which may be missing."""


def read_rows(path: Path) -> Frame:
    """Return the rows of a study, also if under way, from its folder or table; ValueError if none."""
    if (path / PLAN).is_file():
        store = Store(path)
        store.read()
        frame = store.rows(TABLE)
        if len(frame):
            return frame
        if not (path / EPISODES).is_file():
            raise ValueError(f"'{path}' holds no episodes yet; the command that writes some goes on there.")
    path = path / EPISODES if path.is_dir() else path
    if not path.is_file():
        raise ValueError(
            f"There is no file of episodes '{path}'; 'surefoot evaluate' and 'surefoot sweep' write one."
        )
    try:
        return pd.read_parquet(path)
    except Exception as error:  # Whatever a damaged file raises.
        raise ValueError(
            f"'{path}' is no table of Parquet, or is damaged: {str(error).rstrip('.')}."
        ) from error


def read_episodes(path: Path, controller: str = "") -> Frame:
    """Return episodes in order, without failures, perhaps renamed; ValueError if a column is missing."""
    frame = read_rows(path)
    if "error" in frame:
        frame = frame[frame["error"] == ""]
    if missing := [name for name in (*NEEDED, "cop_error", "tracking") if name not in frame]:
        raise ValueError(f"'{path}' is no table of episodes: it lacks the column '{missing[0]}'.")
    for name in NEEDED[3:]:
        if not (pd.to_numeric(frame[name], errors="coerce") > -np.inf).all():
            raise ValueError(f"'{path}' is no table of episodes: column '{name}' holds what is no number.")
    for feed in frame["feed"].unique():
        check_feed(str(feed))
    frame = frame.assign(controller=frame["controller"].replace("", _UNNAMED))
    held = controllers_of(frame)
    if controller and len(held) > 1:
        raise ValueError(
            f"'{path}' holds episodes of {', '.join(held)}, which cannot all be called '{controller}'; give "
            "the file without a name."
        )
    return sort_episodes(frame.assign(controller=controller) if controller else frame)


def sort_episodes(frame: Frame, controllers: Sequence[str] = ()) -> Frame:
    """Return episodes sorted: controllers as they come or are named, feeds from the true one on, ..."""
    ranks = {
        "controller": list(dict.fromkeys((*controllers, *frame["controller"]))),
        "feed": list(dict.fromkeys((*FEEDS, *frame["feed"]))),
    }

    def rank(column: Column) -> Column:
        order = ranks.get(str(column.name))
        return column if order is None else column.map(order.index)

    return frame.sort_values([*ranks, "severity", "seed"], key=rank, ignore_index=True)
