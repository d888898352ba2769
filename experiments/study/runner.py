"""Runs the work of a study by joblib, in one process or several, with a bar and a stopwatch.

``joblib.parallel_config`` chooses another backend, such as dask. If a process dies, the tasks that are left
are run one at a time until the one is found that it died of: its result is :class:`Died`.
"""

import os
import platform
import time
import traceback
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from importlib.metadata import version
from types import MappingProxyType
from typing import Any

import joblib
from rich.progress import Progress

import surefoot
from surefoot.experiments.study.progress import bars
from surefoot.experiments.study.store import Case, Outcome, Store, StudyError, as_kept
from surefoot.experiments.study.tables import plural

Task = tuple[Callable[..., Any], tuple[Any, ...]]  # must survive pickling


@dataclass(frozen=True)
class Died:
    """The result of a task that its process died of; ``reason`` is the known cause."""

    reason: str


def _results(tasks: Mapping[int, Task], jobs: int | None) -> Iterator[tuple[int, Any]]:
    """Yield the number and the result of each task, in any order; errors of a task are raised here."""
    left = dict(tasks)
    while left:
        try:
            for number, result in _parallel(list(left.items()), jobs):
                del left[number]
                yield number, result
        except BrokenExecutor:
            for number, task in list(left.items()):
                result = _alone(number, task)
                del left[number]
                yield number, result
                if isinstance(result, Died):
                    break


def _alone(number: int, task: Task) -> Any:
    """Return the result of a task that has processes to itself."""
    try:
        ((_, result),) = _parallel([(number, task)], 2)
    except BrokenExecutor as error:
        return Died(" ".join(f"{type(error).__name__}: {error}".split())[:400])
    return result


def _parallel(tasks: Sequence[tuple[int, Task]], jobs: int | None) -> Iterator[tuple[int, Any]]:
    """Run tasks by joblib; processes of this machine use one thread each, so that cores are not shared."""
    chosen = (
        nullcontext()
        if jobs is None
        else joblib.parallel_config("loky", n_jobs=jobs, inner_max_num_threads=1)
    )
    with chosen:
        parallel = joblib.Parallel(return_as="generator_unordered")
    found: Iterator[tuple[int, Any]] = parallel(
        joblib.delayed(_do)(number, function, arguments) for number, (function, arguments) in tasks
    )
    return found


def _do(number: int, function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[int, Any]:
    return number, function(*arguments)


LONGEST_ERROR = 4000  # characters of a failed case's traceback that are kept, its end
Failed = Callable[[Case, str], Mapping[str, Any]]  # rows of a failed case, from what was raised


@dataclass(eq=False)
class Runner:
    """Does the work of a study, shows it, and notes how long each stage took; :func:`runner` makes one."""

    jobs: int | None  # processes; ``None`` for what ``joblib.parallel_config`` says
    progress: Progress
    seconds: dict[str, float]

    def do(self, what: str, work: Sequence[Task]) -> list[Any]:
        """Do the pieces of a stage, return results in the order given; raise StudyError if a worker died."""
        found: list[Any] = [None] * len(work)
        with self._stage(what, len(work)) as seen:
            for number, result in _results(dict(enumerate(work)), self.jobs):
                if isinstance(result, Died):
                    raise StudyError(f"A worker died ('{what}', piece {number}): {result.reason}")
                found[number] = result
                seen("")
        return found

    def run(
        self,
        what: str,
        cases: Iterable[Case],
        store: Store,
        *,
        any_version: bool = False,
        failed: Failed | None = None,
        count: Mapping[str, Callable[[Outcome], bool]] = MappingProxyType({}),
    ) -> int:
        """Run the cases that a store does not hold yet, write each result, and return how many.

        ``any_version`` takes results of other code as they are; ``failed`` makes rows of a failed case, and
        ``count`` names the outcomes that are counted beside the bar.
        """
        listed = list(cases)
        # Before anything runs: what is on the disk now is what has been imported.
        codes = {case.key: case.code for case in listed}
        missing = {i: case for i, case in enumerate(listed) if not store.holds(case, any_version=any_version)}
        counters: dict[str, Callable[[Outcome], bool]] = {**count, "failed": lambda one: bool(one.error)}
        there = [store.outcomes[case.key] for i, case in enumerate(listed) if i not in missing]
        counted = {word: sum(map(of, there)) for word, of in counters.items()}
        with self._stage(what, len(listed), len(there)) as seen:
            if store.damaged:
                lines = plural(store.damaged, "damaged line")
                self.progress.console.print(f"{store.folder} had {lines}; these cases are run again.")
                store.damaged = 0
            tasks: dict[int, Task] = {i: (attempt, (case,)) for i, case in missing.items()}
            for number, result in _results(tasks, self.jobs):
                case = missing[number]
                if isinstance(result, Died):
                    reason = f"The worker that ran this case died: {result.reason}"
                    result = Outcome(case.key, case.name, codes[case.key], error=reason)
                if result.code != codes[case.key] and not any_version:
                    raise StudyError(
                        f"The code has changed meanwhile, from {codes[case.key]} to {result.code}: give the "
                        "same command once more."
                    )
                if result.error and failed is not None:
                    result = replace(result, tables=as_kept(failed(case, result.error)))
                store.add(result)
                for word, of in counters.items():
                    counted[word] += of(result)
                seen(", ".join(f"{number} {word}" for word, number in counted.items()))
        return len(missing)

    @contextmanager
    def _stage(self, what: str, total: int, done: int = 0) -> Iterator[Callable[[str], None]]:
        began = time.perf_counter()
        task = self.progress.add_task(what, total=total, completed=done, said="")
        yield lambda said: self.progress.update(task, advance=1, said=said)
        self.seconds[what] = time.perf_counter() - began


@contextmanager
def runner(jobs: int | None, seconds: dict[str, float] | None = None) -> Iterator[Runner]:
    """Lend a runner of a study's stages, which notes seconds of each; one job works in this very process."""
    if jobs is not None and jobs < 1:
        raise ValueError(f"'jobs' must be at least 1, got {jobs}.")
    with bars("{task.fields[said]}") as progress, warnings.catch_warnings():
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given", UserWarning)
        yield Runner(jobs, progress, {} if seconds is None else seconds)


def attempt(case: Case) -> Outcome:
    """Run a case; whatever goes wrong in it is part of the outcome."""
    began = time.perf_counter()
    try:
        tables, error = as_kept(case.run(*case.arguments)), ""
    except Exception:
        tables, error = {}, traceback.format_exc().strip()[-LONGEST_ERROR:]
    return Outcome(case.key, case.name, case.code, tables, error, time.perf_counter() - began)


def machine() -> str:
    """Versions, cores and architecture of this machine."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("numpy", "mujoco", "gymnasium"))
    return (
        f"surefoot {surefoot.__version__}, Python {platform.python_version()}, {packages}; "
        f"{os.cpu_count()} cores, {platform.machine()}"
    )
