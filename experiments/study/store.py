"""A study's folder: nothing that was computed is lost, and nothing is computed twice.

The result of a :class:`Case` is kept under its key, and found again while the code is the same. Every
finished case is one line of ``journal.jsonl``, synchronised before the next: a killed process or a full disk
costs the cases under way, a line that was damaged its case.
"""

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from textwrap import shorten
from typing import Any

from surefoot.experiments.study.sources import code_of
from surefoot.experiments.study.tables import Frame
from surefoot.files import lock_folder, parse_json, read_json, stat_of_file, write_text

JOURNAL, PLAN = "journal.jsonl", "study.json"


class StudyError(ValueError):
    """A study cannot go on; the message names the cure. Computed results are kept."""


@dataclass(frozen=True, eq=False)
class Case:
    """One piece of a study; it depends on nothing but the fields here, and must survive pickling."""

    name: str  # what messages call it
    run: Callable[..., Mapping[str, Any]]  # of a module; returns rows (or a data frame) by table
    arguments: tuple[Any, ...]
    depends: Any = None  # if not the arguments: no folders, nothing whose ``repr`` differs from run to run

    @property
    def key(self) -> str:
        """Sixteen hex digits of a function and its arguments."""
        depends = self.arguments if self.depends is None else self.depends
        return sha256(repr((self.run.__module__, self.run.__qualname__, depends)).encode()).hexdigest()[:16]

    @property
    def code(self) -> str:
        """The code that runs it: a hash of the sources, and versions."""
        return code_of(self.run.__module__)


@dataclass(frozen=True, eq=False)
class Outcome:
    """The result of a case: its rows by the name of their table, or the error, and the time in s."""

    key: str
    name: str
    code: str
    tables: Mapping[str, list[dict[str, Any]]] = field(default_factory=dict)
    error: str = ""
    seconds: float = float("nan")


class Store:
    """The results of a study in a folder, ``outcomes`` by key of the case; use it within :meth:`open_for`."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.outcomes: dict[str, Outcome] = {}
        self.damaged = 0
        self._journal = -1

    @contextmanager
    def open_for(
        self,
        plan: Mapping[str, Any] | None = None,
        versions: Mapping[str, str] | None = None,
        *,
        any_version: bool = False,
    ) -> Iterator["Store"]:
        """Take the folder for one study, or raise StudyError; a plan goes on with the same versions alone."""
        busy = StudyError(f"Another study is at work in '{self.folder}'; wait for it.")
        with self._explain_errors(), lock_folder(self.folder, busy):
            if plan is not None:
                self._claim(as_kept(plan), dict(versions or {}), any_version)
            self.read()
            path = self.folder / JOURNAL
            if self.damaged:
                write_text(path, "".join(_line_of(one) for one in self.outcomes.values()))
            stat_of_file(path)
            self._journal = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
            try:
                yield self
            finally:
                os.close(self._journal)

    def read(self) -> None:
        """Read the results so far, also of a study that is under way."""
        self.outcomes, self.damaged = {}, 0
        journal = self.folder / JOURNAL
        for line in journal.read_bytes().splitlines() if journal.is_file() else ():
            try:
                outcome = Outcome(**{k: v for k, v in parse_json(line, JOURNAL).items() if k != "digest"})
                self.outcomes[outcome.key] = outcome
            except (ValueError, TypeError, AttributeError):
                self.damaged += 1

    def holds(self, case: Case, *, any_version: bool = False) -> bool:
        """Return whether a case went well and is kept; with ``any_version`` results of other code count."""
        found = self.outcomes.get(case.key)
        if found is None or found.error:
            return False
        return any_version or found.code == case.code

    def add(self, outcome: Outcome) -> None:
        """Write the result of a case to the disk, or raise StudyError: the journal ends before it then."""
        data = _line_of(outcome).encode()
        with self._explain_errors():
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
        import pandas as pd

        return pd.DataFrame([row for outcome in found for row in outcome.tables.get(table, ())])

    def failures(self, cases: Iterable[Case]) -> dict[str, str]:
        """Errors of the cases that failed, by their names."""
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
            held = read_json(path)
            theirs, software = dict(held["plan"]), dict(held["versions"])
        except (ValueError, KeyError, TypeError) as error:
            raise StudyError(f"'{path}' is not a study's plan ({error}); give another folder.") from error
        if other := [name for name in sorted(plan.keys() | theirs) if plan.get(name) != theirs.get(name)]:
            differ = [[name, *(shorten(f"{of.get(name)}", 100) for of in (theirs, plan))] for name in other]
            said = "; ".join(f"{name} {there} and not {here}" for name, there, here in differ)
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
    def _explain_errors(self) -> Iterator[None]:
        try:
            yield
        except (FileExistsError, NotADirectoryError) as error:
            raise StudyError(f"'{self.folder}' is a file, or lies below one; name a folder.") from error
        except OSError as error:
            raise StudyError(
                f"cannot write to '{self.folder}': {error.strerror or error}. The {len(self.outcomes)} cases "
                "that were finished are kept; make room, or mend it, and give the same command to go on."
            ) from error


def _line_of(outcome: Outcome) -> str:
    """Return a line of the journal: the result of a case."""
    return f"{_dump(vars(outcome))}\n"


def as_kept(data: Any) -> Any:
    """Return data as they come back from the disk; data frames are rows."""
    return json.loads(_dump(data))


def _dump(data: Any) -> str:
    def plain(value: Any) -> Any:
        if hasattr(value, "to_dict"):
            return value.to_dict("records")
        if hasattr(value, "tolist"):
            return value.tolist()
        return dict(value) if isinstance(value, Mapping) else str(value)

    return json.dumps(data, default=plain)
