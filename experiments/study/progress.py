"""What is shown while one waits: on the standard error, and nothing where that is no terminal."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    SpinnerColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

Item = TypeVar("Item")


def bars(*beside: str, **options: Any) -> Progress:
    """Return bars to enter; each task has its description, and what is to be said of it beside the bar."""
    columns = (
        TextColumn("{task.description:28s}"),
        BarColumn(),
        MofNCompleteColumn(),
        *map(TextColumn, beside),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    return Progress(*columns, **_terminal(), **options)


def each(what: str, items: Sequence[Item]) -> Iterator[Item]:
    """Yield items one by one behind a bar that is gone at the end."""
    with bars(transient=True) as shown:
        yield from shown.track(items, description=what)


@contextmanager
def working(what: str) -> Iterator[Callable[[str], None]]:
    """Show what is being done and for how long, until it is; what is lent says what is done next."""
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
