"""Run the episodes of a plan that are not there yet, one again from its row; and read rows, or refuse them.

Each row names its episode and the versions that made it: no policy's file is read again for it.
"""

from collections.abc import Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd

from surefoot.experiments.episodes.episode import (
    COP_INPUTS,
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
from surefoot.experiments.policy.tasks import TASKS
from surefoot.experiments.study.page import save_frames
from surefoot.experiments.study.progress import working
from surefoot.experiments.study.runner import attempt, runner
from surefoot.experiments.study.sources import own_code
from surefoot.experiments.study.store import PLAN, Case, Store
from surefoot.experiments.study.tables import Column, Frame
from surefoot.experiments.walks.walkers import FEEDS


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
    plan: EpisodePlan,
    folder: Path | None = None,
    *,
    backend: str = "",
    jobs: int = 1,
    address: str | None = None,
    retry_failed: bool = False,
    any_version: bool = False,
) -> EpisodeResults:
    """Run every episode of a plan that has no row yet, seed by seed, keep them in a folder, or nowhere.

    Backend, jobs and address are those of :func:`~surefoot.experiments.study.backends.workers`. Raises
    ValueError if something is refused before anything is run, StudyError if the folder cannot be used, the
    disk is full, or a worker runs other software.
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
            kept = (store.holds(case, retry_failed=retry_failed, any_version=True) for case in cases)
            any_version |= all(kept)
        options = {"retry_failed": retry_failed, "any_version": any_version}
        stack.enter_context(store.open_for(plan.as_dict(), versions(), any_version=any_version))
        missing = [case for case in cases if not store.holds(case, **options)]
        computed = 0
        if missing:
            with working("trying out each kind"):
                _try_out([case.arguments[0] for case in missing])
            crew = stack.enter_context(runner(jobs, backend=backend, address=address))
            computed = crew.run(
                "Episodes", cases, store, failed=_on_failure, count={"fell": _fell}, **options
            )
        rows = store.rows(TABLE, cases).sort_values("case", ignore_index=True)
        save_frames(folder, {TABLE: rows}, (".parquet",))
        return EpisodeResults(plan, folder, rows, computed)


def case_of(episode: Episode) -> Case:
    """Return an episode as a case of a study."""
    depends = "".join((episode.to_json(), *own_code(episode.feed, episode.cells)))
    return Case(f"episode {episode.number}", run_case, (episode,), depends=depends)


def _on_failure(case: Case, error: str) -> dict[str, list[dict[str, Any]]]:
    return {TABLE: [row_of_failure(case.arguments[0], error)]}


def _fell(outcome: Any) -> bool:
    return any(row["fell"] for row in outcome.tables.get(TABLE, ()))


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
        """Names of the outcomes that came out otherwise, in any digit."""
        return tuple(name for name in (*OUTCOME, "error") if not _same(self.then[name], self.now[name]))

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

_UNNAMED = "policy"  # what a controller is called that nobody named

_KNOWN: Mapping[str, Collection[str]] = {
    "controller": (),
    "feed": FEEDS,
    "cop_input": COP_INPUTS,
    "scenario": TASKS,
}
"""Columns that hold names, and the names that there are; none where any will do."""

_USUAL = "a finite number and not negative"

_NUMBERS = {
    "severity": _USUAL,
    "seed": "a whole number from 0",
    "return": "a finite number",
    "fell": "true or false",
    "time": _USUAL,
    "cop_error": _USUAL,
    "tracking": _USUAL,
}
"""Columns that hold numbers, and what these must be. Errors of a CoP that was never felt are none, though."""


@dataclass(frozen=True)
class Origin:
    """The facts of a controller whose episodes are there; nothing where nobody wrote it down."""

    file: str = ""  # hash of the file behind it when it was run
    trained: str = ""  # on what
    versions: str = ""  # with what it was run
    runs: bool = True  # under its name: other names were made up for a file of episodes


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
        raise ValueError(f"'{path}' is no table of Parquet, or is damaged: {error}.") from error


def read_episodes(path: Path, controller: str = "") -> Frame:
    """Return checked episodes in order, without failures, perhaps renamed; ValueError names the column."""
    frame = read_rows(path)
    if "error" in frame:
        frame = frame[frame["error"] == ""]
    if missing := [name for name in (*_KNOWN, *_NUMBERS) if name not in frame]:
        raise ValueError(f"'{path}' is no table of episodes: it lacks the column '{missing[0]}'.")
    frame = frame.assign(
        **{name: _names(path, frame[name]) for name in _KNOWN},
        **{name: _numbers(path, frame[name]) for name in _NUMBERS},
    )
    frame = _with_origin(frame.assign(controller=frame["controller"].replace("", _UNNAMED)))
    held = controllers_of(frame)
    if controller and len(held) > 1:
        raise ValueError(
            f"'{path}' holds episodes of {', '.join(held)}, which cannot all be called '{controller}'; give "
            "the file without a name."
        )
    return in_order(frame.assign(controller=controller, runs=False) if controller else frame)


def in_order(frame: Frame, controllers: Sequence[str] = ()) -> Frame:
    """Return episodes sorted: controllers as they come or are named, feeds from the true one on, ..."""
    ranks = {
        "controller": list(dict.fromkeys((*controllers, *frame["controller"]))),
        "feed": list(dict.fromkeys((*FEEDS, *frame["feed"]))),
        "cop_input": list(COP_INPUTS),
    }

    def rank(column: Column) -> Column:
        order = ranks.get(str(column.name))
        return column if order is None else column.map(order.index)

    return frame.sort_values([*ranks, "severity", "seed"], key=rank, ignore_index=True)


def origins_of(frame: Frame) -> dict[str, Origin]:
    """Origin of each controller; ValueError if one was another file in some episodes."""
    frame = frame if "runs" in frame else _with_origin(frame)
    return {name: _origin(name, frame[frame["controller"] == name]) for name in controllers_of(frame)}


def _origin(controller: str, own: Frame) -> Origin:
    files, trained = set(own["controller_hash"]), set(own["trained"])
    if len(files - {""}) > 1:
        raise ValueError(
            f"'{controller}' is not the same file everywhere: it was changed between one evaluation and the "
            "next; give controllers of different files different names, NAME=FILE."
        )
    return Origin(
        files.pop() if len(files) == 1 else "",
        trained.pop() if len(trained) == 1 else "",
        "; ".join(dict.fromkeys(versions for versions in own["versions"] if versions)),
        bool(own["runs"].all()),
    )


def _with_origin(frame: Frame) -> Frame:
    """Return rows with the columns ``controller_hash``, ``trained``, ``versions`` and ``runs``."""
    made = pd.Series("", index=frame.index)
    if set(VERSIONS) <= set(frame):
        made = frame[list(VERSIONS)].apply(lambda row: ", ".join(f"{k} {v}" for k, v in row.items()), axis=1)
    absent = {name: "" for name in ("controller_hash", "trained") if name not in frame}
    return frame.assign(**absent, versions=made, runs=frame["controller"] != _UNNAMED)


def _names(path: Path, column: Column) -> Column:
    """Return one column of names, or raise ValueError."""
    if wrong := [value for value in column if not isinstance(value, str)]:
        raise ValueError(
            f"'{path}' is no table of episodes: its column '{column.name}' holds {wrong[0]!r} and not a name."
        )
    known = _KNOWN[column.name]
    if known and (unknown := sorted(name for name in set(column) - set(known) if ":" not in name)):
        raise ValueError(f"'{path}' holds the {column.name} '{unknown[0]}'. Known: {', '.join(known)}.")
    return pd.Series(list(column), index=column.index)


def _numbers(path: Path, column: Column) -> Column:
    """Return one column of numbers as the type that a fresh one has, or raise ValueError."""
    name = str(column.name)
    if not pd.api.types.is_numeric_dtype(column):
        raise ValueError(f"'{path}' is no table of episodes: its column '{name}' holds no numbers.")
    values = column.to_numpy(dtype=np.float64, na_value=np.nan)
    fine = np.isfinite(values) | (np.isnan(values) & (name in ("cop_error", "tracking")))
    if name != "return":
        fine &= ~(values < 0.0)
    if name == "seed":
        fine &= values == np.floor(values)
    if name == "fell":
        fine &= np.isin(values, (0.0, 1.0))
    if not fine.all():
        wrong = f"{values[~fine][0]:g} in its column '{name}', which must be {_NUMBERS[name]}"
        raise ValueError(f"'{path}' holds {wrong}.")
    kinds: Mapping[str, type[np.generic]] = {"seed": np.int64, "fell": np.bool_}
    return pd.Series(values.astype(kinds.get(name, np.float64)), index=column.index)
