"""The display while one waits, on the standard error: bars; where that is no terminal, a line at times."""

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    SpinnerColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Item = TypeVar("Item")


EVERY = 60.0  # s between two lines in place of bars: a log of an hour stays one page


class _Bars(Progress):
    """Bars; where they are not shown, a line of text now and then."""

    def __init__(self, *columns: ProgressColumn, **options: Any) -> None:
        super().__init__(*columns, **options)
        self._said = time.monotonic()

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Update a task, and say how far it is if nothing was said for a while."""
        super().update(task_id, **changes)
        if self.disable and time.monotonic() - self._said >= EVERY:
            self._said = time.monotonic()
            task = self.tasks[self.task_ids.index(task_id)]
            more = f", {said}" if (said := task.fields.get("said")) else ""
            left = "" if task.time_remaining is None else f", {task.time_remaining:.0f} s left"
            print(f"{task.description}: {task.completed:g} of {task.total:g}{more}{left}", file=sys.stderr)


def bars(*beside: str, **options: Any) -> Progress:
    """Return bars to enter; each task has its description, and a text beside the bar."""
    columns = (
        TextColumn("{task.description:28s}"),
        BarColumn(),
        MofNCompleteColumn(),
        *map(TextColumn, beside),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return _Bars(*columns, **_terminal(), **options)


def each(what: str, items: Sequence[Item]) -> Iterator[Item]:
    """Yield items one by one behind a bar that is gone at the end; it moves a thousand times at most."""
    with bars(transient=True) as shown:
        task, stride = shown.add_task(what, total=len(items)), len(items) // 1000 + 1
        for done, item in enumerate(items, 1):
            yield item
            if done % stride == 0 or done == len(items):
                shown.update(task, completed=done)


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show the present work and for how long; the function that is lent names the next."""
    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    shown = Progress(*columns, **_terminal(), transient=True)
    with shown:
        task = shown.add_task(what, total=None)
        yield lambda then: shown.update(task, description=then)


def _terminal() -> dict[str, Any]:
    """Return where bars are shown; rich before 14.1 ends even disabled ones with an empty line."""
    console = Console(stderr=True)
    console.quiet = not console.is_terminal
    return {"console": console, "disable": console.quiet}
