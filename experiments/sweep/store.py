"""A sweep's folder: nothing that was computed is lost, and nothing is computed twice.

Every finished cell is one line of ``journal.jsonl``, written and synchronised before the next one is counted.
When a sweep begins and when it ends, the journal is folded into ``results.parquet``: the table is complete
on the disk before the journal is emptied, and a cell that is in both counts once. A process that is killed,
or a disk that is full, therefore costs at most the cells that were under way; half a line at the journal's
end is cut off.
"""

import json
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pandas as pd

from surefoot.experiments.study.files import atomic_path, locked, write_text
from surefoot.experiments.study.tables import Frame
from surefoot.experiments.sweep.episode import versions

__all__ = ["JOURNAL", "RESULTS", "SweepError", "SweepStore", "read_results"]

RESULTS, JOURNAL, PLAN = "results.parquet", "journal.jsonl", "sweep.json"


class SweepError(Exception):
    """A sweep cannot go on; the message says what to do. What was computed is kept."""


class SweepStore:
    """The results of one sweep; use it within :meth:`opened`.

    Args:
        folder: Where the sweep lies.

    Attributes:
        rows: Rows by the number of their cell.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.rows: dict[int, dict[str, Any]] = {}
        self._journal: int | None = None

    @contextmanager
    def opened(
        self, fingerprint: str, plan: Mapping[str, Any], *, any_version: bool = False
    ) -> Iterator["SweepStore"]:
        """Take the folder for one sweep, and fold its journal in on the way in and out.

        Args:
            fingerprint: Of the plan.
            plan: The plan as plain data, which is kept beside the results.
            any_version: Whether to go on with results of other versions of the software.

        Raises:
            SweepError: If the folder holds another sweep, or is in use, or the disk is full.
        """
        with _clear_errors(self):
            busy = SweepError(f"Another sweep is at work in '{self.folder}'; wait for it.")
            with locked(self.folder, busy):
                self._claim(fingerprint, plan, any_version)
                self.rows = _read_rows(self.folder)
                self._fold()
                self._journal = os.open(self._path(JOURNAL), os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
                try:
                    yield self
                finally:
                    os.close(self._journal)
                    self._journal = None
                self._fold()

    def add(self, row: Mapping[str, Any]) -> None:
        """Write a finished cell to the disk.

        Raises:
            SweepError: If it does not fit there; then the journal ends with the cell before.
        """
        assert self._journal is not None
        line = (json.dumps(row) + "\n").encode()
        with _clear_errors(self):
            size = os.fstat(self._journal).st_size
            try:
                _write_all(self._journal, line)
                os.fsync(self._journal)
            except OSError:
                os.ftruncate(self._journal, size)
                raise
        self.rows[int(row["cell"])] = dict(row)

    def frame(self) -> Frame:
        """All rows as a data frame, by cell."""
        return _by_cell(self.rows)

    def _path(self, name: str) -> Path:
        return self.folder / name

    def _claim(self, fingerprint: str, plan: Mapping[str, Any], any_version: bool) -> None:
        made = {"fingerprint": fingerprint, "versions": versions(), "plan": plan}
        path = self._path(PLAN)
        if not path.is_file():
            if self._path(RESULTS).exists() or self._path(JOURNAL).exists():
                raise SweepError(f"'{self.folder}' holds results without a {PLAN}; give another folder.")
            write_text(path, json.dumps(made, indent=1) + "\n")
            return
        try:
            held = json.loads(path.read_text(encoding="utf-8"))
            found, software = held["fingerprint"], held["versions"]
        except (ValueError, KeyError, TypeError) as error:
            raise SweepError(f"'{path}' is not a sweep's plan ({error}); give another folder.") from error
        if found != fingerprint:
            raise SweepError(
                f"'{self.folder}' holds another sweep ({found}, this one is {fingerprint}). Go on with that "
                f"one by its own options, which are in {PLAN}, or give another folder with --out."
            )
        if software != versions() and not any_version:
            other = [
                f"{name} {software.get(name)}"
                for name, current in versions().items()
                if software.get(name) != current
            ]
            raise SweepError(
                f"'{self.folder}' was begun with {', '.join(other)}, which is not what runs now. Give "
                "another folder with --out, or go on regardless with --any-version: rows say what made them."
            )

    def _fold(self) -> None:
        """Bring everything into the table, and empty the journal once it is there."""
        journal = self._path(JOURNAL)
        if not journal.is_file() or not journal.stat().st_size:
            return
        if self.rows:
            with atomic_path(self._path(RESULTS)) as part:
                self.frame().to_parquet(part, index=False)
                _synchronise(part)
            _synchronise(self.folder)
        with journal.open("r+b") as file:
            file.truncate(0)
            os.fsync(file.fileno())


def read_results(path: Path) -> Frame:
    """Read a sweep's results, those of one that is under way too.

    Args:
        path: The folder of a sweep, or its table alone.

    Returns:
        One row a finished cell, see :func:`~surefoot.experiments.sweep.episode.run_cell`.

    Raises:
        SweepError: If there is none.
    """
    if path.is_dir():
        rows = _read_rows(path)
        if not rows:
            raise SweepError(f"'{path}' holds no results of a sweep.")
        return _by_cell(rows)
    return _read_table(path)


def _by_cell(rows: Mapping[int, dict[str, Any]]) -> Frame:
    return pd.DataFrame([rows[number] for number in sorted(rows)])


def _read_rows(folder: Path) -> dict[int, dict[str, Any]]:
    table = folder / RESULTS
    rows = {}
    if table.is_file():
        rows = {int(row["cell"]): row for row in _read_table(table).to_dict("records")}
    journal = folder / JOURNAL
    if journal.is_file():
        for line in journal.read_bytes().splitlines(keepends=True):
            # Only the last line can be half written: the next is not begun before it is on the disk.
            if not line.endswith(b"\n"):
                break
            try:
                row = json.loads(line)
                rows[int(row["cell"])] = row
            except (ValueError, KeyError, TypeError) as error:
                raise SweepError(
                    f"{journal} is damaged ({error}): {line[:60]!r}. Delete this line to go on; its cell is "
                    "run again."
                ) from error
    return rows


def _read_table(path: Path) -> Frame:
    try:
        frame = pd.read_parquet(path)
    except FileNotFoundError as error:
        raise SweepError(f"{path}: no such file; 'surefoot sweep' writes one into its folder.") from error
    except (OSError, ValueError) as error:
        raise SweepError(f"{path} is not a table of Parquet: {error}.") from error
    if missing := [name for name in ("cell", "spec", "digest") if name not in frame]:
        raise SweepError(f"{path} is no table of a sweep: it lacks the column '{missing[0]}'.")
    return frame


@contextmanager
def _clear_errors(store: SweepStore) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise SweepError(
            f"cannot write to '{store.folder}': {error.strerror or error}. The {len(store.rows)} cells that "
            "were finished are kept; make room, or mend it, and give the same command to go on."
        ) from error


def _write_all(file: int, data: bytes) -> None:
    while data:
        data = data[os.write(file, data) :]


def _synchronise(path: Path) -> None:
    if sys.platform == "win32" and path.is_dir():
        return
    file = os.open(path, os.O_RDONLY)
    try:
        os.fsync(file)
    finally:
        os.close(file)
