"""An evaluation on the disk: the episodes that were run of it so far.

A folder holds one evaluation. ``evaluation.json`` says which, and with what it was made;
``episodes.parquet`` is replaced as a whole every few seconds and whenever the work ends, however it ends. The
same command goes on where it was stopped.
"""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.experiments.policy.episodes import EPISODES, read_episodes
from surefoot.experiments.policy.evaluate import EpisodeResult
from surefoot.experiments.policy.evaluation import Evaluation
from surefoot.experiments.policy.origin import PLAN, Origin, Plan
from surefoot.experiments.policy.scores import episodes_frame, in_order
from surefoot.experiments.study.files import atomic_path, locked
from surefoot.experiments.study.tables import Frame

__all__ = ["EvaluationFolder"]

EVERY = 10.0
"""Time in s between two replacements of the table, so that a long evaluation does not write all the time."""


class EvaluationFolder:
    """The episodes of one evaluation; use it within :meth:`opened`.

    Args:
        folder: Where they lie; ``None`` keeps them in memory alone.
        evaluation: What is compared.
    """

    def __init__(self, folder: Path | None, evaluation: Evaluation) -> None:
        self.folder = folder
        self.evaluation = evaluation
        self._results: list[EpisodeResult] = []
        self._kept: Frame | None = None
        self._plan = evaluation.plan()

    @contextmanager
    def opened(self) -> Iterator["EvaluationFolder"]:
        """Take the folder for this evaluation, and write down what was added whatever happens.

        The order in which controllers, feeds and severities are named makes no other evaluation.

        Raises:
            ValueError: If it holds another evaluation or files that are damaged, or is in use.
        """
        if self.folder is None:
            yield self
            return
        busy = ValueError(f"Another evaluation is at work in '{self.folder}'; wait for it.")
        with locked(self.folder, busy):
            self._claim(self.folder)
            self._written = time.monotonic()
            try:
                yield self
            finally:
                self._write(self.folder)

    @property
    def origins(self) -> dict[str, Origin]:
        """What is known of each controller."""
        return self._plan.origins()

    @property
    def frame(self) -> Frame:
        """All episodes, see :func:`~surefoot.experiments.policy.scores.in_order`."""
        if not self._results:
            return self._kept
        added = episodes_frame(self._results)
        return added if self._kept is None else in_order(pd.concat([self._kept, added], ignore_index=True))

    @property
    def missing(self) -> int:
        """How many episodes are not there yet."""
        kept = 0 if self._kept is None else len(self._kept)
        return len(self.evaluation) - kept - len(self._results)

    def run(self, jobs: int = 1) -> Iterator[EpisodeResult]:
        """Run what is missing; what is handed out is kept.

        Args:
            jobs: Processes that work at the same time.

        Raises:
            ValueError: If the file behind a controller was changed: its episodes would be those of two.
        """
        for result in self.evaluation.run(self._kept, jobs):
            if (now := self.evaluation.files()) != (files := self._plan.evaluation["files"]):
                changed = next(name for name in files if now[name] != files[name])
                raise ValueError(
                    f"The file behind the controller '{changed}' was changed while it was being evaluated; "
                    "put the old one back, or begin anew in another folder."
                )
            self._results.append(result)
            if self.folder is not None and time.monotonic() - self._written > EVERY:
                self._write(self.folder)
                self._written = time.monotonic()
            yield result

    def _claim(self, folder: Path) -> None:
        plan, table, wanted = folder / PLAN, folder / EPISODES, self._plan
        if not table.is_file() or not plan.is_file():
            if table.is_file():
                raise ValueError(
                    f"'{folder}' holds episodes without an {PLAN}; give another folder with --out, or make a "
                    f"page of them with --page-of {table}."
                )
            wanted.write(plan)
            return
        held = Plan.read(plan)
        names = sorted(wanted.evaluation.keys() | held.evaluation)
        pairs = {name: (held.evaluation.get(name), wanted.evaluation.get(name)) for name in names}
        if other := [
            f"{name} {there} and not {now}" for name, (there, now) in pairs.items() if _differs(there, now)
        ]:
            raise ValueError(
                f"'{folder}' holds another evaluation: {'; '.join(other)}. Give its options to go on, or "
                "another folder with --out."
            )
        self._kept = self.evaluation.own(read_episodes(table), table)
        if held.versions != wanted.versions and self.missing:
            differs = ", ".join(
                f"{name} {held.versions.get(name)}"
                for name, now in wanted.versions.items()
                if held.versions.get(name) != now
            )
            raise ValueError(
                f"'{folder}' was begun with {differs}, which is not what runs now; give another folder with "
                "--out."
            )
        self._plan = Plan(wanted.evaluation, held.versions, held.trained)
        self._plan.write(plan)

    def _write(self, folder: Path) -> None:
        if self._results:
            frame = self.frame
            with atomic_path(folder / EPISODES) as part:
                frame.to_parquet(part, index=False)


def _differs(held: Any, wanted: Any) -> bool:
    """Tell whether two entries of a plan say something different; lists of the same say the same."""
    if isinstance(held, list) and isinstance(wanted, list):
        return any(value not in wanted for value in held) or any(value not in held for value in wanted)
    return bool(held != wanted)
