"""A study's folder: nothing that was computed is lost, and nothing is computed twice.

A :class:`Case` is a function and its arguments; its *key* is a hash of what it depends on, its *code* a hash
of the sources behind the function, with the versions of NumPy, SciPy and MuJoCo. What came of it is kept
under the key, and is found again while the code is the same.

Every finished case is one line of ``journal.jsonl``, written and synchronised before the next one is counted.
A process that is killed, or a disk that is full, therefore costs at most the cases that were under way; a
line that is damaged costs its case, which is run again.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from surefoot.experiments.study.files import locked, write_text
from surefoot.experiments.study.sources import code_of
from surefoot.experiments.study.tables import Frame

JOURNAL, PLAN = "journal.jsonl", "study.json"


class StudyError(ValueError):
    """A study cannot go on; the message says what to do. What was computed is kept."""


@dataclass(frozen=True, eq=False)
class Case:
    """One piece of a study; it depends on nothing but what is named here.

    Attributes:
        name: What messages call it.
        run: A function of a module, which returns rows (or a data frame) by the name of their table. It and
            its arguments must survive pickling.
        arguments: What it is given.
        depends: What the result depends on, if that is not the arguments: folders and objects whose ``repr``
            differs from run to run must not be in it.
    """

    name: str
    run: Callable[..., Mapping[str, Any]]
    arguments: tuple[Any, ...]
    depends: Any = None

    @property
    def key(self) -> str:
        """Sixteen hex digits of what is run on what."""
        depends = self.arguments if self.depends is None else self.depends
        return sha256(repr((self.run.__module__, self.run.__qualname__, depends)).encode()).hexdigest()[:16]

    @property
    def code(self) -> str:
        """What runs it: a hash of the sources, and versions."""
        return code_of(self.run.__module__)


@dataclass(frozen=True, eq=False)
class Outcome:
    """What came of a case: its rows by the name of their table, or what was raised, and the time in s."""

    key: str
    name: str
    code: str
    tables: Mapping[str, list[dict[str, Any]]] = field(default_factory=dict)
    error: str = ""
    seconds: float = float("nan")


class Store:
    """The results of a study in a folder; use it within :meth:`opened`.

    Attributes:
        outcomes: What came of each case, by its key.
        damaged: How many lines of the journal could not be read.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.outcomes: dict[str, Outcome] = {}
        self.damaged = 0
        self._journal = -1

    @contextmanager
    def opened(
        self,
        plan: Mapping[str, Any] | None = None,
        versions: Mapping[str, str] | None = None,
        *,
        any_version: bool = False,
    ) -> Iterator["Store"]:
        """Take the folder for one study; a plan that it holds goes on with the same versions alone.

        Raises:
            StudyError: If the folder holds another study, or is in use, or the disk is full.
        """
        busy = StudyError(f"Another study is at work in '{self.folder}'; wait for it.")
        with self._explained(), locked(self.folder, busy):
            if plan is not None:
                self._claim(json.loads(_dump(plan)), dict(versions or {}), any_version)
            self.read()
            path = self.folder / JOURNAL
            if self.damaged:
                write_text(path, "".join(_dump(asdict(one)) + "\n" for one in self.outcomes.values()))
            self._journal = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            try:
                yield self
            finally:
                os.close(self._journal)

    def read(self) -> None:
        """Read what there is, also of a study that is under way."""
        self.outcomes, self.damaged = {}, 0
        journal = self.folder / JOURNAL
        for line in journal.read_bytes().splitlines() if journal.is_file() else ():
            try:
                outcome = Outcome(**json.loads(line))
            except (ValueError, TypeError):
                self.damaged += 1
            else:
                self.outcomes[outcome.key] = outcome

    def holds(self, case: Case, *, retry_failed: bool = True, any_version: bool = False) -> bool:
        """Return whether a case need not be run again; with ``any_version`` results of other code count."""
        found = self.outcomes.get(case.key)
        if found is None or (found.error and retry_failed):
            return False
        return any_version or found.code == case.code

    def add(self, outcome: Outcome) -> None:
        """Write what came of a case to the disk.

        Raises:
            StudyError: If it does not fit there; the journal then ends with the case before.
        """
        data = (_dump(asdict(outcome)) + "\n").encode()
        with self._explained():
            size = os.fstat(self._journal).st_size
            try:
                while data:
                    data = data[os.write(self._journal, data) :]
                os.fsync(self._journal)
            except OSError:
                os.ftruncate(self._journal, size)
                raise
        self.outcomes[outcome.key] = outcome

    def rows(self, table: str, cases: Iterable[Case] | None = None) -> Frame:
        """Return the rows of a table as a data frame, case by case; of all cases by default."""
        keys = self.outcomes if cases is None else [case.key for case in cases]
        found = [self.outcomes[key] for key in keys if key in self.outcomes]
        return pd.DataFrame([row for outcome in found for row in outcome.tables.get(table, ())])

    def failures(self, cases: Iterable[Case]) -> dict[str, str]:
        """Return what was raised in the cases that failed, by their names."""
        found = [self.outcomes[case.key] for case in cases if case.key in self.outcomes]
        return {outcome.name: outcome.error for outcome in found if outcome.error}

    def _claim(self, plan: dict[str, Any], versions: dict[str, str], any_version: bool) -> None:
        path = self.folder / PLAN
        if not path.is_file():
            if (self.folder / JOURNAL).exists() or list(self.folder.glob("*.parquet")):
                raise StudyError(f"'{self.folder}' holds results without a {PLAN}; give another folder.")
            write_text(path, json.dumps({"plan": plan, "versions": versions}, indent=1) + "\n")
            return
        try:
            held = json.loads(path.read_text(encoding="utf-8"))
            theirs, software = dict(held["plan"]), dict(held["versions"])
        except (ValueError, KeyError, TypeError) as error:
            raise StudyError(f"'{path}' is not a study's plan ({error}); give another folder.") from error
        if other := [name for name in sorted(plan.keys() | theirs) if plan.get(name) != theirs.get(name)]:
            said = "; ".join(f"{name} {theirs.get(name)} and not {plan.get(name)}" for name in other)
            raise StudyError(
                f"'{self.folder}' holds another study: {said}. Give its options to go on, or another folder "
                "with --out."
            )
        if software != versions and not any_version:
            other = [
                f"{name} {software.get(name)}" for name in versions if software.get(name) != versions[name]
            ]
            raise StudyError(
                f"'{self.folder}' was started with {', '.join(other)}, which is not what runs now. Give "
                "another folder with --out, or go on regardless with --any-version: rows say what made them."
            )

    @contextmanager
    def _explained(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise StudyError(
                f"cannot write to '{self.folder}': {error.strerror or error}. The {len(self.outcomes)} cases "
                "that were finished are kept; make room, or mend it, and give the same command to go on."
            ) from error


def _dump(data: Any) -> str:
    def plain(value: Any) -> Any:
        if isinstance(value, Mapping):
            return dict(value)
        if isinstance(value, np.ndarray | np.generic):
            return value.tolist()
        return str(value)

    return json.dumps(data, default=plain)
