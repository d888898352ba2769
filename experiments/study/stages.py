"""Work in pieces: processes that do it, a bar that shows it, a stopwatch, and what it ran on."""

import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

from joblib import Parallel, delayed, parallel_config
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

import surefoot

__all__ = ["Stage", "Work", "machine", "stages"]

Work = Sequence[tuple[Callable[..., Any], tuple[Any, ...]]]
"""Functions and what to give them."""


@dataclass(eq=False)
class Stage:
    """Runs pieces of work in processes, with a bar and a stopwatch.

    Attributes:
        jobs: Processes that work at the same time.
        progress: Where the bars are.
        seconds: Time that each stage took in s, filled in as stages end.
    """

    jobs: int
    progress: Progress
    seconds: dict[str, float] = field(default_factory=dict)

    def run(self, what: str, work: Work) -> list[Any]:
        """Do pieces in any order and hand their results back in this one.

        Args:
            what: Name of the stage.
            work: The pieces; functions and arguments must survive pickling.
        """
        began = time.perf_counter()
        task = self.progress.add_task(what, total=len(work))
        found: list[Any] = [None] * len(work)
        parallel = Parallel(n_jobs=self.jobs, return_as="generator_unordered")
        done: Any = parallel(delayed(_numbered)(i, f, a) for i, (f, a) in enumerate(work))
        for index, result in done:
            found[index] = result
            self.progress.advance(task)
        self.seconds[what] = time.perf_counter() - began
        return found


@contextmanager
def stages(jobs: int, seconds: dict[str, float], console: Console | None = None) -> Iterator[Stage]:
    """Lend what runs the stages of a study.

    Args:
        jobs: Processes that work at the same time; one works in this process.
        seconds: Where the time that each stage took is noted.
        console: Where progress is shown; the terminal's error output by default.
    """
    threads: dict[str, Any] = {"inner_max_num_threads": 1} if jobs > 1 else {}
    backend = "loky" if jobs > 1 else "sequential"
    bars = Progress(
        TextColumn("{task.description:28s}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        console=Console(stderr=True) if console is None else console,
    )
    with bars as progress, parallel_config(backend=backend, **threads):
        yield Stage(jobs, progress, seconds)


def machine() -> str:
    """Say what this runs on: versions, cores and architecture."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "mujoco", "gymnasium"))
    return (
        f"surefoot {surefoot.__version__}, Python {platform.python_version()}, {packages}; "
        f"{os.cpu_count()} cores, {platform.machine()}"
    )


def _numbered(index: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    return index, function(*arguments)
