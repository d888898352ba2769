"""The sweep itself: hand out what is missing, write down what comes back."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from surefoot.experiments.study.tables import Frame
from surefoot.experiments.sweep.backends import Died, Job, Workers, workers
from surefoot.experiments.sweep.episode import Cell, check_cell, failed_row, run_cell, versions
from surefoot.experiments.sweep.plan import SweepPlan
from surefoot.experiments.sweep.store import SweepError, SweepStore

__all__ = ["SweepResults", "run_sweep"]


@dataclass(frozen=True, eq=False)
class SweepResults:
    """What a sweep found.

    Attributes:
        plan: What was swept.
        folder: Where it lies.
        rows: One row a cell, see :func:`~surefoot.experiments.sweep.episode.run_cell`.
        computed: How many of them this run added; the others were there already.
    """

    plan: SweepPlan
    folder: Path
    rows: Frame
    computed: int

    @property
    def failed(self) -> Frame:
        """The rows of cells that could not be run through."""
        return self.rows[self.rows["error"] != ""]

    @property
    def finished(self) -> Frame:
        """The rows of all others."""
        return self.rows[self.rows["error"] == ""]


def run_sweep(
    plan: SweepPlan,
    folder: Path,
    *,
    backend: str = "local",
    jobs: int = 1,
    address: str | None = None,
    retry_failed: bool = False,
    any_version: bool = False,
    console: Console | None = None,
    job: Job = run_cell,
) -> SweepResults:
    """Run every cell of a plan that has no row yet.

    Args:
        plan: What to sweep.
        folder: Where the results lie; that of an interrupted sweep is taken up again.
        backend: One of :data:`~surefoot.experiments.sweep.backends.BACKENDS`.
        jobs: How many cells are run at the same time on this machine.
        address: Of a cluster that is running.
        retry_failed: Whether cells that failed before are run again.
        any_version: Whether to go on with rows of other versions of the software.
        console: Where progress is shown; the terminal's error output by default.
        job: What is done with a cell.

    Raises:
        ValueError: If there is no such backend, or it is not installed, or a scenario or a controller is
            refused before anything is run.
        SweepError: If the folder cannot be used, the disk is full, or a worker runs other software.
    """
    with SweepStore(folder).opened(plan.fingerprint, plan.as_dict(), any_version=any_version) as store:
        kept = {n for n, row in store.rows.items() if not (retry_failed and row["error"])}
        missing = [cell for cell in plan.grid if cell.number not in kept]
        if missing:
            _try_out(missing)
            with workers(backend, jobs, address) as crew, _bar(console, len(plan.grid), kept, store) as seen:
                for row in rows_of(crew, job, missing):
                    if not any_version:
                        _check_versions(row)
                    store.add(row)
                    seen(row)
        return SweepResults(plan, folder, store.frame(), len(missing))


def _check_versions(row: dict[str, Any]) -> None:
    """Refuse what a worker of a cluster made with other software than is here."""
    other = [f"{name} {row[name]}" for name, ours in versions().items() if row[name] != ours]
    if other:
        raise SweepError(
            f"A worker runs {', '.join(other)}, which is not what runs here. Install the same on all of them "
            "and give the same command to go on, or take what they make as it is with --any-version."
        )


def _try_out(cells: list[Cell]) -> None:
    """Refuse a plan of which a scenario or a controller cannot even be made: here, and not cell by cell."""
    hardest = sorted(cells, key=lambda cell: cell.severity)
    # The last of a kind stays: of each scenario and of each controller the cell with the worst feet.
    kinds = {(name, getattr(cell, name)): cell for cell in hardest for name in ("scenario", "controller")}
    tried = {cell.number: cell for cell in kinds.values()}
    for number in sorted(tried):
        check_cell(tried[number])


def rows_of(crew: Workers, job: Job, cells: list[Cell]) -> Iterator[dict[str, Any]]:
    """Run cells until each has a row, whoever dies of them.

    A cell that a worker may have died of is run by itself; if that kills its worker too, it is the cell.
    """
    pending = {cell.number: cell for cell in cells}
    while pending:
        suspects: set[int] = set()
        for outcome in crew.stream(job, list(pending.values())):
            if isinstance(outcome, Died):
                suspects.update(outcome.cells)
            else:
                del pending[int(outcome["cell"])]
                yield outcome
        for number in sorted(suspects & pending.keys()):
            cell = pending.pop(number)
            for outcome in crew.stream(job, [cell], alone=True):
                if isinstance(outcome, Died):
                    yield failed_row(cell, f"The worker that ran this cell died: {outcome.reason}")
                else:
                    yield outcome


@contextmanager
def _bar(console: Console | None, total: int, kept: set[int], store: SweepStore) -> Iterator[Any]:
    """Show how far it is, how many fell and how many failed."""
    fell = sum(bool(store.rows[n]["fell"]) for n in kept)
    failed = sum(bool(store.rows[n]["error"]) for n in kept)
    bars = Progress(
        TextColumn("sweep"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[fell]} fell, {task.fields[failed]} failed"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True) if console is None else console,
    )
    with bars as progress:
        task = progress.add_task("sweep", total=total, completed=len(kept), fell=fell, failed=failed)

        def seen(row: dict[str, Any]) -> None:
            nonlocal fell, failed
            fell, failed = fell + bool(row["fell"]), failed + bool(row["error"])
            progress.update(task, advance=1, fell=fell, failed=failed)

        yield seen
