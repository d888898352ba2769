"""One episode again, from its row alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surefoot.experiments.episodes.episode import OUTCOME, TABLE, VERSIONS, Episode, failed_row
from surefoot.experiments.episodes.rows import read_rows
from surefoot.experiments.episodes.run import case_of
from surefoot.experiments.study.runner import attempt


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
        """What was run with then and is another now, in words."""
        changed = [name for name in VERSIONS if self.then[name] != self.now[name]]
        return tuple(f"{name} {self.then[name]} -> {self.now[name]}" for name in changed)


def replay_episode(path: Path, number: int) -> Replayed:
    """Run an episode of a study's folder, or of its table, again and compare it with its row.

    Raises:
        ValueError: If there are no results, or none of this episode, or an earlier version wrote them.
    """
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
    now = failed_row(episode, outcome.error) if outcome.error else outcome.tables[TABLE][0]
    return Replayed(episode, then, now)


def _same(one: Any, other: Any) -> bool:
    both_nan: bool = one != one and other != other
    return both_nan or bool(one == other)
