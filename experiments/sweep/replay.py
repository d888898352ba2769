"""One cell of a sweep again, from its results alone."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surefoot.experiments.sweep.episode import OUTCOME, VERSIONS, Cell, run_cell
from surefoot.experiments.sweep.store import SweepError, read_results

__all__ = ["Replayed", "replay_cell"]


@dataclass(frozen=True)
class Replayed:
    """A cell and its repetition.

    Attributes:
        cell: Which one.
        then: Its row in the results.
        now: The row of the repetition.
    """

    cell: Cell
    then: Mapping[str, Any]
    now: Mapping[str, Any]

    @property
    def different(self) -> tuple[str, ...]:
        """Names of the outcomes that came out otherwise, in any digit."""
        return tuple(name for name in (*OUTCOME, "error") if not _same(self.then[name], self.now[name]))

    @property
    def other_versions(self) -> tuple[str, ...]:
        """What was run with then and is another now, in words."""
        return tuple(
            f"{name} {self.then[name]} -> {self.now[name]}"
            for name in VERSIONS
            if self.then[name] != self.now[name]
        )


def read_cell(path: Path, number: int) -> tuple[Cell, dict[str, Any]]:
    """Find a cell and its row in the results of a sweep.

    Raises:
        SweepError: If there are no results, or none of this cell.
    """
    frame = read_results(path)
    found = frame[frame["cell"] == number]
    if not len(found):
        raise SweepError(
            f"There is no cell {number} in '{path}'; it has {len(frame)}, from {frame['cell'].min()} to "
            f"{frame['cell'].max()}."
        )
    row = found.iloc[0].to_dict()
    return Cell.from_json(row["spec"]), row


def replay_cell(path: Path, number: int) -> Replayed:
    """Run a cell again and hold it against its row.

    Args:
        path: A sweep's folder or its table.
        number: Of the cell.

    Raises:
        SweepError: If there are no results, or none of this cell.
    """
    cell, then = read_cell(path, number)
    return Replayed(cell, then, run_cell(cell))


def _same(one: Any, other: Any) -> bool:
    both_nan: bool = one != one and other != other
    return both_nan or bool(one == other)
